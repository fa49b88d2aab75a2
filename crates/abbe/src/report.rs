//! The page about a run.

use std::path::PathBuf;

use abbe_core::{Registry, Result};
use abbe_engine::{Outcome, REPORT};
use abbe_report::{Run, page};

use crate::calibrated::Written;
use crate::doubts;

/// Adds the page, and the residuals that it is made of, to the results. None, with a warning, if it cannot be made: that
/// costs no result.
pub fn attach(outcome: &mut Outcome) -> Option<Run> {
    let doubts = doubts::remarks(&outcome.fits);
    outcome.remarks.extend(doubts);
    match Run::of(outcome) {
        Ok((run, tables)) => {
            outcome.attached = tables;
            outcome.attached.push((REPORT.into(), page(std::slice::from_ref(&run)).into_bytes()));
            Some(run)
        }
        Err(error) => {
            tracing::warn!("there is no {REPORT}: {error}");
            None
        }
    }
}

/// One page about several runs or calibrations.
pub fn beside(results: &[PathBuf], out: PathBuf, registry: &Registry) -> Result<Written> {
    let mut runs = Vec::new();
    for path in results {
        let mut run = Run::read(path, registry)?;
        if results.len() > 1 {
            run.name = path.display().to_string();
        }
        runs.push(run);
    }
    Ok(Written { text: format!("Written: {}\n", out.display()), files: vec![(out, page(&runs))] })
}
