//! Programs that measure a plan with a touch probe on a machine's control.
//!
//! A plan has touches ([`Touches`]): where the axes stand at nominal contact, and the normal there. [`Programme`] makes safe moves of
//! them, checked on the nominal machine against the artefact and other solids, and [`Measuring::files`] writes these in the language of a
//! control. What the programs log is described in `docs/measuring-log.md`.

mod controls;
pub mod language;
mod path;
mod programme;
mod settings;
mod solid;
#[cfg(test)]
mod tests;
mod timing;
mod touch;
mod ways;
mod world;

use abbe_core::{ExportedFile, KinematicModel, Result, Target};

pub use programme::{Block, ControlAxis, Positions, Programme, TouchBlock};
pub use settings::{Clearance, Control, FacetSize, Measuring, Pause, Section, TouchOrder, Units, Unreachable};
pub use solid::Solid;
pub use timing::Timing;
pub use touch::{Touch, Touches};

/// The file of the plan that the programs belong to.
pub const PLAN: &str = "plan.csv";

/// What was written for a plan.
pub struct Written {
    /// The plan, the program and its dry run.
    pub files: Vec<ExportedFile>,
    /// What the moves of the program take, s.
    pub seconds: f64,
}

impl Measuring {
    /// The plan as a table, the measuring program and that of a dry run. `targets` are all nominal touches of the artefact, whose
    /// features are in the way even if the plan does not touch them.
    ///
    /// Fails as [`Programme::new`] does, and for what the control cannot do.
    pub fn files(&self, touches: &Touches, targets: &[Target], model: &dyn KinematicModel) -> Result<Written> {
        let program = Programme::new(self, touches, targets, model, None)?;
        if !program.left_out.is_empty() {
            tracing::warn!(
                "the program leaves out {} of {} touches, which cannot be reached; what the plan expects counts them, too: {}",
                program.left_out.len(),
                touches.list.len(),
                program.left_out.join("; ")
            );
        }
        let seconds = program.seconds;
        // The plan of a log has the touches that the program makes, and no others.
        let touches = &program.touches;
        let mut files = vec![ExportedFile { name: PLAN.to_owned(), content: touches.table(model).into_bytes() }];
        files.extend(controls::write(self, &program, false)?);
        if self.dry_run_mm > 0.0 {
            let program = Programme::new(self, touches, targets, model, Some(self.dry_run_mm))?;
            files.extend(controls::write(self, &program, true)?);
        }
        Ok(Written { files, seconds })
    }
}
