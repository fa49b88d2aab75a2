//! Results: calibrations, their data and identifiability, verdicts, decision rules, and the numbers of the file formats.

mod budget;
mod checks;
mod covariance;
mod decision;
mod fit;
mod format;
mod identifiability;
mod identity;
mod limit;
mod part;
mod verdict;
mod weighed;

pub use budget::{
    Contribution, Correlated, GumComparison, JointCoverage, MonteCarlo, ParameterBudget, Samples, SimulatedParameter,
    UncertaintyBudget,
};
pub use covariance::NamedCovariance;
pub use decision::{Decision, Rule, normal_below};
pub use fit::{
    CALIBRATION_FORMAT, Calibration, CombinedAgreement, ConsideredInput, DataRecord, Estimated, FitReport, Group,
    ImplausibleValue, ModelRecord, Outlier, PredictedStructure, Selection, SelectionByPrediction, SelectionDirection,
    SelectionStep, Status, VarianceFactor,
};
pub use format::FileFormat;
pub use identifiability::{Combination, EquivalentMotionError, Identifiability, WeakDirection};
pub use identity::Certificate;
pub use limit::{Limit, rule_or_name, schema_of_rules};
pub use part::{AskedOfPart, PartEvidence, ResidualSums, SizeSums, Triangle};
pub use verdict::{Figure, Findings, VERDICTS_FORMAT, Verdict};
pub use weighed::{Histogram, MOST_OUTLIERS, WeighedSums};
