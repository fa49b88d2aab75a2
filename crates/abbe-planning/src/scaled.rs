//! The derivatives of a problem as rows of designs, and what is known beside its unknowns.

use abbe_core::{EquationIndex, Problem, Result, Whole};
use abbe_numerics::{Criterion, DesignFigures, DesignProblem};

use crate::PlanFigures;
use crate::candidates::Candidate;
use crate::settings::{Planning, PlanningCriterion};

/// The weighted derivatives of all rows, with columns of norm 1.
pub struct Scaled {
    /// Rows of the candidates, one candidate after another.
    rows: Vec<f64>,
    ends: Vec<usize>,
    /// Information matrix of the rows that are no candidates.
    pub measured: Vec<f64>,
    /// Number of the rows that are no candidates.
    pub measured_rows: usize,
    /// Norms of the columns.
    norms: Vec<f64>,
    /// Index of the unknown of every column.
    pub order: Vec<usize>,
    /// How much more a row of the candidates weighs because its touch is repeated, one after another.
    factors: Vec<f64>,
}

impl Scaled {
    pub fn new(contact: &Problem, candidates: &[Candidate], order: &[usize]) -> Result<Self> {
        let p = order.len();
        let mut all = weighted(contact, order)?;
        let norm = |column: usize| all.iter().skip(column).step_by(p).map(|value| value * value).sum::<f64>().sqrt();
        // A column of zeros is reported later: no plan determines its unknown.
        let norms: Vec<f64> = (0..p).map(norm).map(|norm| if norm > 0.0 { norm } else { 1.0 }).collect();
        all.chunks_exact_mut(p).for_each(|row| row.iter_mut().zip(&norms).for_each(|(value, norm)| *value /= norm));
        let (mut rows, mut ends) = (Vec::new(), Vec::new());
        let mut chosen = vec![false; all.len() / p];
        for candidate in candidates {
            for &EquationIndex(equation) in &candidate.equations {
                rows.extend_from_slice(&all[equation * p..(equation + 1) * p]);
                chosen[equation] = true;
            }
            ends.push(rows.len() / p);
        }
        let mut measured = vec![0.0; p * p];
        let others = all.chunks_exact(p).zip(&chosen).filter(|(_, chosen)| !**chosen);
        let mut measured_rows = 0;
        for (row, _) in others {
            measured_rows += 1;
            for (one, line) in row.iter().zip(measured.chunks_exact_mut(p)) {
                line.iter_mut().zip(row).for_each(|(sum, other)| *sum += one * other);
            }
        }
        let factors = vec![1.0; rows.len() / p.max(1)];
        Ok(Self { rows, ends, measured, measured_rows, norms, order: order.to_vec(), factors })
    }

    /// Lets rows of candidates weigh more by these factors.
    pub fn set_factors(&mut self, factors: Vec<f64>) {
        let p = self.order.len().max(1);
        let lines = self.rows.chunks_exact_mut(p).zip(factors.iter().zip(&self.factors));
        lines.for_each(|(row, (now, before))| row.iter_mut().for_each(|value| *value *= now / before));
        self.factors = factors;
    }

    /// The rows of the candidates of a problem at other poses, one candidate after another, in the same columns.
    pub fn rows_of(&self, problem: &Problem, candidates: &[Candidate]) -> Result<Vec<f64>> {
        let (all, p) = (weighted(problem, &self.order)?, self.order.len());
        let equations = candidates.iter().flat_map(|candidate| &candidate.equations);
        let rows = equations.zip(&self.factors).flat_map(|(&EquationIndex(equation), factor)| {
            all[equation * p..(equation + 1) * p]
                .iter()
                .zip(&self.norms)
                .map(move |(value, norm)| factor * value / norm)
        });
        Ok(rows.collect())
    }

    pub fn choice(&self, candidates: &[Candidate], wanted: &Planning, of_interest: usize) -> DesignProblem {
        let required = candidates.iter().enumerate();
        let required = required.flat_map(|(index, candidate)| std::iter::repeat_n(index, candidate.required)).collect();
        DesignProblem {
            unknowns: self.order.len(),
            of_interest,
            rows: self.rows.clone(),
            ends: self.ends.clone(),
            measured: self.measured.clone(),
            costs: candidates.iter().map(|candidate| candidate.duration).collect(),
            required,
            allowed: candidates.iter().map(|candidate| !candidate.forbidden).collect(),
            replications: wanted.replications,
            number: wanted.number.map(Whole::get),
            budget: wanted.budget_s,
            criterion: match wanted.criterion {
                PlanningCriterion::D => Criterion::D,
                PlanningCriterion::A => Criterion::A,
                PlanningCriterion::E => Criterion::E,
                PlanningCriterion::G => Criterion::G,
                PlanningCriterion::Condition => Criterion::Condition,
            },
        }
    }

    /// Figures in the units of the unknowns.
    pub fn figures(&self, choice: &DesignProblem, chosen: &[usize], figures: DesignFigures) -> PlanFigures {
        let p = self.order.len();
        let first = |index: usize| if index == 0 { 0 } else { choice.ends[index - 1] };
        let equations = chosen.iter().map(|&index| choice.ends[index] - first(index)).sum::<usize>();
        let equations = equations + self.measured_rows;
        let mut covariance = vec![0.0; p * p];
        for (row, &one) in self.order.iter().enumerate() {
            for (column, &other) in self.order.iter().enumerate() {
                let scaled = figures.covariance[row * p + column];
                covariance[one * p + other] = scaled / (self.norms[row] * self.norms[column]);
            }
        }
        let of_interest = choice.of_interest;
        let scales: f64 = self.norms[..of_interest].iter().map(|norm| norm.ln()).sum();
        PlanFigures {
            equations,
            log_determinant: figures.log_determinant + 2.0 * scales,
            condition: figures.condition,
            response_variance: figures.response_variance.map(|variance| variance * equations as f64),
            covariance,
            of_interest,
        }
    }
}

/// Derivatives to known inputs, and to results of earlier estimates, weighted as the rows are.
pub struct Known {
    /// Rows of the candidates, one candidate after another: rows times quantities.
    rows: Vec<f64>,
    /// Rows that are no candidates: scaled columns of the unknowns times quantities.
    measured: Vec<f64>,
}

impl Known {
    pub fn new(contact: &Problem, candidates: &[Candidate], scaled: &Scaled) -> Result<Self> {
        let (p, count) = (scaled.order.len(), contact.considered.unknowns.len());
        let mut known = Self { rows: Vec::new(), measured: vec![0.0; p * count] };
        if count == 0 {
            return Ok(known);
        }
        let mut extended = contact.clone();
        extended.unknowns.extend(contact.considered.unknowns.iter().cloned());
        let columns: Vec<usize> = scaled.order.iter().copied().chain(p..p + count).collect();
        let all = weighted(&extended, &columns)?;
        let line = |equation: usize| &all[equation * (p + count)..(equation + 1) * (p + count)];
        let mut chosen = vec![false; all.len() / (p + count)];
        for &EquationIndex(equation) in candidates.iter().flat_map(|candidate| &candidate.equations) {
            known.rows.extend_from_slice(&line(equation)[p..]);
            chosen[equation] = true;
        }
        for equation in (0..chosen.len()).filter(|&equation| !chosen[equation]) {
            let (own, others) = line(equation).split_at(p);
            for (column, value) in own.iter().enumerate() {
                let sums = &mut known.measured[column * count..(column + 1) * count];
                sums.iter_mut().zip(others).for_each(|(sum, other)| *sum += value / scaled.norms[column] * other);
            }
        }
        Ok(known)
    }
}

impl Scaled {
    /// How the estimates of a design follow what is considered: unknowns times quantities, from their covariance.
    pub fn sensitivities(&self, known: &Known, design: &[usize], covariance: &[f64]) -> Vec<f64> {
        let p = self.order.len();
        let count = known.measured.len() / p.max(1);
        let mut cross = known.measured.clone();
        for &candidate in design {
            let first = if candidate == 0 { 0 } else { self.ends[candidate - 1] };
            for row in (first..self.ends[candidate]).filter(|_| count > 0) {
                let others = &known.rows[row * count..(row + 1) * count];
                for (column, value) in self.rows[row * p..(row + 1) * p].iter().enumerate() {
                    let sums = &mut cross[column * count..(column + 1) * count];
                    sums.iter_mut().zip(others).for_each(|(sum, other)| *sum += value * self.factors[row] * other);
                }
            }
        }
        let mut values = vec![0.0; p * count];
        for one in 0..p {
            for (column, &other) in self.order.iter().enumerate() {
                let by = -covariance[one * p + other] * self.norms[column];
                let sums = &mut values[one * count..(one + 1) * count];
                sums.iter_mut()
                    .zip(&cross[column * count..(column + 1) * count])
                    .for_each(|(sum, cross)| *sum += by * cross);
            }
        }
        values
    }
}

/// The weighted derivatives of a problem, its unknowns in this order.
fn weighted(problem: &Problem, order: &[usize]) -> Result<Vec<f64>> {
    let uncertainties = problem.standard_uncertainties();
    let mut all: Vec<f64> = Vec::with_capacity(problem.equations() * order.len());
    problem.linearise(&problem.start(), |block| {
        for (equation, _, derivatives) in block.lines() {
            let weight = 1.0 / uncertainties[equation];
            all.extend(order.iter().map(|&column| derivatives[column] * weight));
        }
    })?;
    Ok(all)
}
