//! The estimate from rows in parts, none of which has all.

use abbe_core::{Calibration, Error, Identifiability, Owner, ParameterRole, Parts, Problem, Result, Unknown};
use abbe_estimation::{
    ChangedParts, EstimatorSolution, Judgement, RowsAtHand, RowsInParts, SolutionOfParts, VarianceComponents,
    components_of_parts, confounded, identifiability, with_factors_found,
};
use abbe_numerics::{
    End, Factor, HuberPoint, LeastSquares, Options, Solution, huber_point, solve_from, solve_in_passes,
};

use crate::GaussNewton;
use crate::convergence::converged;
use crate::select::SelectBy;
use crate::settings::{OnConfounded, Variance};

/// Where a sample of the rows ends.
struct SolvedSample {
    at: HuberPoint,
    /// Whether it determines all unknowns of the whole problem.
    determines_all: bool,
}

/// How much better than rank asks for a sample has to determine all unknowns: with more rows, columns differ more in size.
const MARGIN: f64 = 1e3;

/// Rounding of a sum of squares.
const ROUNDING: f64 = 1e-12;

/// Size of a step, in standard uncertainties of all rows together, that changes nothing of what rows tell beside the values.
const HARDLY_OFF: f64 = 1e-5;

/// Size of a step, in standard uncertainties of all rows together, that changes their triangle by next to nothing: the steps after it take
/// the triangle from before it. A column that is nearly zero changes most: in an estimate of 200,000 touches, steps after one of 300 shrank
/// by 1e-3 each with the triangle from before it, and by 5e-5 with their own.
const SAME_TRIANGLE: f64 = 1.0;

/// How much shorter each step is near the solution, at least.
const SHRINKS: f64 = 1e-2;

fn refused(setting: &str, why: &str) -> Result<()> {
    let message = format!("`{setting}` needs all rows at once ({why}), and these rows are in parts");
    Err(Error::usage(message).help(AT_ONCE).setting(setting))
}

/// What to do about a setting that needs all rows.
const AT_ONCE: &str =
    "leave it out, or estimate all rows at once: `abbe run`, without `batch_rows` where they are read";

/// An unknown that shapes a function whose size is zero at the start: rows at once are estimated without it first.
fn idle_shape<'a>(problem: &'a Problem, nominal: &Factor) -> Option<&'a Unknown> {
    let parameters = &problem.model.info().parameters;
    let shapes =
        |unknown: &Unknown| unknown.owner == Owner::Machine && parameters[unknown.index].role == ParameterRole::Shape;
    let idle = problem.unknowns.iter().zip(nominal.norms()).filter(|(unknown, norm)| **norm == 0.0 && shapes(unknown));
    idle.map(|(unknown, _)| unknown).next()
}

fn needs_start(shape: &Unknown) -> Error {
    let message = format!(
        "`{}` needs all rows at once (as long as what it shapes is zero it has no effect, so that the rest comes first), and these rows are in \
         parts",
        shape.name
    );
    Error::usage(message).help(AT_ONCE).setting("parameters")
}

impl GaussNewton {
    /// The estimate from parts, of the significant unknowns where they are selected.
    pub(crate) fn of_parts(&self, problem: &Problem, parts: &dyn Parts, explained: bool) -> Result<Calibration> {
        self.check_settings_for_batches()?;
        match &self.settings.select {
            None => self.all_of_parts(problem, parts, explained),
            Some(select) => self.selected_of_parts(problem, parts, select, explained),
        }
    }

    /// The estimate of all unknowns: the iteration of all rows at once, on the triangles of parts. Where rows can be read again, it begins
    /// where a sample of them ends.
    pub(crate) fn all_of_parts(&self, problem: &Problem, parts: &dyn Parts, explained: bool) -> Result<Calibration> {
        if let Some(rows) = self.eliminating(problem, parts)? {
            return self.of_eliminated(&rows, explained);
        }
        let rows = RowsInParts::new(problem, parts);
        if problem.unknowns.is_empty() {
            return self.parts_as_they_are(&rows, explained);
        }
        let solved = self.solved_parts(&rows)?;
        match self.settings.variance {
            Variance::Common => self.calibrated(&rows, solved, None, explained),
            Variance::PerStage => self.with_factors(&rows, &solved.0.x, explained),
        }
    }

    /// The solution of the rows as their uncertainties are stated, and what they tell there.
    fn solved_parts(&self, rows: &RowsInParts<'_>) -> Result<(Solution, SolutionOfParts)> {
        let (problem, parts) = (rows.problem(), rows.parts());
        let sample = self.start_of_parts(problem, parts)?;
        // More rows tell no less: all of them are judged where the sample leaves something open.
        if !sample.as_ref().is_some_and(|sample| sample.determines_all) {
            let nominal = rows.at_nominal_geometry()?;
            if self.determined(&nominal).is_some() {
                if let Some(shape) = idle_shape(problem, &nominal) {
                    return Err(needs_start(shape));
                }
                return Err(confounded(&identifiability(problem, &nominal, self.settings.rank_tolerance)));
            }
        }
        let start = sample.map(|sample| sample.at);
        let options = self.options(self.settings.tolerance, false);
        let plain = Options { robust: None, ..options };
        match (options.robust, start) {
            (None, None) => self.of_plain_parts(rows, solve_from(rows, &problem.start(), None, &plain)?),
            (None, Some(start)) => self.begun_near(rows, &start.x, &plain),
            (Some(robust), start) => {
                let start = match start {
                    Some(start) => start,
                    None => RowsInParts::huber_start(self.iterate(rows, &problem.start(), None, &plain)?.x),
                };
                let (solution, weighing) = solve_in_passes(rows, start, robust, &options)?;
                let solution = converged(solution, &options)?;
                let told = rows.at_solution(&solution.x, Some(&weighing))?;
                Ok((solution, told))
            }
        }
    }

    /// The estimate with a factor on the uncertainties of each stage, from the solution without them.
    fn with_factors(&self, rows: &RowsInParts<'_>, x: &[f64], explained: bool) -> Result<Calibration> {
        let problem = rows.problem();
        let components = components_of_parts(rows, x)?;
        components.warn(problem);
        let factors = components.named(problem);
        let scaled = |_: usize, part: &Problem| Ok(with_factors_found(part, &factors));
        let parts = ChangedParts::new(rows.parts(), &scaled);
        let rows = RowsInParts::new(problem, &parts);
        let options = Options { robust: None, ..self.options(self.settings.tolerance, false) };
        let solved = self.begun_near(&rows, &components.x, &options)?;
        self.calibrated(&rows, solved, Some(&components), explained)
    }

    /// The calibration from a solution of rows, and from what they tell there.
    fn calibrated(
        &self,
        rows: &RowsInParts<'_>,
        (solution, told): (Solution, SolutionOfParts),
        components: Option<&VarianceComponents>,
        explained: bool,
    ) -> Result<Calibration> {
        let Solution { x, iterations, last_step, gradient_cosine, .. } = solution;
        let solved = EstimatorSolution {
            x,
            factor: None,
            robust: None,
            iterations,
            last_step: Some(last_step),
            gradient_cosine: Some(gradient_cosine),
        };
        self.evaluation(explained).calibration_of_parts(rows, solved, told, components)
    }

    /// The machine as it is: nothing is estimated.
    fn parts_as_they_are(&self, rows: &RowsInParts<'_>, explained: bool) -> Result<Calibration> {
        self.evaluation(explained).calibration_of_parts(rows, Self::unsolved(), rows.at_solution(&[], None)?, None)
    }

    /// The end of an iteration of plain least squares, and what all rows tell there.
    fn of_plain_parts(&self, rows: &RowsInParts<'_>, solution: Solution) -> Result<(Solution, SolutionOfParts)> {
        let solution = converged(solution, &Options { robust: None, ..self.options(self.settings.tolerance, false) })?;
        let told = rows.at_solution(&solution.x, None)?;
        Ok((solution, told))
    }

    /// The same from a start that is near the solution, with the triangle of the rows there. The pass from which the last step is expected to go tells all that is told at the
    /// solution, too. Where a step turns out longer than expected, the iteration goes on as from anywhere.
    fn begun_near(
        &self,
        rows: &RowsInParts<'_>,
        start: &[f64],
        options: &Options,
    ) -> Result<(Solution, SolutionOfParts)> {
        let goes_on = |x: &[f64], factor| self.of_plain_parts(rows, solve_from(rows, x, Some(factor), options)?);
        let (mut x, mut factor, mut shrinks) = (start.to_vec(), rows.factor(start, None)?, SHRINKS);
        for iterations in 1..options.iterations {
            let Some(step) = factor.step() else { return goes_on(&x, factor) };
            let size = factor.row_norm(&step);
            let next: Vec<f64> = x.iter().zip(&step).map(|(x, step)| x + step).collect();
            let found = match size <= SAME_TRIANGLE {
                true => rows.near(&factor, &next, size * shrinks <= HARDLY_OFF),
                false => rows.factor(&next, None).map(|factor| Some((factor, None))),
            };
            let (there, told) = match found {
                Ok(Some(found)) => found,
                Err(error) if error.fatal => return Err(error),
                Ok(None) | Err(_) => return goes_on(&x, factor),
            };
            let left = there.step().map(|step| (there.row_norm(&step), step));
            let Some((left, last)) = left.filter(|_| there.cost() <= factor.cost() * (1.0 + ROUNDING)) else {
                return goes_on(&x, factor);
            };
            rows.has_stepped(iterations, size);
            shrinks = left / size;
            (x, factor) = (next, there);
            if shrinks.is_nan() || shrinks > SHRINKS {
                return goes_on(&x, factor);
            }
            if let Some(told) = told.filter(|_| left <= HARDLY_OFF && left * shrinks <= options.tolerance) {
                x.iter_mut().zip(&last).for_each(|(x, last)| *x += last);
                let gradient_cosine = factor.gradient_cosine();
                let (iterations, end) = (iterations + 1, End::Converged);
                return Ok((
                    Solution { x, iterations, end, last_step: left, gradient_cosine, robust: None, factor },
                    told,
                ));
            }
        }
        goes_on(&x, factor)
    }

    /// Where a sample of the rows ends; none where there is none, or where it does not determine what it sees. Unknowns that it does not
    /// see stay at their start values. The scale of its residuals says how rows are weighed first.
    fn start_of_parts(&self, problem: &Problem, parts: &dyn Parts) -> Result<Option<SolvedSample>> {
        let Some(sample) = parts.sample()? else { return Ok(None) };
        let found = match self.solved_sample(&sample) {
            Err(error) if error.fatal => return Err(error),
            Ok(Some(found)) => found,
            Ok(None) | Err(_) => return Ok(None),
        };
        let known = |unknown: &Unknown| sample.unknowns.iter().position(|known| known.name == unknown.name);
        let values = problem.unknowns.iter().zip(problem.start());
        let x = values.map(|(unknown, start)| known(unknown).map_or(start, |place| found.at.x[place])).collect();
        // Without a factor of all rows these count as if they had no leverage.
        let at = HuberPoint { x, root: None, scale: found.at.scale };
        let sees_all = problem.unknowns.iter().all(|unknown| known(unknown).is_some());
        Ok(Some(SolvedSample { at, determines_all: found.determines_all && sees_all }))
    }

    fn solved_sample(&self, sample: &Problem) -> Result<Option<SolvedSample>> {
        if sample.unknowns.is_empty() || sample.equations() < sample.unknowns.len() {
            return Ok(None);
        }
        let judged = Judgement::new(sample, None)?;
        if self.determined(judged.factor()).is_some() {
            return Ok(None);
        }
        let determines_all =
            judged.factor().singular_values().rank(MARGIN * self.settings.rank_tolerance) == sample.unknowns.len();
        let options = Options { robust: None, ..self.options(self.settings.tolerance, false) };
        let x = self.iterate(&self.weighted(sample)?, &sample.start(), None, &options)?.x;
        let start = RowsInParts::huber_start(x);
        let at = match self.robust() {
            None => Some(start),
            Some(_) => huber_point(&RowsInParts::new(sample, &RowsAtHand(sample)), start)?,
        };
        Ok(at.map(|at| SolvedSample { at, determines_all }))
    }

    /// The values of the unknowns of all parts, from a start that is almost right.
    pub(crate) fn values_in_parts(&self, problem: &Problem, parts: &dyn Parts) -> Result<Vec<f64>> {
        // Other rows may select other terms.
        if self.settings.robust.is_some() || self.settings.select.is_some() {
            return Ok(problem.values_of(&self.of_parts(problem, parts, false)?));
        }
        self.check_settings_for_batches()?;
        let options = self.options(1e-6, true);
        if let Some(rows) = self.eliminating(problem, parts)? {
            return Ok(rows.solve(&problem.start(), &options)?.x);
        }
        Ok(self.iterate(&RowsInParts::new(problem, parts), &problem.start(), None, &options)?.x)
    }

    /// What the rows of all parts determine.
    pub(crate) fn identified_parts(&self, problem: &Problem, parts: &dyn Parts) -> Result<Identifiability> {
        self.check_settings_for_batches()?;
        if let Some(select) = &self.settings.select {
            select.candidates(problem)?;
        }
        if let Some(rows) = self.eliminating(problem, parts)? {
            return self.evaluation(true).identify_eliminated(&rows);
        }
        let rows = RowsInParts::new(problem, parts);
        if let Some(shape) = idle_shape(problem, &rows.at_nominal_geometry()?) {
            return Err(needs_start(shape));
        }
        self.evaluation(true).identify_parts(&rows)
    }

    /// Refuses settings that need all residuals at once.
    pub(crate) fn check_settings_for_parts(&self) -> Result<()> {
        if self.settings.robust.is_some() {
            return refused("robust", "weights follow from the scatter of all residuals");
        }
        if self.settings.select.is_some() {
            return refused("select", "the rows are read again without what is left out");
        }
        if self.settings.variance == Variance::PerStage {
            return refused("variance", "factors follow from the residuals of each stage");
        }
        self.check_settings_for_batches()
    }

    /// The same for rows that can be read again and again.
    pub(crate) fn check_settings_for_batches(&self) -> Result<()> {
        match &self.settings.select {
            Some(select) if select.by == SelectBy::Prediction => {
                return refused("select", "`by: prediction` leaves out runs of rows, one after another");
            }
            Some(_) if self.settings.robust.is_some() => {
                return refused("select", "with `robust`, significance follows from the weights of all rows");
            }
            _ => {}
        }
        if self.settings.variance == Variance::PerStage && self.settings.robust.is_some() {
            return refused("variance", "with `robust`, factors follow from the weights of all rows");
        }
        if self.settings.on_confounded != OnConfounded::Error {
            return refused("on_confounded", "what is lost is tried with other values");
        }
        Ok(())
    }
}
