//! The estimate from rows in parts, none of which has all.

use std::collections::BTreeMap;
use std::sync::Arc;

use abbe_core::{
    AskedOfPart, Calibration, Error, Identifiability, PartEvidence, Parts, Problem, QuestionToRows, Result, Unknown,
};
use abbe_estimation::{EstimatorSolution, Judgement, RowsInParts, confounded, identifiability, part_evidence};
use abbe_numerics::{End, HuberPoint, Options, Solution, huber_point, solve_from, solve_in_passes};

use crate::GaussNewton;
use crate::convergence::not_converged;
use crate::settings::{OnConfounded, Variance};

/// A problem whose rows are all here, as one part.
struct Alone<'a>(&'a Problem);

impl Parts for Alone<'_> {
    fn count(&self) -> usize {
        1
    }

    fn evidence(&self, _: usize, asked: AskedOfPart, at: &BTreeMap<String, f64>) -> Result<Arc<PartEvidence>> {
        let values = self.0.unknowns.iter().zip(self.0.start());
        let values: Vec<f64> = values.map(|(unknown, start)| at.get(&unknown.name).copied().unwrap_or(start)).collect();
        part_evidence(self.0, asked, &values).map(Arc::new)
    }

    fn ask(&self, question: &QuestionToRows<'_>) -> Result<Option<PartEvidence>> {
        question(self.0).map(Some)
    }
}

fn refused(setting: &str, why: &str) -> Result<()> {
    let message = format!("`{setting}` needs all rows at once ({why}), and these rows are in parts");
    Err(Error::usage(message).help(AT_ONCE).setting(setting))
}

/// What to do about a setting that needs all rows.
const AT_ONCE: &str =
    "leave it out, or estimate all rows at once: `abbe run`, without `batch_rows` where they are read";

impl GaussNewton {
    /// The estimate from parts: the iteration of all rows at once, on the triangles of parts. Where rows can be read again, it begins
    /// where a sample of them ends.
    pub(crate) fn of_parts(&self, problem: &Problem, parts: &dyn Parts) -> Result<Calibration> {
        self.check_settings_for_batches()?;
        let rows = RowsInParts::new(problem, parts);
        let nominal = rows.at_nominal_geometry()?;
        if self.determined(&nominal).is_some() {
            return Err(confounded(&identifiability(problem, &nominal, self.settings.rank_tolerance)));
        }
        let options = self.options(self.settings.tolerance, false);
        let start = self.start_of_parts(problem, parts)?;
        let (solution, weighing) = match (options.robust, start) {
            (None, start) => {
                let start = start.map_or_else(|| problem.start(), |at| at.x);
                let options = Options { robust: None, ..options };
                (solve_from(&rows, &start, None, &options)?, None)
            }
            (Some(robust), start) => {
                let start = match start {
                    Some(start) => start,
                    None => {
                        let plain = Options { robust: None, ..options };
                        RowsInParts::huber_start(self.iterate(&rows, &problem.start(), None, &plain)?.x)
                    }
                };
                let (solution, weighing) = solve_in_passes(&rows, start, robust, &options)?;
                (solution, Some(weighing))
            }
        };
        if solution.end != End::Converged {
            return Err(not_converged(&solution, &options));
        }
        let Solution { x, iterations, last_step, gradient_cosine, .. } = solution;
        let solved = EstimatorSolution {
            x,
            factor: None,
            robust: None,
            iterations,
            last_step: Some(last_step),
            gradient_cosine: Some(gradient_cosine),
        };
        self.evaluation(true).calibration_of_parts(&rows, solved, weighing.as_ref())
    }

    /// Where a sample of the rows ends; none where there is none, or where it does not determine what it sees. Unknowns that it does not
    /// see stay at their start values. The scale of its residuals says how rows are weighed first.
    fn start_of_parts(&self, problem: &Problem, parts: &dyn Parts) -> Result<Option<HuberPoint>> {
        let Some(sample) = parts.sample()? else { return Ok(None) };
        let usual = |error: Error| if error.fatal { Err(error) } else { Ok(None) };
        match self.solved_sample(&sample) {
            Err(error) => usual(error),
            Ok(None) => Ok(None),
            Ok(Some(found)) => {
                let known = |unknown: &Unknown| sample.unknowns.iter().position(|known| known.name == unknown.name);
                let values = problem.unknowns.iter().zip(problem.start());
                let x = values.map(|(unknown, start)| known(unknown).map_or(start, |place| found.x[place])).collect();
                // Without a factor of all rows these count as if they had no leverage.
                Ok(Some(HuberPoint { x, root: None, scale: found.scale }))
            }
        }
    }

    fn solved_sample(&self, sample: &Problem) -> Result<Option<HuberPoint>> {
        if sample.unknowns.is_empty() || sample.equations() < sample.unknowns.len() {
            return Ok(None);
        }
        let judged = Judgement::new(sample, None)?;
        if self.determined(judged.factor()).is_some() {
            return Ok(None);
        }
        let options = Options { robust: None, ..self.options(self.settings.tolerance, false) };
        let x = self.iterate(&self.weighted(sample)?, &sample.start(), None, &options)?.x;
        let start = RowsInParts::huber_start(x);
        if self.robust().is_none() {
            return Ok(Some(start));
        }
        let alone = Alone(sample);
        huber_point(&RowsInParts::new(sample, &alone), start)
    }

    /// What the rows of all parts determine.
    pub(crate) fn identified_parts(&self, problem: &Problem, parts: &dyn Parts) -> Result<Identifiability> {
        self.check_settings_for_batches()?;
        self.evaluation(true).identify_parts(&RowsInParts::new(problem, parts))
    }

    /// Refuses settings that need all residuals at once.
    pub(crate) fn check_settings_for_parts(&self) -> Result<()> {
        if self.settings.robust.is_some() {
            return refused("robust", "weights follow from the scatter of all residuals");
        }
        self.check_settings_for_batches()
    }

    /// The same for rows that can be read again and again.
    pub(crate) fn check_settings_for_batches(&self) -> Result<()> {
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
