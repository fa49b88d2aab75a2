//! The vocabulary of Abbe: data sets, kinematic models, observations, problems, the six stage traits and the registry of
//! plugins; with it units, errors, settings and the progress of work (`abbe-settings`), calibrations and verdicts (`abbe-results`).
//!
//! Everything else in the project speaks through the types of this crate, so it stays small.
//!
//! **Architecture invariant:** this crate does no I/O, knows no plugin, no topology, no artefact and no controller by
//! name, and uses no numerics library beyond nalgebra.
//!
//! In memory every quantity is in mm, rad, s, °C or N. Columns and settings say their unit in their name.

mod dataset;
mod factored;
mod index;
mod layout;
mod model;
mod observations;
mod parameter;
mod pose_table;
mod problem;
mod quantities;
mod registry;
pub mod rotation;
mod stage;
mod table;
mod uncertainty;

pub use dataset::{Column, ColumnHeader, Dataset, LabelText, RowOrigin, StatedTip, Values};
pub use factored::FactoredPoses;
pub use index::{DataRow, EquationIndex, IndexRange, LayoutEquation, ListedBy, PoseIndex, RowIndex, SetIndex};
pub use layout::{Layout, Row};
pub use model::{
    Absent, Axis, AxisKind, Branch, ErrorFunction, KinematicModel, ModelInfo, MotionError, PeriodicError, PoseBatch,
    Poses, PosesMut, StatusColumn, StatusRole, Variable, machine_values,
};
pub use observations::{
    Approach, Contact, Equations, Feature, KnownInput, NominalReading, Observations, ObservationsInfo, Orientation,
    RankPoint, RowBatch, Target,
};
pub use parameter::{Parameter, ParameterRole, ProbeTerm};
pub use pose_table::{ColumnNaming, PoseTable, StatusSource, plain_naming, pose_columns};
pub use problem::{
    Block, CHUNK, Chunk, CompactBlock, Considered, DeclaredTie, Evaluation, Input, ObservationSet, Owner, PartOfRows,
    Prior, Problem, RepeatedTogether, Tie, Unknown,
};
pub use quantities::Quantities;
pub use registry::{Build, Constructor, Context, EstimateSource, Kind, Origin, Plugin, Provider, Registry};
pub use stage::{
    Artefact, Batch, Batches, CommandCorrection, Estimate, Export, ExportedFile, Fit, Ingest, InputFile, Model, Parts,
    Passes, QuestionToRows, Validate, ValuesOf,
};
pub use table::{Cell, ColumnCells, Field, RowsOfTable, SharedCells, Table};
pub use uncertainty::{CovarianceBlock, EquationUncertainty, PooledRepeatability};

// Types of settings and results. They are re-exported so that plugins need this crate alone.
pub use abbe_results::{
    AskedOfPart, CALIBRATION_FORMAT, Calibration, Certificate, Combination, CombinedAgreement, ConsideredInput,
    Contribution, Correlated, DataRecord, Decision, EquivalentMotionError, Estimated, Figure, FileFormat, Findings,
    FitReport, Group, GumComparison, Histogram, Identifiability, ImplausibleValue, JointCoverage, Limit, MOST_OUTLIERS,
    ModelRecord, MonteCarlo, NamedCovariance, Outlier, ParameterBudget, PartEvidence, PredictedStructure, ResidualSums,
    Rule, Samples, Selection, SelectionByPrediction, SelectionDirection, SelectionStep, SimulatedParameter, SizeSums,
    Status, Triangle, UncertaintyBudget, VERDICTS_FORMAT, VarianceFactor, Verdict, WeakDirection, WeighedSums,
    rule_or_name, schema_of_rules,
};
pub use abbe_settings::ranges::AboveZero;
pub use abbe_settings::{
    Class, Convergence, Error, EvenSeries, Event, Label, Monitor, Names, PathItem, Place, Quantity, Result, Series,
    SettingsError, Termination, Unit, Whole, both, free_threads, from_json, from_settings, from_settings_in_range,
    harmless, harmless_json, in_parallel, matches, nearest, not_negative, path_text, positive, ranges, schema_of,
};

/// Re-exported so that plugins register with the same version of `inventory` that the registry uses.
pub use inventory;
