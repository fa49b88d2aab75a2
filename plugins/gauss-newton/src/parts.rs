//! The estimate from rows in parts, none of which has all.

use abbe_core::{Calibration, Error, Identifiability, Parts, Problem, Result};
use abbe_estimation::{EstimatorSolution, RowsInParts, confounded, identifiability};
use abbe_numerics::Solution;

use crate::GaussNewton;
use crate::settings::{OnConfounded, Variance};

/// What to do about a setting that needs all rows.
const AT_ONCE: &str =
    "leave it out, or estimate all rows at once: `abbe run`, without `batch_rows` where they are read";

impl GaussNewton {
    /// The estimate from parts: the iteration of all rows at once, on the triangles of parts.
    pub(crate) fn of_parts(&self, problem: &Problem, parts: &dyn Parts) -> Result<Calibration> {
        self.check_settings_for_parts()?;
        let rows = RowsInParts::new(problem, parts);
        let nominal = rows.at_nominal_geometry()?;
        if self.determined(&nominal).is_some() {
            return Err(confounded(&identifiability(problem, &nominal, self.settings.rank_tolerance)));
        }
        let options = self.options(self.settings.tolerance, false);
        let Solution { x, iterations, last_step, gradient_cosine, .. } =
            self.iterate(&rows, &problem.start(), None, &options)?;
        let solved = EstimatorSolution {
            x,
            factor: None,
            robust: None,
            iterations,
            last_step: Some(last_step),
            gradient_cosine: Some(gradient_cosine),
        };
        self.evaluation(true).calibration_of_parts(&rows, solved)
    }

    /// What the rows of all parts determine.
    pub(crate) fn identified_parts(&self, problem: &Problem, parts: &dyn Parts) -> Result<Identifiability> {
        self.check_settings_for_parts()?;
        self.evaluation(true).identify_parts(&RowsInParts::new(problem, parts))
    }

    /// Refuses settings that need all residuals at once.
    pub(crate) fn check_settings_for_parts(&self) -> Result<()> {
        let refused = |setting: &str, why: &str| {
            let message = format!("`{setting}` needs all rows at once ({why}), and these rows are in parts");
            Err(Error::usage(message).help(AT_ONCE).setting(setting))
        };
        if self.settings.robust.is_some() {
            return refused("robust", "weights follow from the scatter of all residuals");
        }
        if self.settings.select.is_some() {
            return refused("select", "terms are tried one after another");
        }
        if self.settings.variance == Variance::PerStage {
            return refused("variance", "factors follow from the residuals of each stage");
        }
        if self.settings.on_confounded != OnConfounded::Error {
            return refused("on_confounded", "what is lost is tried with other values");
        }
        Ok(())
    }
}
