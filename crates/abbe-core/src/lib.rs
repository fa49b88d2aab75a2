//! The vocabulary of Abbe: units, data sets, kinematic models, observations, problems, calibrations, verdicts, the six
//! stage traits and the registry of plugins.
//!
//! Everything else in the project speaks through the types of this crate, so it stays small.
//!
//! **Architecture invariant:** this crate does no I/O, knows no plugin, no topology, no artefact and no controller by
//! name, and uses no numerics library beyond nalgebra.
//!
//! In memory every quantity is in mm, rad, s, °C or N. Columns and settings say their unit in their name.

mod dataset;
mod decision;
mod error;
mod format;
mod identity;
mod input_uncertainty;
mod limit;
mod model;
mod monitor;
mod observations;
mod parallel;
mod pattern;
mod pose_table;
mod problem;
mod registry;
mod result;
pub mod rotation;
mod serial;
mod series;
mod settings;
mod stage;
mod uncertainty;
mod unit;

pub use dataset::{Column, ColumnHeader, Dataset, RowOrigin, Values};
pub use decision::{Decision, Rule};
pub use error::{Class, Convergence, Error, Place, Result, nearest};
pub use format::FileFormat;
pub use identity::Certificate;
pub use input_uncertainty::{Ids, InputUncertainty, PooledRepeats, RowUncertainty, SharedError};
pub use limit::Limit;
pub use model::{
    Absent, Axis, AxisKind, Branch, ErrorFunction, KinematicModel, ModelInfo, MotionError, Parameter, ParameterRole,
    Period, PoseBatch, Poses, PosesMut, StatusColumn, StatusRole, Variable,
};
pub use monitor::{Event, Monitor};
pub use observations::{
    Approach, Contact, Equations, Feature, KnownInput, Layout, NominalReading, Observations, ObservationsInfo,
    Orientation, RankPoint, Row, RowBatch, Target,
};
pub use parallel::in_parallel;
pub use pattern::matches;
pub use pose_table::{ColumnNaming, PoseTable, StatusSource, plain_naming, pose_columns};
pub use problem::{Block, CHUNK, Considered, Evaluation, Input, ObservationSet, Owner, Problem, Scatter, Unknown};
pub use registry::{Basis, Build, Constructor, Context, Kind, Origin, Plugin, Provider, Registry};
pub use result::{
    CALIBRATION_FORMAT, Calibration, Combination, CombinedAgreement, ConsideredInput, Contribution, Correlated,
    DataRecord, Estimated, Figure, Findings, FitReport, GumComparison, Identifiability, JointCoverage, ModelRecord,
    MonteCarlo, NamedCovariance, NullVector, Outlier, ParameterBudget, SameMotion, Selection, SelectionDirection,
    SelectionStep, SimulatedParameter, Status, Termination, UncertaintyBudget, VERDICTS_FORMAT, VarianceFactor,
    Verdict,
};
pub use series::{EvenSeries, Series};
pub use settings::{
    Label, Names, PathItem, SettingsError, from_settings, not_negative, path_text, positive, schema_of,
};
pub use stage::{Artefact, Estimate, Export, ExportedFile, Fit, Ingest, InputFile, Model, Validate};
pub use uncertainty::{CovarianceBlock, EquationUncertainty, Pooled};
pub use unit::{Quantity, Unit};

/// Re-exported so that a plugin registers with the very version that the registry collects.
pub use inventory;
