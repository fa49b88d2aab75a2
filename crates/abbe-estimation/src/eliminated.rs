//! Estimates with so many own unknowns of artefacts that these are eliminated, one facet or ball after another: memory grows with their
//! number and not with its square.
//!
//! A row depends on the unknowns that all rows share and on those of one facet or ball. So the triangle of all unknowns has the form
//! of an arrow, and its blocks are found one by one ([`ArrowAccumulator`]). What is judged, iterated and propagated is that of one
//! triangle; only the covariances of eliminated unknowns are not kept. Rows may be at hand, or lie in parts that are read again and
//! again: the triangles of a part are rows of those of all.

use std::cell::RefCell;
use std::collections::BTreeMap;

use abbe_core::{Calibration, Error, FitReport, Identifiability, Owner, Parts, Problem, ResidualSums, Result, Status};
use abbe_numerics::{
    ArrowAccumulator, ArrowFactor, Descent, Factor, GroupSearch, Groups, OfTwoGroups, Options, Solution, solve_plain,
};

use crate::calibration::calibration;
use crate::contact::rank_point;
use crate::judgement::{at_nominal_geometry, norms_of_terms, without_effect};
use crate::parts::{check, looked_at, residual_sums};
use crate::propagation::{AposterioriFactors, Propagation};
use crate::rank::{confounded, null_space, weakest};
use crate::residuals::ResidualStatistics;
use crate::solved::{Told, UncertaintyEvaluation};
use crate::weighted::Weighted;

/// A problem whose own unknowns are eliminated.
pub struct EliminatedRows<'a> {
    whole: Whole<'a>,
    parts: &'a dyn Parts,
    search: RefCell<GroupSearch>,
}

/// What all parts have together.
struct Whole<'a> {
    /// It has the unknowns of all parts; its rows do not count.
    problem: &'a Problem,
    /// The columns of unknowns, then those of what is considered, by their names.
    columns: BTreeMap<&'a str, usize>,
}

/// Where rows are linearised.
#[derive(Clone, Copy)]
enum At<'x> {
    /// As recorded, at these values of the unknowns.
    Recorded(&'x [f64]),
    /// Where rank is judged before anything is solved; columns of unknowns without effect are zero.
    Nominal,
    /// In nominal contact at these values, with columns for what is considered after those of the unknowns, if that is asked.
    InContact(&'x [f64], bool),
}

/// Gets the set of a row, its unknowns, its derivatives to them, and its residual.
type EachRow<'r> = dyn FnMut(usize, &[usize], &[f64], f64) + 'r;

impl Whole<'_> {
    /// Shows the rows of a part: the set of each, its unknowns among all columns, ascending, its derivatives to them, and its residual.
    fn rows_of(&self, part: &Problem, at: At<'_>, row: &mut EachRow<'_>) -> Result<()> {
        if part.equations() == 0 {
            return Ok(());
        }
        check(part)?;
        let there = self.there(part, at)?;
        let (columns, sets) = (self.columns_of(&there)?, self.sets_of(part)?);
        let ranges = part.equation_ranges();
        let weighted = Weighted::new(&there)?;
        if weighted.is_correlated() {
            let error = Error::usage("rows have a covariance, so that own unknowns cannot be eliminated one by one");
            return Err(error.help("estimate fewer own unknowns, or leave out the covariance under `uncertainty`"));
        }
        let is_ascending = columns.is_sorted();
        let (mut set, mut unknowns, mut line_in_order) = (0, Vec::new(), Vec::new());
        weighted.linearise_compact(&there.start(), |block| {
            unknowns.clear();
            unknowns.extend(block.unknowns.iter().map(|unknown| columns[*unknown]));
            let mut order: Vec<usize> = (0..unknowns.len()).collect();
            if !is_ascending {
                order.sort_unstable_by_key(|place| unknowns[*place]);
                unknowns.sort_unstable();
            }
            for (equation, residual, line) in block.lines() {
                while !ranges[set].contains(equation) {
                    set += 1;
                }
                line_in_order.clear();
                line_in_order.extend(order.iter().map(|place| line[*place]));
                row(sets[set], &unknowns, &line_in_order, residual);
            }
        })
    }

    /// The problem of a part whose start values and poses are where its rows are linearised.
    fn there(&self, part: &Problem, at: At<'_>) -> Result<Problem> {
        match at {
            At::Recorded(x) => Ok(part.with_values(&self.values(part, x))),
            At::Nominal => {
                let nominal = at_nominal_geometry(part);
                rank_point(&nominal, &nominal.start())
            }
            At::InContact(x, considered) => {
                let values = self.values(part, x);
                let mut there = rank_point(part, &values)?.with_values(&values);
                if considered {
                    there.unknowns.extend(part.considered.unknowns.iter().cloned());
                }
                Ok(there)
            }
        }
    }

    /// The values of the unknowns of a part among those of all.
    fn values(&self, part: &Problem, x: &[f64]) -> Vec<f64> {
        let unknowns = part.unknowns.iter().zip(part.start());
        unknowns
            .map(|(unknown, start)| self.columns.get(unknown.name.as_str()).map_or(start, |column| x[*column]))
            .collect()
    }

    fn columns_of(&self, part: &Problem) -> Result<Vec<usize>> {
        let column = |name: &String| self.columns.get(name.as_str()).copied();
        let columns: Option<Vec<usize>> = part.unknowns.iter().map(|unknown| column(&unknown.name)).collect();
        columns.ok_or_else(|| Error::data("a part of the rows has an unknown that all rows together have not"))
    }

    fn sets_of(&self, part: &Problem) -> Result<Vec<usize>> {
        let set = |name: &String| self.problem.set_named(name).map(|set| set.0);
        let sets: Option<Vec<usize>> = part.sets.iter().map(|own| set(&own.name)).collect();
        sets.ok_or_else(|| Error::data("a part of the rows is of an artefact that all rows together have not"))
    }

    /// The triangles of a part.
    fn of_part<'g>(&self, part: &Problem, at: At<'_>, groups: &'g Groups) -> Result<OfPart<'g>> {
        let mut counts = vec![0; self.problem.sets.len()];
        for (set, range) in self.sets_of(part)?.into_iter().zip(part.equation_ranges()) {
            counts[set] += range.len();
        }
        let idle = match at {
            At::Nominal if part.equations() > 0 => self.idle(part)?,
            _ => Vec::new(),
        };
        let (mut accumulator, mut refused) = (ArrowAccumulator::new(groups, &counts), None);
        let mut without = Vec::new();
        self.rows_of(part, at, &mut |set, unknowns, line, residual| {
            let line = match idle.is_empty() {
                true => line,
                false => {
                    without.clear();
                    without.extend(
                        unknowns.iter().zip(line).map(|(column, entry)| if idle[*column] { 0.0 } else { *entry }),
                    );
                    &without
                }
            };
            if refused.is_none() {
                refused = accumulator.push(set, unknowns, line, residual, 1.0).err();
            }
        })?;
        Ok(refused.map_or(Ok(accumulator), Err))
    }

    /// The columns of unknowns that have no effect on the rows of a part; empty if there are none.
    fn idle(&self, part: &Problem) -> Result<Vec<bool>> {
        let nominal = at_nominal_geometry(part);
        let judged = rank_point(&nominal, &nominal.start())?;
        let mut squares = vec![0.0; part.unknowns.len()];
        Weighted::new(&judged)?.linearise_compact(&judged.start(), |block| {
            for (_, _, line) in block.lines() {
                block.unknowns.iter().zip(line).for_each(|(unknown, entry)| squares[*unknown] += entry * entry);
            }
        })?;
        let norms: Vec<f64> = squares.into_iter().map(f64::sqrt).collect();
        let terms = norms_of_terms(&judged, None)?;
        let idle = without_effect(&nominal, &judged, (&norms, &terms), None)?;
        if !idle.contains(&true) {
            return Ok(Vec::new());
        }
        let mut all = vec![false; self.columns.len()];
        self.columns_of(part)?.into_iter().zip(idle).for_each(|(column, idle)| all[column] = idle);
        Ok(all)
    }
}

impl<'a> EliminatedRows<'a> {
    /// The rows of a problem that lie in parts; one part may have all ([`RowsAtHand`](crate::RowsAtHand)).
    ///
    /// Fails for rows that belong together with rows of other groups: errors that rows share, repeats that are pooled, constraints of
    /// certificates. Fails where the rows have no derivatives at the start values.
    pub fn new(problem: &'a Problem, parts: &'a dyn Parts) -> Result<Self> {
        let all = problem.unknowns.iter().chain(&problem.considered.unknowns);
        let columns = all.enumerate().map(|(column, unknown)| (unknown.name.as_str(), column)).collect();
        let own = problem.unknowns.iter().map(|unknown| matches!(unknown.owner, Owner::Set(_)));
        let search = RefCell::new(GroupSearch::new(own.collect()));
        let rows = Self { whole: Whole { problem, columns }, parts, search };
        rows.look_for_groups(At::Recorded(&problem.start()))?;
        Ok(rows)
    }

    /// The problem.
    pub fn problem(&self) -> &'a Problem {
        self.whole.problem
    }

    /// How many unknowns are eliminated.
    pub fn eliminated(&self) -> usize {
        self.search.borrow().groups().eliminated()
    }

    /// Takes note of what occurs together in rows.
    fn look_for_groups(&self, at: At<'_>) -> Result<()> {
        // What is considered is shared by all, and is no unknown that is looked for.
        let at = if let At::InContact(x, _) = at { At::InContact(x, false) } else { at };
        let own: Vec<bool> =
            self.whole.problem.unknowns.iter().map(|unknown| matches!(unknown.owner, Owner::Set(_))).collect();
        let whole = &self.whole;
        let look = |part: &Problem| {
            let mut search = GroupSearch::new(own.clone());
            whole.rows_of(part, at, &mut |_, unknowns, line, _| search.row(unknowns, line))?;
            Ok(search)
        };
        let found = looked_at(self.parts, &look, &|all: &mut GroupSearch, own| all.join(own))?;
        found.iter().for_each(|found| self.search.borrow_mut().join(found.clone()));
        Ok(())
    }

    /// The triangles of all rows.
    ///
    /// Derivatives that were zero elsewhere may not be here, and join groups.
    fn arrow(&self, at: At<'_>) -> Result<ArrowFactor> {
        loop {
            let groups = self.search.borrow().groups();
            let groups = match at {
                At::InContact(_, true) => groups.with_shared(self.whole.problem.considered.unknowns.len()),
                _ => groups,
            };
            match self.in_groups(at, &groups)? {
                Ok(factor) => return Ok(factor),
                Err(_) => self.look_for_groups(at)?,
            }
        }
    }

    fn in_groups(&self, at: At<'_>, groups: &Groups) -> Result<Result<ArrowFactor, OfTwoGroups>> {
        let whole = &self.whole;
        let look = |part: &Problem| whole.of_part(part, at, groups);
        let found = looked_at(self.parts, &look, &joined)?;
        Ok(found
            .unwrap_or_else(|| Ok(ArrowAccumulator::new(groups, &vec![0; whole.problem.sets.len()])))
            .map(ArrowAccumulator::finish))
    }

    /// Minimises the sum of squares from `start`; see [`Options`].
    pub fn solve(&self, start: &[f64], options: &Options) -> Result<Solution<ArrowFactor>> {
        solve_plain(self, start, options)
    }

    /// Judges what the rows determine, as [`Judgement`](crate::Judgement) does: rank, what is lost and what is weak, with names.
    pub fn judge(&self, tolerance: f64) -> Result<Identifiability> {
        Ok(identified(self.whole.problem, &self.arrow(At::Nominal)?, tolerance))
    }

    /// The sums of the residuals of all rows.
    fn residuals(&self, x: &[f64]) -> Result<ResidualSums> {
        let whole = &self.whole;
        let look = |part: &Problem| residual_sums(part, part.residuals(&whole.values(part, x))?);
        let found = looked_at(self.parts, &look, &|all: &mut ResidualSums, own| *all = all.with(&own))?;
        Ok(found.unwrap_or_default())
    }

    /// The unknowns that are not eliminated, by triangles with columns for what is considered.
    fn shared(&self, extended: &ArrowFactor) -> impl Iterator<Item = usize> {
        let count = self.whole.problem.unknowns.len();
        extended.shared().iter().copied().filter(move |column| *column < count)
    }

    /// The problem of the unknowns that are not eliminated, and how uncertainty propagates to these.
    fn propagated(&self, extended: &ArrowFactor, x: &[f64], scales: AposterioriFactors) -> (Problem, Propagation) {
        let mut is_shared = vec![false; x.len()];
        self.shared(extended).for_each(|unknown| is_shared[unknown] = true);
        let shared = is_shared.iter().filter(|shared| **shared).count();
        let mut reduced = self.whole.problem.with_values(x);
        let mut kept = is_shared.into_iter();
        reduced.unknowns.retain(|_| kept.next() == Some(true));
        let own = |factor: &Factor| factor.without_unknowns(|column| column >= shared);
        let root = own(extended.of_shared()).covariance_root(shared);
        let of_sets: Vec<Factor> = extended.of_sources().iter().map(own).collect();
        let propagation = Propagation::of_factors(&reduced, &root, (&of_sets, extended.of_shared()), scales);
        (reduced, propagation)
    }
}

/// The triangles of a part, or a row that has unknowns of two groups.
type OfPart<'g> = Result<ArrowAccumulator<'g>, OfTwoGroups>;

/// Adds the triangles of a later part.
fn joined<'g>(all: &mut OfPart<'g>, own: OfPart<'g>) {
    match (all.as_mut(), own) {
        (Ok(all), Ok(own)) => all.join(own),
        (Ok(_), Err(of_two)) => *all = Err(of_two),
        (Err(_), _) => {}
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
        self.whole.problem.monitor.iteration(iteration, size);
    }

    fn factor_at(&self, x: &[f64], _: Option<&[f64]>) -> Result<ArrowFactor> {
        self.arrow(At::Recorded(x))
    }
}

impl UncertaintyEvaluation {
    /// What the rows determine, before anything is solved, with the uncertainties of what is not eliminated that follow from what is
    /// stated.
    pub fn identify_eliminated(&self, rows: &EliminatedRows<'_>) -> Result<Identifiability> {
        let mut found = rows.judge(self.rank_tolerance)?;
        if found.rank == found.unknowns {
            let start = rows.whole.problem.start();
            let scales = AposterioriFactors::Common(1.0, f64::INFINITY);
            let (reduced, propagation) = rows.propagated(&rows.arrow(At::InContact(&start, true))?, &start, scales);
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
        let (problem, x, count) = (rows.whole.problem, &solved.x, rows.whole.problem.unknowns.len());
        let at_contact = rows.arrow(At::InContact(x, false))?;
        let found = identified(problem, &at_contact, self.rank_tolerance);
        if found.rank < count {
            return Err(confounded(&found));
        }
        let residuals = rows.residuals(x)?;
        let statistics = ResidualStatistics::from((&residuals, count));
        let scales = self.scales(&statistics, None);
        let AposterioriFactors::Common(scatter, _) = scales else {
            return Err(Error::usage("own unknowns cannot be eliminated where every artefact has its own factor"));
        };
        let extended = match problem.considered.unknowns.is_empty() {
            true => at_contact,
            false => rows.arrow(At::InContact(x, true))?,
        };
        let (reduced, propagation) = rows.propagated(&extended, x, scales);
        self.check_redundancy(&statistics, count, &propagation)?;
        let told = Told {
            radial_rms: residuals.radial_rms(),
            equivalent_motion_errors: Vec::new(),
            variance: Vec::new(),
            remarks: Vec::new(),
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
