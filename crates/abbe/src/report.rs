//! The page about a run.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use abbe_core::{Error, Registry, Result};
use abbe_engine::{Outcome, REPORT};
use abbe_report::{Run, csv, markdown, page};

use crate::browser;
use crate::outputs::{Written, is_free};

/// Adds the page about a run, and the residuals that it is made of, to the results. None, with a warning, if it cannot be made: that
/// costs no result. It is made of results that are there, so that a time limit which ends now does not count.
pub fn attach(outcome: &mut Outcome) -> Option<Run> {
    for fit in &mut outcome.fits {
        let problem = fit.problem.watched_by(fit.problem.monitor.without_time_limit());
        fit.problem = Arc::new(problem);
    }
    match Run::of(outcome) {
        Ok((run, tables)) => {
            outcome.attached = tables;
            outcome.attached.push((REPORT.into(), page(std::slice::from_ref(&run)).into_bytes()));
            Some(run)
        }
        Err(error) => {
            tracing::warn!("there is no {REPORT}, and there are no tables of residuals: {error}");
            None
        }
    }
}

/// What results are written as.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Format {
    Page,
    Paper,
    Markdown,
    Table,
}

impl Format {
    /// The format that the name of a file asks for.
    fn of(file: &Path) -> Result<Self> {
        let ending = file.extension().and_then(|ending| ending.to_str()).unwrap_or_default().to_ascii_lowercase();
        match ending.as_str() {
            "html" | "htm" => Ok(Self::Page),
            "pdf" => Ok(Self::Paper),
            "md" => Ok(Self::Markdown),
            "csv" => Ok(Self::Table),
            _ => {
                let message = format!("the name of {} does not say what to write", file.display());
                Err(Error::usage(message).help("end it with .html, .pdf, .md (Markdown) or .csv"))
            }
        }
    }
}

/// Several runs or calibrations beside each other, in the format that the name of the file asks for.
pub fn beside(results: &[PathBuf], out: PathBuf, registry: &Registry) -> Result<Written> {
    let format = Format::of(&out)?;
    is_free(&out)?;
    let mut runs = Vec::new();
    for path in results {
        let mut run = Run::read(path, registry)?;
        if results.len() > 1 {
            run.name = path.display().to_string();
        }
        runs.push(run);
    }
    let content = match format {
        Format::Page => page(&runs).into_bytes(),
        Format::Paper => browser::pdf(&page(&runs))?,
        Format::Markdown => markdown(&runs).into_bytes(),
        Format::Table => csv(&runs)?.into_bytes(),
    };
    Ok(Written { text: format!("Written: {}\n", out.display()), files: vec![(out, content)] })
}
