//! Choice of measurements: optimal designs by exchange (V. V. Fedorov, *Theory of optimal experiments*, 1972; Soons 1993,
//! section 4.4 and appendix B).
//!
//! A candidate is a block of rows of a Jacobian, weighted by the uncertainty of its equations, and with columns that the
//! caller scales: of the criteria only D does not depend on units.

use faer::linalg::solvers::DenseSolveCore;
use faer::{Mat, Side};

use crate::sampling::Generator;

/// Relative ridge that is added to the information of every design, so that designs with undetermined unknowns can be
/// compared, too.
const RIDGE: f64 = 1e-12;

/// An information matrix with diagonal 1 counts as singular if its smallest eigenvalue is below this part of the largest one,
/// because it is then rounding.
const OPEN: f64 = 1e-13;

/// Penalty on the condition number for each unknown without any effect on the rows: larger than any condition number.
const UNSEEN: f64 = 1e9;

/// Passes over all positions after which an exchange ends; it needs some ten.
const PASSES: usize = 200;

/// Relative improvement from which candidates are exchanged.
const IMPROVEMENT: f64 = 1e-9;

/// Number of candidates (those with the largest determinant) that are compared by a criterion that needs a decomposition for
/// each.
const COMPARED: usize = 150;

/// Criterion of optimality.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Criterion {
    /// Largest determinant of the information: smallest ellipsoid of the estimates. Does not depend on units.
    D,
    /// Smallest mean variance of the estimates.
    A,
    /// Smallest variance of the combination that is determined worst.
    E,
    /// Smallest largest variance of the predicted responses of the candidates.
    G,
    /// Smallest condition number of the Jacobian with columns of norm 1.
    Condition,
}

/// The candidates of a design and the requirements on it.
#[derive(Debug, Clone)]
pub struct DesignProblem {
    /// Number of unknowns p.
    pub unknowns: usize,
    /// Number of unknowns of interest, which are the first ones. The others are nuisance unknowns, which are estimated, too.
    pub of_interest: usize,
    /// Rows of all candidates, one after another: rows x unknowns.
    pub rows: Vec<f64>,
    /// Where the rows of each candidate end.
    pub ends: Vec<usize>,
    /// Information of what has been measured already, unknowns x unknowns; zeros if nothing has.
    pub measured: Vec<f64>,
    /// Cost of each candidate.
    pub costs: Vec<f64>,
    /// Candidates that belong to the design; one that stands twice is measured twice.
    pub required: Vec<usize>,
    /// Which candidates may be chosen beside these.
    pub allowed: Vec<bool>,
    /// Whether a candidate may be chosen more than once.
    pub replications: bool,
    /// Number of candidates wanted, required ones included; none if only the budget limits it.
    pub number: Option<usize>,
    /// Largest sum of costs.
    pub budget: Option<f64>,
    /// Criterion of optimality.
    pub criterion: Criterion,
}

/// A design.
#[derive(Debug, Clone, PartialEq)]
pub struct Design {
    /// The chosen candidates, ascending; one that stands twice is measured twice.
    pub chosen: Vec<usize>,
    /// Its value by the criterion, larger is better: the logarithm of the determinant for D, else the negative of the
    /// quantity to be minimised. Minus infinity if an unknown of interest is not determined.
    pub value: f64,
}

/// Figures of a design.
#[derive(Debug, Clone, PartialEq)]
pub struct DesignFigures {
    /// Logarithm of the determinant of the information of the unknowns of interest.
    pub log_determinant: f64,
    /// Mean variance of the unknowns of interest.
    pub mean_variance: f64,
    /// Largest variance of a combination of norm 1 of the unknowns of interest.
    pub worst_variance: f64,
    /// Condition number with columns of norm 1.
    pub condition: f64,
    /// Mean and largest variance of the predicted responses of the candidates' rows.
    pub response_variance: [f64; 2],
    /// Covariance of all unknowns, unknowns x unknowns.
    pub covariance: Vec<f64>,
}

impl DesignProblem {
    /// Number of candidates.
    pub fn candidates(&self) -> usize {
        self.ends.len()
    }

    fn candidate(&self, index: usize) -> &[f64] {
        let first = if index == 0 { 0 } else { self.ends[index - 1] };
        &self.rows[first * self.unknowns..self.ends[index] * self.unknowns]
    }

    /// A design that no exchange of one candidate makes better, from a random start.
    ///
    /// None if the required candidates are more than the number or the budget allows, or if no design meets both.
    pub fn exchange(&self, generator: &mut Generator) -> Option<Design> {
        let mut chosen = self.start(generator)?;
        let fixed = self.required.len();
        let start = chosen.clone();
        self.improve(&mut chosen, fixed);
        let design = self.design(chosen);
        if design.value > f64::NEG_INFINITY || self.criterion == Criterion::D {
            return Some(design);
        }
        // If several combinations are not determined, no single exchange improves the worst one. The determinant (with the
        // ridge) improves with each of them.
        let mut chosen = start;
        Self { criterion: Criterion::D, ..self.clone() }.improve(&mut chosen, fixed);
        self.improve(&mut chosen, fixed);
        Some(self.design(chosen))
    }

    /// Exchanges all candidates but the first `fixed` as long as that makes the design better.
    fn improve(&self, chosen: &mut Vec<usize>, fixed: usize) {
        let by_row =
            self.criterion == Criterion::D && self.ends.iter().enumerate().all(|(index, &end)| end == index + 1);
        match by_row {
            true => self.exchange_rows(chosen, fixed),
            false => self.exchange_blocks(chosen, fixed),
        }
    }

    /// Evaluates a given design by the criterion.
    pub fn design(&self, mut chosen: Vec<usize>) -> Design {
        chosen.sort_unstable();
        let value = self.value(&self.information(&chosen, 0.0));
        Design { chosen, value }
    }

    /// The logarithm of the determinant of the information of the unknowns of interest; none if the design does not determine
    /// all of them.
    pub fn log_determinant(&self, chosen: &[usize]) -> Option<f64> {
        let of_interest = self.of_interest(&self.information(chosen, 0.0))?;
        condition(&of_interest).and_then(|_| log_determinant(&of_interest))
    }

    /// The figures of a design; none if it does not determine all unknowns.
    pub fn figures(&self, chosen: &[usize]) -> Option<DesignFigures> {
        let information = self.information(chosen, 0.0);
        let of_interest = self.of_interest(&information)?;
        let covariance = inverse(&information)?;
        let (log_determinant, spectrum) = (log_determinant(&of_interest)?, eigenvalues(&of_interest)?);
        let smallest = *spectrum.first()?;
        let [mean, largest] = self.response_variances(&covariance);
        let trace: f64 = (0..self.of_interest).map(|k| covariance[(k, k)]).sum();
        Some(DesignFigures {
            log_determinant,
            mean_variance: trace / self.of_interest as f64,
            worst_variance: 1.0 / smallest,
            condition: condition(&of_interest)?,
            response_variance: [mean, largest],
            covariance: (0..self.unknowns)
                .flat_map(|row| (0..self.unknowns).map(move |column| (row, column)))
                .map(|at| covariance[at])
                .collect(),
        })
    }

    /// Required candidates and random ones.
    fn start(&self, generator: &mut Generator) -> Option<Vec<usize>> {
        let mut chosen = self.required.clone();
        let mut cost: f64 = chosen.iter().map(|&index| self.costs[index]).sum();
        let number = self.number.unwrap_or(usize::MAX);
        if chosen.len() > number || self.budget.is_some_and(|budget| cost > budget) {
            return None;
        }
        let mut free: Vec<usize> = (0..self.candidates()).filter(|&index| self.allowed[index]).collect();
        if !self.replications {
            free.retain(|index| !chosen.contains(index));
        }
        while chosen.len() < number {
            if let Some(budget) = self.budget {
                free.retain(|&index| cost + self.costs[index] <= budget);
            }
            if free.is_empty() {
                break;
            }
            let at = generator.index(free.len());
            let index = if self.replications { free[at] } else { free.swap_remove(at) };
            chosen.push(index);
            cost += self.costs[index];
        }
        (!chosen.is_empty() && (self.budget.is_some() || self.number == Some(chosen.len()))).then_some(chosen)
    }

    /// The candidates that may take the place of one that is chosen.
    fn instead(&self, chosen: &[usize], position: usize) -> Vec<usize> {
        let cost = |index: &usize| self.costs[*index];
        let rest = self.budget.map(|budget| budget - chosen.iter().map(cost).sum::<f64>() + cost(&chosen[position]));
        let mut free = self.allowed.clone();
        let taken = if self.replications { &chosen[position..=position] } else { chosen };
        taken.iter().for_each(|&index| free[index] = false);
        (0..self.candidates()).filter(|index| free[*index] && rest.is_none_or(|rest| cost(index) <= rest)).collect()
    }

    /// The candidates that can be added within the budget.
    fn added(&self, chosen: &[usize]) -> Vec<usize> {
        let Some(budget) = self.budget.filter(|_| self.number.is_none_or(|number| chosen.len() < number)) else {
            return Vec::new();
        };
        let rest = budget - chosen.iter().map(|&index| self.costs[index]).sum::<f64>();
        (0..self.candidates())
            .filter(|&index| self.allowed[index] && self.costs[index] <= rest)
            .filter(|index| self.replications || !chosen.contains(index))
            .collect()
    }

    /// Exchanges single rows for the largest determinant. The determinant changes by a factor that follows from the
    /// variances of both rows and their covariance: (1 + d_in) (1 - d_out) + d_in,out².
    fn exchange_rows(&self, chosen: &mut Vec<usize>, fixed: usize) {
        for _ in 0..PASSES {
            // Computed again in each pass, so that rounding does not accumulate.
            let Some(mut all) = Variances::new(self, chosen, 0) else { return };
            let mut nuisance = match self.of_interest < self.unknowns {
                true => Variances::new(self, chosen, self.of_interest),
                false => None,
            };
            let mut better = false;
            for position in fixed..chosen.len() {
                let out = chosen[position];
                let covariances = all.covariances(self, out);
                let others = nuisance.as_ref().map(|nuisance| nuisance.covariances(self, out));
                let factor = |index: usize| {
                    let of_all = all.factor(out, index, covariances[index]);
                    match (&nuisance, &others) {
                        (Some(nuisance), Some(others)) => of_all / nuisance.factor(out, index, others[index]),
                        _ => of_all,
                    }
                };
                let best = best(self.instead(chosen, position).into_iter().map(|index| (index, factor(index))));
                let Some((index, _)) = best.filter(|(_, factor)| *factor > 1.0 + IMPROVEMENT) else { continue };
                all.replace(self, out, index);
                if let Some(nuisance) = &mut nuisance {
                    nuisance.replace(self, out, index);
                }
                chosen[position] = index;
                better = true;
            }
            let information_of = |index: usize| {
                (1.0 + all.of_rows[index]) / nuisance.as_ref().map_or(1.0, |nuisance| 1.0 + nuisance.of_rows[index])
            };
            if let Some((index, _)) = best(self.added(chosen).into_iter().map(|index| (index, information_of(index)))) {
                chosen.push(index);
                better = true;
            }
            if !better {
                return;
            }
        }
    }

    /// Exchanges candidates of any number of rows by any criterion.
    fn exchange_blocks(&self, chosen: &mut Vec<usize>, fixed: usize) {
        for _ in 0..PASSES {
            let mut better = false;
            for position in fixed..chosen.len() {
                let here = self.value(&self.information(chosen, RIDGE));
                let rest: Vec<usize> =
                    chosen.iter().enumerate().filter(|(at, _)| *at != position).map(|(_, index)| *index).collect();
                let rest = self.information(&rest, RIDGE);
                let Some((index, value)) = self.best_with(&rest, self.instead(chosen, position)) else { continue };
                if value > here + IMPROVEMENT * here.abs().max(1.0) || (here == f64::NEG_INFINITY && value > here) {
                    chosen[position] = index;
                    better = true;
                }
            }
            let added = self.added(chosen);
            if let Some((index, _)) = self.best_with(&self.information(chosen, RIDGE), added) {
                chosen.push(index);
                better = true;
            }
            if !better {
                return;
            }
        }
    }

    /// The candidate that gives the best design together with the others, and its value.
    fn best_with(&self, rest: &Mat<f64>, mut candidates: Vec<usize>) -> Option<(usize, f64)> {
        if candidates.len() > COMPARED && self.criterion != Criterion::D {
            let with = |index: usize| log_determinant(&self.with(rest, index)).unwrap_or(f64::NEG_INFINITY);
            let mut informative: Vec<(usize, f64)> = candidates.iter().map(|&index| (index, with(index))).collect();
            informative.sort_by(|(_, one), (_, other)| other.total_cmp(one));
            candidates = informative.into_iter().take(COMPARED).map(|(index, _)| index).collect();
        }
        best(candidates.into_iter().map(|index| (index, self.value(&self.with(rest, index)))))
    }

    fn with(&self, rest: &Mat<f64>, index: usize) -> Mat<f64> {
        let mut information = rest.clone();
        add(&mut information, self.candidate(index), self.unknowns);
        information
    }

    /// Information of what has been measured and of a design, with a ridge.
    fn information(&self, chosen: &[usize], ridge: f64) -> Mat<f64> {
        let p = self.unknowns;
        let mut information = Mat::from_fn(p, p, |row, column| self.measured[row * p + column]);
        chosen.iter().for_each(|&index| add(&mut information, self.candidate(index), p));
        // Unknowns without any effect on the rows get a ridge, too.
        let mean = (0..p).map(|k| information[(k, k)]).sum::<f64>() / p.max(1) as f64;
        (0..p).for_each(|k| information[(k, k)] += ridge * (information[(k, k)] + mean));
        information
    }

    /// The information on the unknowns of interest if the others are estimated, too (Schur complement). None if the others
    /// are not determined.
    fn of_interest(&self, information: &Mat<f64>) -> Option<Mat<f64>> {
        let (q, p) = (self.of_interest, self.unknowns);
        if q == p {
            return Some(information.clone());
        }
        let of_others = inverse(&information.submatrix(q, q, p - q, p - q).to_owned())?;
        let across = information.submatrix(0, q, q, p - q);
        Some(information.submatrix(0, 0, q, q) - across * of_others * across.transpose())
    }

    /// The value of this information by the criterion, larger is better.
    fn value(&self, information: &Mat<f64>) -> f64 {
        let determined = |of_interest: &Mat<f64>| condition(of_interest).is_some();
        let value = self.of_interest(information).filter(determined).and_then(|of_interest| match self.criterion {
            Criterion::D => log_determinant(&of_interest),
            Criterion::A => {
                let covariance = inverse(&of_interest)?;
                Some(-(0..self.of_interest).map(|k| covariance[(k, k)]).sum::<f64>() / self.of_interest as f64)
            }
            Criterion::E => eigenvalues(&of_interest)?.first().filter(|value| **value > 0.0).map(|value| -1.0 / value),
            Criterion::G => Some(-self.response_variances(&inverse(information)?)[1]),
            Criterion::Condition => {
                // With the ridge alone, an unknown without effect would have an independent column of norm 1, which is ideal.
                let largest = (0..self.of_interest).map(|k| of_interest[(k, k)]).fold(0.0, f64::max);
                let unseen = (0..self.of_interest).filter(|&k| of_interest[(k, k)] < 1e3 * RIDGE * largest).count();
                condition(&of_interest).map(|condition| -condition - UNSEEN * unseen as f64)
            }
        });
        value.filter(|value| !value.is_nan()).unwrap_or(f64::NEG_INFINITY)
    }

    /// Mean and largest variance of the predicted responses of the rows of all candidates.
    fn response_variances(&self, covariance: &Mat<f64>) -> [f64; 2] {
        let (mut sum, mut largest) = (0.0, 0.0_f64);
        for row in self.rows.chunks_exact(self.unknowns) {
            let variance = dot_in_lanes(row, &times(covariance, row, 0));
            sum += variance;
            largest = largest.max(variance);
        }
        [sum / (self.rows.len() / self.unknowns).max(1) as f64, largest]
    }
}

/// Variances of the responses of all candidates' rows for a design, for the unknowns from number `first` on.
struct Variances {
    /// The first of these unknowns.
    first: usize,
    /// Their covariance.
    covariance: Mat<f64>,
    /// Variance of the response of every row.
    of_rows: Vec<f64>,
}

impl Variances {
    fn new(choice: &DesignProblem, chosen: &[usize], first: usize) -> Option<Self> {
        let count = choice.unknowns - first;
        let information = choice.information(chosen, RIDGE).submatrix(first, first, count, count).to_owned();
        let covariance = inverse(&information)?;
        let rows = choice.rows.chunks_exact(choice.unknowns);
        let of_rows = rows.map(|row| dot_in_lanes(&row[first..], &times(&covariance, row, first))).collect();
        Some(Self { first, covariance, of_rows })
    }

    /// Covariances of the response of a row with the responses of all rows.
    fn covariances(&self, choice: &DesignProblem, index: usize) -> Vec<f64> {
        let weights = times(&self.covariance, choice.candidate(index), self.first);
        choice.rows.chunks_exact(choice.unknowns).map(|row| dot_in_lanes(&row[self.first..], &weights)).collect()
    }

    /// The factor on the determinant if one row takes the place of another.
    fn factor(&self, out: usize, index: usize, covariance: f64) -> f64 {
        (1.0 + self.of_rows[index]) * (1.0 - self.of_rows[out]) + covariance * covariance
    }

    fn replace(&mut self, choice: &DesignProblem, out: usize, index: usize) {
        self.update(choice, index, 1.0);
        self.update(choice, out, -1.0);
    }

    /// Adds a row (sign 1) or takes it away (-1), after J. Sherman and W. J. Morrison (1950).
    fn update(&mut self, choice: &DesignProblem, index: usize, sign: f64) {
        let weights = times(&self.covariance, choice.candidate(index), self.first);
        let factor = sign / (1.0 + sign * self.of_rows[index]);
        for (variance, row) in self.of_rows.iter_mut().zip(choice.rows.chunks_exact(choice.unknowns)) {
            *variance -= factor * dot_in_lanes(&row[self.first..], &weights).powi(2);
        }
        for column in 0..weights.len() {
            for row in 0..weights.len() {
                self.covariance[(row, column)] -= factor * weights[row] * weights[column];
            }
        }
    }
}

/// The candidate with the largest value, the first of several.
fn best(candidates: impl Iterator<Item = (usize, f64)>) -> Option<(usize, f64)> {
    candidates.filter(|(_, value)| !value.is_nan()).fold(None, |best: Option<(usize, f64)>, this| match best {
        Some(best) if best.1 >= this.1 => Some(best),
        _ => Some(this),
    })
}

/// The inner product as independent sums, which processors compute in parallel. Searches spend most of their time here.
fn dot_in_lanes(one: &[f64], other: &[f64]) -> f64 {
    const LANES: usize = 8;
    let mut sums = [0.0; LANES];
    let (ones, others) = (one.chunks_exact(LANES), other.chunks_exact(LANES));
    let rest: f64 = ones.remainder().iter().zip(others.remainder()).map(|(one, other)| one * other).sum();
    for (one, other) in ones.zip(others) {
        for lane in 0..LANES {
            sums[lane] += one[lane] * other[lane];
        }
    }
    rest + sums.iter().sum::<f64>()
}

/// A symmetric matrix times the entries of a row from `first` on.
fn times(matrix: &Mat<f64>, row: &[f64], first: usize) -> Vec<f64> {
    let column = |k: usize| matrix.col(k).try_as_col_major().map(|column| column.as_slice());
    (first..row.len()).map(|k| column(k - first).map_or(0.0, |column| dot_in_lanes(column, &row[first..]))).collect()
}

/// Adds the information of some rows.
fn add(information: &mut Mat<f64>, rows: &[f64], unknowns: usize) {
    for row in rows.chunks_exact(unknowns) {
        for (column, by) in row.iter().enumerate().filter(|(_, by)| **by != 0.0) {
            row.iter().enumerate().for_each(|(k, value)| information[(k, column)] += value * by);
        }
    }
}

/// None unless the matrix is positive definite.
fn log_determinant(matrix: &Mat<f64>) -> Option<f64> {
    let factor = matrix.llt(Side::Lower).ok()?;
    let diagonal = (0..matrix.nrows()).map(|k| factor.L()[(k, k)].ln());
    Some(2.0 * diagonal.sum::<f64>()).filter(|value| value.is_finite())
}

/// None unless the matrix is positive definite.
fn inverse(matrix: &Mat<f64>) -> Option<Mat<f64>> {
    Some(matrix.llt(Side::Lower).ok()?.inverse())
}

/// Ascending.
fn eigenvalues(matrix: &Mat<f64>) -> Option<Vec<f64>> {
    matrix.self_adjoint_eigenvalues(Side::Lower).ok()
}

/// Condition number of the Jacobian behind an information matrix, with columns of norm 1.
fn condition(information: &Mat<f64>) -> Option<f64> {
    let n = information.nrows();
    let norm = |k: usize| information[(k, k)].sqrt();
    let scaled = Mat::from_fn(n, n, |row, column| information[(row, column)] / (norm(row) * norm(column)));
    let values = eigenvalues(&scaled)?;
    let (smallest, largest) = (*values.first()?, *values.last()?);
    (smallest > OPEN * largest).then(|| (largest / smallest).sqrt())
}
