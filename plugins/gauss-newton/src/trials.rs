//! Estimates by the triangle of nearby rows: start values, and thousands of problems that are nearly the same.

use abbe_core::{Estimate, Problem, Result, ValuesOf};
use abbe_numerics::{Directions, Factor, solve_near};

use crate::settings::OnConfounded;
use crate::{GaussNewton, TRIAL_TOLERANCE};

/// Tolerance of values from which an iteration begins.
const ROUGH: f64 = 1e-3;

impl GaussNewton {
    /// Values from which the iteration of more unknowns may begin; `at_start` is the factor at the start values, if it is known.
    pub(crate) fn roughly(
        &self,
        problem: &Problem,
        at_start: Option<Factor>,
        determined: Option<&Directions>,
    ) -> Result<Vec<f64>> {
        let (weighted, start, options) = (self.weighted(problem)?, problem.start(), self.options(ROUGH, false));
        if determined.is_some() || options.robust.is_some() {
            return self.iterate_within(&weighted, &start, determined, &options).map(|solution| solution.x);
        }
        let factor = at_start.map_or_else(|| weighted.factor(&start, None), Ok)?;
        let near = solve_near(&weighted, &start, (&factor, true), &options).ok().flatten();
        match near {
            Some(x) => Ok(x),
            None => self.iterate(&weighted, &start, Some(factor), &options).map(|solution| solution.x),
        }
    }

    /// The values of problems near this one: each of their steps takes the triangle of this one, and costs no decomposition.
    ///
    /// Where rows weigh by their residuals, or what is estimated depends on them, every problem is solved by itself.
    pub(crate) fn of_trials<'a>(&'a self, near: &Problem) -> Box<ValuesOf<'a>> {
        let is_plain = self.robust().is_none()
            && self.settings.select.is_none()
            && self.settings.on_confounded == OnConfounded::Error
            && !near.unknowns.is_empty();
        let factor = || self.weighted(near).and_then(|rows| rows.factor(&near.start(), None)).ok();
        let Some(factor) = is_plain.then(factor).flatten() else {
            return Box::new(|problem| self.values(problem));
        };
        Box::new(move |problem| {
            let options = self.options(TRIAL_TOLERANCE, true);
            let found = solve_near(&self.weighted(problem)?, &problem.start(), (&factor, false), &options)?;
            found.map_or_else(|| self.values(problem), Ok)
        })
    }
}
