//! Building blocks for settings of stages: errors that say which setting is wrong, units, series of numbers, patterns of
//! names, and functions that read settings from JSON; with them the progress of long work, its cancellation, and its threads.
//!
//! In memory every quantity is in mm, rad, s, °C or N. Columns and settings say their unit in their name.
//!
//! ```
//! use abbe_settings::{Quantity, from_settings, positive};
//! use serde::Deserialize;
//!
//! #[derive(Debug, Deserialize)]
//! #[serde(deny_unknown_fields)]
//! struct Settings {
//!     step_mm: f64,
//! }
//!
//! let wrong = from_settings::<Settings>(&serde_json::json!({ "step_m": 1 })).unwrap_err();
//! assert_eq!(wrong.help.as_deref(), Some("did you mean `step_mm`?"));
//! assert!(positive("step_mm", -1.0).is_err());
//! assert_eq!(Quantity::of_column("X_um").0, "X");
//! ```

mod error;
mod harmless;
mod json;
mod monitor;
mod parallel;
mod pattern;
pub mod ranges;
pub mod serial;
mod series;
mod settings;
mod unit;
mod whole;

pub use error::{Class, Convergence, Error, Place, Result, Termination, nearest};
pub use harmless::{harmless, harmless_json};
pub use json::{from_json, value_in_json};
pub use monitor::{Event, Monitor};
pub use parallel::{both, free_threads, in_parallel};
pub use pattern::matches;
pub use series::{EvenSeries, Series};
pub use settings::{
    Label, Names, PathItem, SettingsError, from_settings, from_settings_in_range, not_negative, path_text, positive,
    schema_of,
};
pub use unit::{Quantity, Unit};
pub use whole::Whole;
