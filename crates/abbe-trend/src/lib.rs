//! What repeated calibrations of one machine tell: charts of every parameter with the calibrations' own uncertainties, what
//! has changed and since when, whether the artefact or the machine explains it, and when to measure again.
//!
//! Everything here is a function of numbers: [`analyse`] takes tests and series, and gives an [`Analysis`].

mod again;
mod analysis;
mod calibrations;
mod change;
mod chart;
mod events;
mod follow;
mod least_squares;
mod order;
pub mod run_length;
mod source;
mod told;
mod volumetric;

pub use again::{Again, AgainRule, Forecast, MOST, again};
pub use analysis::{
    Analysis, Event, ParameterTrend, Regressor, Seasonal, Series, Settings, State, Target, Test, analyse,
};
pub use calibrations::{History, Quality, Tested, history};
pub use change::{Change, Uncertain};
pub use chart::{Alarms, ChartDesign, ChartLimits, Charts};
pub use follow::follow;
pub use order::{TimedTest, out_of_order};
pub use source::{Differences, Explained, SharedInput, explained_by};
pub use told::{findings, rounded, sentences, unit_factor};
pub use volumetric::{VOLUMETRIC_LARGEST, VOLUMETRIC_RMS, add_volumetric};
