//! Variance components: the scatter of the readings of every artefact, relative to their stated uncertainties.
//!
//! Group g has the stated standard uncertainties times an unknown factor `s_g`. With the weights of the current factors, the
//! weighted residuals v and the share `M_g` of the rows of g in the information (all shares add up to the identity), the
//! expected sum of squares of a group is
//!
//! ```text
//! E(v_g^T v_g) = sum over h of S_gh t_h,    S_gg = n_g - 2 tr M_g + tr M_g^2,    S_gh = tr(M_g M_h)
//! ```
//!
//! where `t_h` is the square of the ratio of the true factor of h to its current factor. Solved for t and repeated until all
//! t are 1, this gives the restricted maximum likelihood estimate (Patterson & Thompson 1971), and the fixed point of
//! Förstner's (1979) almost unbiased estimate `t_g = v_g^T v_g / r_g` with the redundancy `r_g = n_g - tr M_g`, which is used
//! if a solution is negative or far from 1. The variance of `s_g^2` is `2 s_g^4 (S^-1)_gg`, so that it has `1 / (S^-1)_gg`
//! degrees of freedom. Constraints of certificates keep their uncertainty: their t is 1.

use abbe_core::{EquationIndex, Error, Problem, Result, VarianceFactor};
use abbe_numerics::{Directions, Factor, Information, RobustReport, Solution};
use nalgebra::{DMatrix, DVector};

use crate::residuals::correction;
use crate::weighted::Weighted;

/// Most rounds of estimating factors.
pub(crate) const ROUNDS: usize = 100;

/// The iteration ends if the logarithms of all squared corrections of factors are below this. Standard uncertainties then
/// change by less than half of it, relatively.
const SETTLED: f64 = 1e-8;

/// Least redundancy of a group from which its own factor can be determined: one reading is checked by others.
const LEAST_REDUNDANCY: f64 = 1.0;

/// Smallest factor: readings that scatter less are exact and were not measured.
const LEAST_FACTOR: f64 = 1e-4;

/// The factors of all sets of a problem.
pub struct VarianceComponents {
    /// The factor on the standard uncertainties of every set.
    pub factors: Vec<f64>,
    /// Their degrees of freedom; infinite if the factor of a set cannot be determined.
    pub degrees_of_freedom: Vec<f64>,
    /// Values of the unknowns with these weights.
    pub x: Vec<f64>,
    determined: Vec<bool>,
}

impl VarianceComponents {
    /// The factors by name.
    pub fn named(&self, problem: &Problem) -> Vec<VarianceFactor> {
        let sets = problem.sets.iter().enumerate();
        let named = sets.map(|(index, set)| VarianceFactor {
            stage: set.name.clone(),
            factor: self.factors[index],
            degrees_of_freedom: Some(self.degrees_of_freedom[index]).filter(|_| self.determined[index]),
        });
        named.collect()
    }

    /// Warns about sets whose factor cannot be determined, so that their stated uncertainties are used.
    pub fn warn(&self, problem: &Problem) {
        for (set, _) in problem.sets.iter().zip(&self.determined).filter(|(_, determined)| !**determined) {
            tracing::warn!(
                "{}: the rows of {} cannot tell how much they scatter (less than one of them is checked by others): what was stated counts",
                problem.name,
                set.name
            );
        }
    }
}

/// A problem with the factors that an estimate has found on the uncertainties of readings, by the names of stages. Those of other stages
/// do not change.
pub fn with_factors_found(problem: &Problem, found: &[VarianceFactor]) -> Problem {
    let factor = |name: &str| found.iter().find(|found| found.stage == name).map_or(1.0, |found| found.factor);
    problem.with_variance_factors(&problem.sets.iter().map(|set| factor(&set.name)).collect::<Vec<f64>>())
}

/// The rows of a set at a solution.
pub(crate) struct Group {
    /// Readings that take part.
    pub rows: usize,
    /// Their weighted sum of squares.
    pub squares: f64,
    /// Their share in the information.
    pub share: Information,
}

/// Sums of squares of the groups for one solution.
pub(crate) struct Round {
    /// Weighted sum of squares of every group.
    squares: Vec<f64>,
    redundancies: Vec<f64>,
    /// Expected squares for every pair of groups.
    expected: DMatrix<f64>,
    /// Contribution of certificates to the expected squares of every group.
    constrained: Vec<f64>,
}

impl Round {
    fn new(problem: &Problem, solution: &Solution, determined: Option<&Directions>) -> Result<Self> {
        let weighted = Weighted::new(problem)?;
        let residuals = weighted.in_uncertainties(problem.residuals(&solution.x)?);
        let constraints = problem.constraints();
        let report = solution.robust.as_ref();
        let used = |equation: EquationIndex| report.is_none_or(|report| report.weights[equation] > 0.0);
        let kept: Vec<f64> = EquationIndex::first(residuals.len()).map(|equation| f64::from(used(equation))).collect();
        let readings: Vec<f64> =
            kept.iter().zip(&constraints).map(|(kept, is)| if *is { 0.0 } else { *kept }).collect();
        let ranges = problem.equation_ranges();
        let factor = weighted.factor(&solution.x, Some(&kept))?;
        let covariance_root = match determined {
            Some(determined) => determined.covariance_root(&factor),
            None => factor.covariance_root(factor.unknowns()),
        };
        let factors: Vec<Factor> = weighted.factors(&solution.x, Some(&readings), &ranges)?;
        let shares: Vec<_> = factors.iter().map(|factor| covariance_root.information(factor)).collect();
        let groups = ranges.iter().zip(shares).map(|(range, share)| {
            let rows: Vec<EquationIndex> = range.clone().filter(|&equation| readings[equation] > 0.0).collect();
            let squares = influence(&rows, &residuals, report) * correction(&rows, report, share.trace()).powi(2);
            Group { rows: rows.len(), squares, share }
        });
        Ok(Self::of_groups(&groups.collect::<Vec<Group>>()))
    }

    pub(crate) fn of_groups(groups: &[Group]) -> Self {
        let count = groups.len();
        let (mut squares, mut redundancies) = (Vec::new(), Vec::new());
        let mut expected = DMatrix::<f64>::zeros(count, count);
        for (group, Group { rows, squares: own, share }) in groups.iter().enumerate() {
            let trace = share.trace();
            squares.push(*own);
            redundancies.push(*rows as f64 - trace);
            for (other, Group { share: of_other, .. }) in groups.iter().enumerate() {
                expected[(group, other)] = share.product_trace(of_other);
            }
            expected[(group, group)] += *rows as f64 - 2.0 * trace;
        }
        // Property of a projection: r_g is the sum of S_gh over all groups h, certificates included.
        let constrained = (0..count).map(|group| redundancies[group] - expected.row(group).sum()).collect();
        Self { squares, redundancies, expected, constrained }
    }

    /// The squared corrections t of the factors of the groups in `free`, and their degrees of freedom.
    fn solve(&self, free: &[usize]) -> (Vec<f64>, Vec<f64>) {
        let size = free.len();
        let matrix = DMatrix::from_fn(size, size, |row, column| self.expected[(free[row], free[column])]);
        let rest = |group: usize| -> f64 {
            let held = (0..self.squares.len()).filter(|other| !free.contains(other));
            held.map(|other| self.expected[(group, other)]).sum::<f64>() + self.constrained[group]
        };
        let right = DVector::from_fn(size, |row, _| self.squares[free[row]] - rest(free[row]));
        let almost_unbiased =
            || -> Vec<f64> { free.iter().map(|&group| self.squares[group] / self.redundancies[group]).collect() };
        let Some(inverse) = matrix.try_inverse() else {
            let redundancies = free.iter().map(|&group| self.redundancies[group]).collect();
            return (almost_unbiased(), redundancies);
        };
        let solved: Vec<f64> = (&inverse * right).iter().copied().collect();
        let freedom = (0..size).map(|row| 1.0 / inverse[(row, row)]).collect();
        let near = solved.iter().all(|value| (0.25..4.0).contains(value));
        (if near { solved } else { almost_unbiased() }, freedom)
    }
}

/// Weighted squares of some rows; robust weights act on the residuals, as on their influence.
fn influence(rows: &[EquationIndex], residuals: &[f64], report: Option<&RobustReport>) -> f64 {
    let weight = |row: EquationIndex| report.map_or(1.0, |report| report.weights[row]);
    rows.iter().map(|&row| (weight(row) * residuals[row]).powi(2)).sum()
}

/// The factors on the way to where they stay.
pub(crate) struct Rounds {
    /// The factors of all sets.
    pub factors: Vec<f64>,
    determined: Vec<bool>,
    exact: Vec<bool>,
}

impl Rounds {
    /// All factors are 1.
    pub fn new(count: usize) -> Self {
        Self { factors: vec![1.0; count], determined: vec![true; count], exact: vec![false; count] }
    }

    /// Better factors, from a round with these ones; the degrees of freedom of all if they stay as they are.
    pub fn next(&mut self, round: &Round) -> Option<Vec<f64>> {
        let Self { factors, determined, exact } = self;
        let count = factors.len();
        let silent: Vec<usize> =
            (0..count).filter(|&group| determined[group] && round.redundancies[group] < LEAST_REDUNDANCY).collect();
        if !silent.is_empty() {
            for group in silent {
                (determined[group], factors[group]) = (false, 1.0);
            }
            return None;
        }
        let free: Vec<usize> = (0..count).filter(|&group| determined[group] && !exact[group]).collect();
        let (off, freedom) = round.solve(&free);
        let mut change = 0.0_f64;
        for (&group, off) in free.iter().zip(&off) {
            let factor = factors[group] * off.max(0.0).sqrt();
            if factor < LEAST_FACTOR {
                (factors[group], exact[group]) = (LEAST_FACTOR, true);
                change = 1.0;
            } else {
                change = change.max(off.ln().abs());
                factors[group] = factor;
            }
        }
        if change >= SETTLED {
            return None;
        }
        let mut degrees_of_freedom = vec![f64::INFINITY; count];
        free.iter().zip(freedom).for_each(|(&group, freedom)| degrees_of_freedom[group] = freedom);
        (0..count)
            .filter(|&group| exact[group])
            .for_each(|group| degrees_of_freedom[group] = round.redundancies[group]);
        if let Some(group) = free.iter().copied().find(|&group| degrees_of_freedom[group] < LEAST_REDUNDANCY) {
            (determined[group], factors[group]) = (false, 1.0);
            return None;
        }
        Some(degrees_of_freedom)
    }

    /// The factors where they stay, with values of the unknowns.
    pub fn settled(self, degrees_of_freedom: Vec<f64>, x: Vec<f64>) -> VarianceComponents {
        VarianceComponents { factors: self.factors, degrees_of_freedom, x, determined: self.determined }
    }
}

/// The error for factors that do not settle.
pub(crate) fn unsettled() -> Error {
    let error = Error::data(format!("the variance factors of the artefacts still change after {ROUNDS} rounds"));
    error.help("use one factor for all, `variance: common`, or trust what is stated").setting("variance")
}

/// The factors of all sets. `solve` gives the solution of a problem from its start values, within the directions that are
/// `directions`, if not all are determined.
pub fn components(
    problem: &Problem,
    directions: Option<&Directions>,
    solve: impl Fn(&Problem) -> Result<Solution>,
) -> Result<VarianceComponents> {
    let mut rounds = Rounds::new(problem.sets.len());
    let mut x = problem.start();
    for _ in 0..ROUNDS {
        let scaled = problem.with_variance_factors(&rounds.factors).with_values(&x);
        let solution = solve(&scaled)?;
        x.clone_from(&solution.x);
        if let Some(degrees_of_freedom) = rounds.next(&Round::new(&scaled, &solution, directions)?) {
            return Ok(rounds.settled(degrees_of_freedom, x));
        }
    }
    Err(unsettled())
}
