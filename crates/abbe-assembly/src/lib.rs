//! One data set from many files, whatever their format: which files a pattern means, constants, joined tables, directions and
//! velocities of axes, rows that are taken or left out, means of repeated rows.
//!
//! A reader of files has a function that makes a data set of one file, and one that does so without rows; [`Assembly`] does the rest.

mod assembly;
mod average;
mod batches;
mod files;
mod motion;

pub use assembly::{Assembly, Filters, Join, Load, Paths, Ranges, emptied, tell_left_out, without_rows};
pub use average::Average;
pub use batches::{InBatches, RowsOfFile, check_batches};
pub use files::Source;
pub use motion::Motion;
