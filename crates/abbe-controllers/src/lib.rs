//! Dialects of machine controls, and NC programs that are corrected for the errors of a machine.
//!
//! Many controls take no table of errors. Then the program is corrected: [`compensate`] rewrites it so that a machine with known
//! errors moves its tool along the path that the machine without errors would have made. Text that is no motion stays byte for
//! byte. What is not understood is refused with line, column and word; nothing is passed in silence. [`check`] reads a corrected
//! program again and tells what remains of the errors along its path.
//!
//! Corrections are those of [`abbe_compensation::Compensator`] (Soons 1993, 2.3.5).

mod block;
mod canonical;
mod check;
mod dialect;
mod emit;
mod fit;
mod geometry;
mod klartext;
mod lexer;
mod machine;
mod modal;
mod options;
mod plan;
mod program;
mod refusal;
mod tools;

pub use canonical::{Canonical, Prepared, prepare};
pub use check::{Checked, Worst, check};
pub use dialect::{Dialect, table};
pub use geometry::{Coordinates, LETTERS, is_rotary, place};
pub use machine::Machine;
pub use modal::MachineOf;
pub use options::{MARK, Options};
pub use program::{Summary, compensate, mark};
pub use tools::Tools;
