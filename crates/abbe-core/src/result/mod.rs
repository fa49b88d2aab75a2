//! What comes out: calibrations, what they rest on, and verdicts.

mod budget;
mod covariance;
mod fit;
mod identifiability;
mod verdict;

pub use budget::{
    Contribution, Correlated, GumComparison, JointCoverage, MonteCarlo, ParameterBudget, SimulatedParameter,
    UncertaintyBudget,
};
pub use covariance::NamedCovariance;
pub use fit::{
    CALIBRATION_FORMAT, Calibration, CombinedAgreement, ConsideredInput, DataRecord, Estimated, FitReport, ModelRecord,
    Outlier, Selection, SelectionDirection, SelectionStep, Status, Termination, VarianceFactor,
};
pub use identifiability::{Combination, Identifiability, NullVector, SameMotion};
pub use verdict::{Figure, Findings, VERDICTS_FORMAT, Verdict};
