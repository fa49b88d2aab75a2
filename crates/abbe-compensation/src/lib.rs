//! Corrected set-points: commands with which a machine with known errors puts its tool where the machine without errors would.
//!
//! The goal of a set-point is the nominal pose of the same command: tip position and tool axis in the table frame. A
//! [`Compensator`] looks for commands `q` with
//!
//! `tip(q; errors) = tip(q0; nominal)` and, with five axes, `axis(q; errors) = axis(q0; nominal)`
//!
//! by Newton's method on the exact kinematics (Soons 1993, 2.3.5 and 5.1, whose step is [`Method::FirstOrder`]). Rotary axes correct
//! the tool axis, linear axes then correct the tip. Directions of approach stay those of the programmed path.
//!
//! What a machine cannot correct is told for every set-point ([`Correction`]): the tool axis where its rotary axes do not span both
//! tilts, corrections beyond the declared bound near a pole, ends of travel.

pub mod active;
mod calibrated;
mod compensator;
mod figures;
mod measured;
mod path;
mod remaining;
pub mod rigid;
mod set_points;
mod settings;
mod step;
mod table_source;
mod tables;
mod temperatures;
mod thermal;
mod thermal_lines;

pub use calibrated::{check_confounded, check_confounded_anywhere, extrapolated};
pub use compensator::{Compensator, Correction, Deviation};
pub use figures::{Figures, ReversedMoves, Spread, figures, reversed_moves};
pub use measured::{Measured, MeasuredPoints, cost_of_leaving_out};
pub use path::{CompensatedPath, MARK};
pub use remaining::{Expected, Remaining, Trials, remaining};
pub use set_points::SetPoints;
pub use settings::{Correct, Method, Settings, Travel};
pub use table_source::TableSource;
pub use tables::{AxisTable, AxisTables};
pub use temperatures::{Temperatures, check_no_drift, follows_log};
pub use thermal::{ThermalResponses, ThermalState};
pub use thermal_lines::{LineSettings, ThermalLine, ThermalLines};
