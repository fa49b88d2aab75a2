//! Estimates with so many own unknowns of artefacts that these are eliminated, one facet or ball after another: memory grows with their
//! number and not with its square.
//!
//! A row depends on the unknowns that all rows share and on those of one facet or ball. So the triangle of all unknowns has the form
//! of an arrow, and its blocks are found one by one ([`ArrowAccumulator`]). What is judged, iterated and propagated is that of one
//! triangle; only the covariances of eliminated unknowns are not kept.

use std::cell::RefCell;

use abbe_core::{Calibration, Error, FitReport, Identifiability, Owner, Problem, Result, Status};
use abbe_numerics::{
    ArrowAccumulator, ArrowFactor, Descent, Factor, GroupSearch, Groups, OfTwoGroups, Options, Solution, solve_plain,
};

use crate::calibration::calibration;
use crate::contact::rank_point;
use crate::judgement::{at_nominal_geometry, norms_of_terms, without_effect};
use crate::propagation::{AposterioriFactors, Propagation};
use crate::rank::{confounded, null_space, weakest};
use crate::residuals::{Constraints, ResidualStatistics, radial_rms};
use crate::solved::{Told, UncertaintyEvaluation};
use crate::weighted::Weighted;

/// A problem whose own unknowns are eliminated.
pub struct EliminatedRows<'a> {
    problem: &'a Problem,
    weighted: Weighted<'a>,
    search: RefCell<GroupSearch>,
}

impl<'a> EliminatedRows<'a> {
    /// The rows of a problem. Fails where its rows have no derivatives at the start values.
    ///
    /// Fails for rows that belong together with rows of other groups: errors that rows share, repeats that are pooled, constraints of
    /// certificates.
    pub fn new(problem: &'a Problem) -> Result<Self> {
        let refused = |what: &str| {
            let message = format!("{what}, so that own unknowns cannot be eliminated one by one");
            Err(Error::usage(message).help("estimate fewer own unknowns, or leave the setting out"))
        };
        let weighted = Weighted::new(problem)?;
        if weighted.is_correlated() {
            return refused("rows share errors with others");
        }
        if !problem.repeated_together().is_empty() {
            return refused("repeats are compared with each other");
        }
        if problem.constraints().contains(&true) {
            return refused("a certificate states what holds for all rows");
        }
        let own = problem.unknowns.iter().map(|unknown| matches!(unknown.owner, Owner::Set(_)));
        let search = RefCell::new(GroupSearch::new(own.collect()));
        let rows = Self { problem, weighted, search };
        rows.look_for_groups(&rows.weighted, &problem.start())?;
        Ok(rows)
    }

    /// The problem.
    pub fn problem(&self) -> &'a Problem {
        self.problem
    }

    /// How many unknowns are eliminated.
    pub fn eliminated(&self) -> usize {
        self.search.borrow().groups().eliminated()
    }

    /// Takes note of what occurs together in rows at x.
    fn look_for_groups(&self, rows: &Weighted<'_>, x: &[f64]) -> Result<()> {
        let mut search = self.search.borrow_mut();
        rows.linearise_compact(x, |block| {
            block.lines().for_each(|(_, _, line)| search.row(block.unknowns, line));
        })
    }

    /// The triangles of rows at x, which may have more columns after those of the unknowns.
    ///
    /// Derivatives that are zero elsewhere may not be here, and join groups.
    fn arrow(&self, rows: &Weighted<'_>, x: &[f64]) -> Result<ArrowFactor> {
        loop {
            let groups = self.search.borrow().groups();
            match self.in_groups(rows, x, &groups)? {
                Ok(factor) => return Ok(factor),
                Err(_) => self.look_for_groups(rows, x)?,
            }
        }
    }

    fn in_groups(&self, rows: &Weighted<'_>, x: &[f64], groups: &Groups) -> Result<Result<ArrowFactor, OfTwoGroups>> {
        let ranges = self.problem.equation_ranges();
        let counts: Vec<usize> = ranges.iter().map(|range| range.len()).collect();
        let (mut accumulator, mut set, mut refused) = (ArrowAccumulator::new(groups, &counts), 0, None);
        rows.linearise_compact(x, |block| {
            for (equation, residual, line) in block.lines() {
                while !ranges[set].contains(equation) {
                    set += 1;
                }
                if refused.is_none() {
                    refused = accumulator.push(set, block.unknowns, line, residual, 1.0).err();
                }
            }
        })?;
        Ok(refused.map_or_else(|| Ok(accumulator.finish()), Err))
    }

    /// Minimises the sum of squares from `start`; see [`Options`].
    pub fn solve(&self, start: &[f64], options: &Options) -> Result<Solution<ArrowFactor>> {
        solve_plain(self, start, options)
    }

    /// Judges what the rows determine, as [`Judgement`](crate::Judgement) does: rank, what is lost and what is weak, with names.
    pub fn judge(&self, tolerance: f64) -> Result<Identifiability> {
        let (_, factor) = self.where_judged()?;
        Ok(identified(self.problem, &factor, tolerance))
    }

    /// The problem where rank is judged, and its triangles. Unknowns without effect have columns of zeros.
    fn where_judged(&self) -> Result<(Problem, ArrowFactor)> {
        let nominal = at_nominal_geometry(self.problem);
        let judged = rank_point(&nominal, &nominal.start())?;
        let factor = self.arrow(&Weighted::new(&judged)?, &judged.start())?;
        let terms = norms_of_terms(&judged, None)?;
        let idle = without_effect(&nominal, &judged, (factor.norms(), &terms), None)?;
        let factor = if idle.contains(&true) { factor.with_zeros(&idle) } else { factor };
        Ok((judged, factor))
    }
}

/// Rank, and what is lost and weak. Of more than some tens of lost directions the first are told.
fn identified(problem: &Problem, factor: &ArrowFactor, tolerance: f64) -> Identifiability {
    let spectrum = factor.spectrum(tolerance);
    Identifiability {
        observations: factor.rows(),
        unknowns: problem.unknowns.len(),
        rank: spectrum.rank,
        condition: spectrum.condition,
        null_space: null_space(problem, &spectrum.ends, spectrum.told),
        weakest: weakest(problem, &spectrum.ends, spectrum.told),
        equivalent_motion_errors: Vec::new(),
        uncertainty: None,
        remarks: Vec::new(),
    }
}

impl Descent for EliminatedRows<'_> {
    type Error = Error;
    type Factor = ArrowFactor;

    fn has_no_more(&self, error: &Error) -> bool {
        error.fatal
    }

    fn is_late(&self, error: &Error) -> bool {
        error.out_of_time
    }

    fn stepped(&self, iteration: usize, size: f64) {
        self.problem.monitor.iteration(iteration, size);
    }

    fn factor_at(&self, x: &[f64], _: Option<&[f64]>) -> Result<ArrowFactor> {
        self.arrow(&self.weighted, x)
    }
}

impl UncertaintyEvaluation {
    /// What the rows determine, before anything is solved, with the uncertainties of what is not eliminated that follow from what is
    /// stated.
    pub fn identify_eliminated(&self, rows: &EliminatedRows<'_>) -> Result<Identifiability> {
        let (judged, factor) = rows.where_judged()?;
        let mut found = identified(rows.problem, &factor, self.rank_tolerance);
        if found.rank == found.unknowns {
            let extended = rows.with_considered(&judged, factor)?;
            let scales = AposterioriFactors::Common(1.0, f64::INFINITY);
            let (reduced, propagation) = rows.propagated(&extended, &judged.start(), scales);
            found.uncertainty = Some(propagation.budget(&reduced, self.coverage_probability));
        }
        Ok(found)
    }

    /// Makes the calibration from a minimum of rows whose own unknowns are eliminated: these have values and standard uncertainties, and
    /// neither covariances nor budgets.
    ///
    /// Fails for a direction that is lost at the solution, and where no degrees of freedom are left, as for rows at once.
    pub fn calibration_of_eliminated(
        &self,
        rows: &EliminatedRows<'_>,
        solved: &Solution<ArrowFactor>,
    ) -> Result<Calibration> {
        let (problem, x, count) = (rows.problem, &solved.x, rows.problem.unknowns.len());
        let judged = rank_point(problem, x)?;
        let at_contact = rows.arrow(&Weighted::new(&judged)?, x)?;
        let found = identified(problem, &at_contact, self.rank_tolerance);
        if found.rank < count {
            return Err(confounded(&found));
        }
        let residuals = problem.residuals(x)?;
        let statistics = ResidualStatistics::new(
            &residuals,
            &problem.quantities(),
            &rows.weighted.in_uncertainties(residuals.clone()),
            None,
            (count, &Constraints::default()),
        );
        let scales = self.scales(&statistics, None);
        let AposterioriFactors::Common(scatter, _) = scales else {
            return Err(Error::usage("own unknowns cannot be eliminated where every artefact has its own factor"));
        };
        let extended = rows.with_considered(&judged.with_values(x), at_contact)?;
        let (reduced, propagation) = rows.propagated(&extended, x, scales);
        self.check_redundancy(&statistics, count, &propagation)?;
        let told = Told {
            radial_rms: radial_rms(problem, &residuals, |_| true),
            equivalent_motion_errors: Vec::new(),
            variance: Vec::new(),
        };
        let iteration = (solved.iterations, Some(solved.last_step), Some(solved.gradient_cosine));
        let fit = self.report(problem, found, &statistics, iteration, told);
        let covariance = propagation.covariance(&reduced);
        let values: Vec<f64> = rows.shared(&extended).map(|unknown| x[unknown]).collect();
        let variances = extended.own_variances(scatter * scatter, &covariance);
        let fit = FitReport { eliminated: variances.len(), ..fit };
        let mut calibration = calibration(&reduced, &values, covariance, Vec::new(), fit);
        let first_of_sets = problem.sets.iter().scan(0, |next, set| {
            let first = *next;
            *next += set.own.len();
            Some(first)
        });
        let first_of_sets: Vec<usize> = first_of_sets.collect();
        for (unknown, variance) in variances {
            let known = &problem.unknowns[unknown];
            let Owner::Set(set) = known.owner else { continue };
            let estimated = &mut calibration.artefacts[first_of_sets[set.0] + known.index];
            estimated.standard_uncertainty = variance.max(0.0).sqrt();
            estimated.status = Status::Estimated;
        }
        calibration.uncertainty = self.explained.then(|| propagation.budget(&reduced, self.coverage_probability));
        Ok(calibration)
    }
}

impl EliminatedRows<'_> {
    /// The unknowns that are not eliminated, by triangles with columns for what is considered.
    fn shared(&self, extended: &ArrowFactor) -> impl Iterator<Item = usize> {
        let count = self.problem.unknowns.len();
        extended.shared().iter().copied().filter(move |column| *column < count)
    }

    /// The problem of the unknowns that are not eliminated, and how uncertainty propagates to these.
    fn propagated(&self, extended: &ArrowFactor, x: &[f64], scales: AposterioriFactors) -> (Problem, Propagation) {
        let mut is_shared = vec![false; x.len()];
        self.shared(extended).for_each(|unknown| is_shared[unknown] = true);
        let shared = is_shared.iter().filter(|shared| **shared).count();
        let mut reduced = self.problem.with_values(x);
        let mut kept = is_shared.into_iter();
        reduced.unknowns.retain(|_| kept.next() == Some(true));
        let own = |factor: &Factor| factor.without_unknowns(|column| column >= shared);
        let root = own(extended.of_shared()).covariance_root(shared);
        let of_sets: Vec<Factor> = extended.of_sources().iter().map(own).collect();
        let propagation = Propagation::of_factors(&reduced, &root, (&of_sets, extended.of_shared()), scales);
        (reduced, propagation)
    }

    /// The triangles of a problem with columns for what is considered after those of the unknowns.
    fn with_considered(&self, problem: &Problem, without: ArrowFactor) -> Result<ArrowFactor> {
        let considered = &problem.considered.unknowns;
        if considered.is_empty() {
            return Ok(without);
        }
        let mut extended = problem.clone();
        extended.unknowns.extend(considered.iter().cloned());
        let groups = self.search.borrow().groups().with_shared(considered.len());
        let found = self.in_groups(&Weighted::new(&extended)?, &extended.start(), &groups)?;
        found.map_err(|of_two| Error::data(of_two.to_string()))
    }
}
