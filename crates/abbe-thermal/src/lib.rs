//! Thermal states of a machine from logs of sensors, and what follows them.
//!
//! # Model
//! An input u (a temperature above its reference, a spindle speed) drives a state z with the time constant T (Soons 1993, 3.4,
//! eq. 3.41 to 3.55 and 3.63 to 3.66; there x = T z):
//!
//! `T dz/dt = u - z`
//!
//! An output y is a sum of states, and of inputs themselves: `y = sum G_ij z_ij + sum G_i u_i`. A gain G is the gain at rest: once u
//! has stood still for long, z = u.
//!
//! Between two samples an input runs straight ([`Hold::FirstOrder`]) or stays ([`Hold::ZeroOrder`]). Then the state is known exactly
//! at any time: with a = dt/T and e = exp(-a)
//!
//! `z(t + dt) = e z + (1 - e) u0 + (1 - (1 - e)/a) (u1 - u0)`
//!
//! # Estimation
//! For given time constants gains are linear. [`fit`] searches the logarithms of the time constants alone, by variable projection
//! (Golub, Pereyra 1973; Kaufman 1975), for all outputs together.
//!
//! # Units
//! Times in s; inputs and outputs in any unit, gains in theirs.

mod basis;
mod beam;
mod doubts;
mod fit;
mod fitted;
mod log;
mod response;
mod select;
mod starts;
mod stuck;

pub use beam::{Beam, SectionDisplacement, Segment, TemperaturePlane};
pub use doubts::{exchanged, in_another_unit, not_copied, quieter};
pub use fit::{Fitted, Output, Readings, Structure, fit};
pub use fitted::{Bootstrap, Terms};
pub use log::{Counting, Hold, Reference, SensorLog, SensorNoise, possible_temperature, sensor_faults};
pub use response::{History, Response};
pub use select::{PARTS, Tried, select};
pub use stuck::{is_dead, stuck, stuck_part};
