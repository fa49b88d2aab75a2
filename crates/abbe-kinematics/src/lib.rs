//! Serial chains in ISO 10791-6 notation: exact transforms of the structural loop, where each error acts, analytic
//! derivatives, and the first-order form.
//!
//! **Architecture invariant:** a chain knows six location and six motion errors of every axis, tool and workpiece set-up
//! errors. How these errors depend on commands and other statuses is defined in `abbe-errors`.

mod chain;
mod frame;
mod links;
mod notation;
mod number;
mod side_by_side;

pub use chain::{Chain, ChainAxis, Derivatives, ErrorFrame, Errors, Evaluation};
pub use links::{Link, denavit_hartenberg};
pub use notation::{ChainError, NamedAxis, StructuralLoop};
pub use side_by_side::{ByErrorAndCommand, EvaluatedPose, Evaluations, Given};
