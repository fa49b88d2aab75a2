//! `abbe correct`: measured positions, corrected for the errors of the machine that measured them.

use std::path::PathBuf;

use abbe_compensation::{MeasuredPoints, SetPoints, cost_of_leaving_out};
use abbe_core::{Error, KinematicModel, Registry, Result, matches};
use clap::Args;
use serde_json::json;

use crate::calibrated::{Asked, Known, counted};
use crate::outputs::{Written, is_free};
use abbe_report::number::short;

/// What `abbe correct` is asked for.
#[derive(Debug, Clone, Args)]
pub struct Correct {
    #[command(flatten)]
    calibrated: Asked,
    /// CSV file with the measured positions: a column for each axis (X_mm, B_deg), and for all that its errors depend on.
    points: PathBuf,
    /// File for the same table with the corrected positions in the table frame and their covariance. It must not exist.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Tell what it costs to leave these parameters out, by patterns: `EA?[*]`. May be repeated.
    #[arg(long, value_name = "PATTERN")]
    without: Vec<String>,
    /// Largest correction of a position, mm; beyond it the errors are not believed.
    #[arg(long, value_name = "MM", default_value_t = 1.0, value_parser = crate::calibrated::positive_mm, allow_negative_numbers = true)]
    largest_correction_mm: f64,
    /// Print the figures as JSON.
    #[arg(long)]
    pub json: bool,
}

impl Correct {
    /// Carries it out; nothing is written yet.
    pub fn run(&self, registry: &Registry) -> Result<Written> {
        self.out.iter().try_for_each(|path| is_free(path))?;
        let Known { calibration, model, time, .. } = self.calibrated.read(registry)?;
        let model = model.as_ref();
        self.check_patterns(model)?;
        let points = SetPoints::read_at(&self.points, model, time)?;
        let found = MeasuredPoints::of(model, &calibration, points, self.largest_correction_mm)?;
        for (axis, reversal) in found.guessed_directions(model, &calibration)? {
            let name = &model.info().axes[axis].name;
            tracing::warn!(
                "there is no column `dir_{name}`: {name} is taken to come to each position from that of the row before; from the other \
                 side the tip is {} µm away, at most",
                short(reversal * 1e3)
            );
        }
        let files =
            self.out.iter().map(|out| Ok((out.clone(), found.text()?.into_bytes()))).collect::<Result<Vec<_>>>()?;
        let corrections = found.corrections();
        let is_left_out = |name: &str| self.without.iter().any(|pattern| matches(pattern, name));
        let cost = match self.without.is_empty() {
            true => None,
            false => Some(cost_of_leaving_out(model, &calibration, found.points.statuses(), is_left_out)?),
        };
        let uncertainty = found.largest_uncertainty() * 1e3;
        if self.json {
            let text = crate::pretty(&json!({
                "points": found.points.len(),
                "correction_max_um": corrections.max * 1e3,
                "correction_rms_um": corrections.rms * 1e3,
                "largest_standard_uncertainty_um": uncertainty,
                "without": self.without,
                "without_max_um": cost.map(|cost| cost.max * 1e3),
                "without_rms_um": cost.map(|cost| cost.rms * 1e3),
                "files": files.iter().map(|(path, _)| path.display().to_string()).collect::<Vec<_>>(),
            }))?;
            return Ok(Written { text, files });
        }
        let mut text = format!(
            "{}\n\nCorrections: {} µm at most, {} µm RMS\nLargest standard uncertainty, from the calibration: {} µm\n",
            counted(found.points.len(), "point"),
            short(corrections.max * 1e3),
            short(corrections.rms * 1e3),
            short(uncertainty)
        );
        if let Some(cost) = cost {
            let (max, rms) = (short(cost.max * 1e3), short(cost.rms * 1e3));
            text.push_str(&format!("Without {}: {max} µm off at most, {rms} µm RMS\n", self.without.join(", ")));
        }
        for (path, _) in &files {
            text.push_str(&format!("\nWritten: {}\n", path.display()));
        }
        Ok(Written { text, files })
    }

    /// Fails for a pattern that no parameter of the model matches.
    fn check_patterns(&self, model: &dyn KinematicModel) -> Result<()> {
        let names = || model.info().parameters.iter().map(|parameter| parameter.name.as_str());
        match self.without.iter().find(|pattern| !names().any(|name| matches(pattern, name))) {
            Some(pattern) => {
                let error = Error::usage(format!("`--without {pattern}` matches no parameter of the machine"));
                Err(error.suggest(pattern, names()))
            }
            None => Ok(()),
        }
    }
}
