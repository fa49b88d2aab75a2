//! Regression diagnostics and the selection of terms by their significance (Soons 1993, section 3.2.2; Montgomery & Peck 1982).

use faer::linalg::solvers::Qr;
use faer::{Mat, MatRef};

use crate::factor::Factor;
use crate::significance::f_test;

/// Influence of each row on a fit.
#[derive(Debug, Clone, PartialEq)]
pub struct Influence {
    /// Residuals over their own standard deviations.
    pub studentised: Vec<f64>,
    /// The same, with the standard deviation from the other rows only; infinite if these fit exactly.
    pub deleted: Vec<f64>,
    /// Cook's distance: squared change of all fitted values together when the row is left out, per coefficient and variance.
    pub cook: Vec<f64>,
}

impl Influence {
    /// The influence of rows with these residuals and leverages on a fit of `unknowns` unknowns. NaN for a row that the fit
    /// always passes through (leverage 1).
    pub fn new(residuals: &[f64], leverages: &[f64], unknowns: usize) -> Self {
        let freedom = residuals.len() as f64 - unknowns as f64;
        let variance = residuals.iter().map(|residual| residual * residual).sum::<f64>() / freedom;
        let rows = || residuals.iter().zip(leverages);
        let studentised: Vec<f64> =
            rows().map(|(residual, leverage)| residual / (variance * (1.0 - leverage)).sqrt()).collect();
        let deleted = |size: &f64| size * ((freedom - 1.0) / (freedom - size * size).max(0.0)).sqrt();
        Self {
            deleted: studentised.iter().map(deleted).collect(),
            cook: rows()
                .zip(&studentised)
                .map(|((_, leverage), size)| size * size * leverage / (unknowns as f64 * (1.0 - leverage)))
                .collect(),
            studentised,
        }
    }
}

/// In which direction terms are selected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StepwiseDirection {
    /// Starting from none, terms come in.
    Forward,
    /// Starting from all, terms go out.
    Backward,
    /// Starting from none, terms come in and may go out again, or be replaced by better ones.
    Both,
}

/// A step of a selection.
#[derive(Debug, Clone, PartialEq)]
pub struct SelectionStep {
    /// The unknown that the term has as its coefficient.
    pub term: usize,
    /// Whether it came in or went out.
    pub entered: bool,
    /// Probability that chance alone makes it look as significant.
    pub probability: f64,
}

/// Terms chosen by their significance.
#[derive(Debug, Clone, PartialEq)]
pub struct StepwiseSelection {
    /// The candidates that are kept, ascending.
    pub kept: Vec<usize>,
    /// How it went.
    pub steps: Vec<SelectionStep>,
}

impl Factor {
    /// Stepwise regression of the terms whose coefficients are the unknowns `candidates`. In each step a term comes in if the
    /// probability that chance alone explains it is below `level`, or goes out if this probability is above `level` (partial
    /// F test; Soons 1993, section 3.2.2). All other unknowns stay in.
    ///
    /// The factor is that of the full problem at `x`, which has `degrees_of_freedom`. None if its unknowns cannot be
    /// separated.
    pub fn stepwise(
        &self,
        x: &[f64],
        candidates: &[usize],
        degrees_of_freedom: usize,
        level: f64,
        direction: StepwiseDirection,
    ) -> Option<StepwiseSelection> {
        let terms = Terms::new(self, x, candidates, degrees_of_freedom)?;
        let mut kept: Vec<usize> =
            if direction == StepwiseDirection::Backward { (0..candidates.len()).collect() } else { vec![] };
        let (mut steps, mut seen) = (Vec::new(), vec![kept.clone()]);
        loop {
            let fit = terms.fit(&kept)?;
            let leaves = fit.leaves(&terms, &kept).filter(|step| step.probability > level);
            let enters = || fit.enters(&terms, &kept).filter(|step| step.probability < level);
            let next = match direction {
                StepwiseDirection::Forward => enters().into_iter().collect(),
                StepwiseDirection::Backward => leaves.into_iter().collect(),
                StepwiseDirection::Both => match leaves.or_else(enters) {
                    Some(step) => vec![step],
                    None => terms.replacement(&kept, fit.cost),
                },
            };
            let mut after = kept.clone();
            for step in &next {
                match after.binary_search(&step.term) {
                    Ok(place) => drop(after.remove(place)),
                    Err(place) => after.insert(place, step.term),
                }
            }
            // Ends if nothing changes, or if a selection occurs again: rounding must not make a term come and go for ever.
            if seen.contains(&after) {
                break;
            }
            steps.extend(next.into_iter().map(|step| SelectionStep { term: candidates[step.term], ..step }));
            seen.push(after.clone());
            kept = after;
        }
        Some(StepwiseSelection { kept: kept.into_iter().map(|term| candidates[term]).collect(), steps })
    }
}

/// The candidates of a selection as columns of norm 1, orthogonal to the columns of all other unknowns.
struct Terms {
    columns: Mat<f64>,
    right: Mat<f64>,
    /// Sum of squares that remains with all terms, and its degrees of freedom.
    rest: f64,
    degrees_of_freedom: usize,
}

/// The fit of some terms.
struct TermsFit {
    cost: f64,
    /// By how much the cost grows without each of the terms.
    losses: Vec<f64>,
    /// An orthonormal basis of the terms, and the remaining part of the right side.
    basis: Mat<f64>,
    left: Mat<f64>,
}

/// Least relative reduction of the cost by a replacement, so that it is not rounding.
const LOWER: f64 = 1e-9;

/// Squares of columns of norm 1 below this are rounding: the column follows from the others.
const NOTHING: f64 = 1e-20;

impl Terms {
    fn new(factor: &Factor, x: &[f64], candidates: &[usize], degrees_of_freedom: usize) -> Option<Self> {
        let step = factor.step()?;
        let n = factor.unknowns();
        let others: Vec<usize> = (0..n).filter(|unknown| !candidates.contains(unknown)).collect();
        // The right side of the full problem with all unknowns at zero: J (x + step), without the part that no unknown
        // explains.
        let mut all = Mat::zeros(n, n + 1);
        for (place, &unknown) in others.iter().chain(candidates).enumerate() {
            let norm = factor.norms()[unknown];
            if norm == 0.0 {
                return None;
            }
            for (row, entry) in factor.column(unknown).into_iter().enumerate() {
                all[(row, place)] = entry / norm;
                all[(row, n)] += entry * (x[unknown] + step[unknown]);
            }
        }
        let triangle = Qr::new(all.as_ref()).thin_R().to_owned();
        if (0..n).any(|k| triangle[(k, k)].powi(2) < NOTHING) {
            return None;
        }
        let first = others.len();
        Some(Self {
            columns: triangle.get(first..n, first..n).to_owned(),
            right: triangle.get(first..n, n..).to_owned(),
            rest: factor.remaining_cost(),
            degrees_of_freedom,
        })
    }

    fn some(&self, terms: &[usize]) -> Mat<f64> {
        Mat::from_fn(self.columns.nrows(), terms.len(), |row, column| self.columns[(row, terms[column])])
    }

    /// The terms that are not among these.
    fn others(&self, kept: &[usize]) -> Vec<usize> {
        (0..self.columns.ncols()).filter(|term| kept.binary_search(term).is_err()).collect()
    }

    fn fit(&self, kept: &[usize]) -> Option<TermsFit> {
        let factor = Qr::new(self.some(kept).as_ref());
        let (basis, triangle) = (factor.compute_thin_Q(), factor.thin_R().to_owned());
        let along = basis.transpose() * &self.right;
        let left = &self.right - &basis * &along;
        let mut inverse = Mat::<f64>::identity(kept.len(), kept.len());
        faer::linalg::triangular_solve::solve_upper_triangular_in_place(
            triangle.as_ref(),
            inverse.as_mut(),
            faer::Par::Seq,
        );
        let values = &inverse * &along;
        let loss = |row: usize| {
            let variance: f64 = (0..kept.len()).map(|k| inverse[(row, k)].powi(2)).sum();
            values[(row, 0)].powi(2) / variance
        };
        let losses: Vec<f64> = (0..kept.len()).map(loss).collect();
        let finite = losses.iter().all(|loss| loss.is_finite());
        finite.then(|| TermsFit { cost: self.rest + square(left.as_ref(), 0), losses, basis, left })
    }

    /// The pair of a term that goes out and a term that replaces it with the lowest cost, if this is below `cost`.
    ///
    /// Wrong terms that came in early can only be removed in this way (Miller 2002, section 3.3).
    fn replacement(&self, kept: &[usize], cost: f64) -> Vec<SelectionStep> {
        let mut best = (cost * (1.0 - LOWER), Vec::new());
        for &term in kept {
            let others: Vec<usize> = kept.iter().copied().filter(|other| *other != term).collect();
            let Some(fit) = self.fit(&others) else { continue };
            // Probability of the term that goes out, from the costs without it and with it.
            let Some(probability) = self.probability(fit.cost - cost, cost, kept.len()) else { continue };
            let Some(enters) = fit.enters(self, &others) else { continue };
            let with: Vec<usize> = others.iter().copied().chain([enters.term]).collect();
            let Some(after) = self.fit(&with).map(|fit| fit.cost) else { continue };
            if after < best.0 {
                best = (after, vec![SelectionStep { term, entered: false, probability }, enters]);
            }
        }
        best.1
    }

    /// Probability that chance alone reduces the cost as much as a term does. `count` is the number of terms, this one
    /// included. None without degrees of freedom.
    fn probability(&self, gain: f64, with: f64, count: usize) -> Option<f64> {
        let freedom = self.degrees_of_freedom + self.columns.ncols() - count;
        let f = gain / (with / freedom as f64);
        if f.is_finite() { f_test(f, 1, freedom) } else { Some(if gain > 0.0 { 0.0 } else { 1.0 }) }
    }
}

impl TermsFit {
    /// The least significant term.
    fn leaves(&self, terms: &Terms, kept: &[usize]) -> Option<SelectionStep> {
        let least = (0..kept.len()).min_by(|&a, &b| self.losses[a].total_cmp(&self.losses[b]))?;
        let probability = terms.probability(self.losses[least], self.cost, kept.len())?;
        Some(SelectionStep { term: kept[least], entered: false, probability })
    }

    /// The most significant one of the other terms.
    fn enters(&self, terms: &Terms, kept: &[usize]) -> Option<SelectionStep> {
        let others = terms.others(kept);
        let mut columns = terms.some(&others);
        columns -= &self.basis * (self.basis.transpose() * &columns);
        let along = columns.transpose() * &self.left;
        let gain = |place: usize| {
            let square = square(columns.as_ref(), place);
            if square > NOTHING { along[(place, 0)].powi(2) / square } else { 0.0 }
        };
        let most = (0..others.len()).max_by(|&a, &b| gain(a).total_cmp(&gain(b)))?;
        let gain = gain(most);
        let probability = terms.probability(gain, (self.cost - gain).max(0.0), kept.len() + 1)?;
        Some(SelectionStep { term: others[most], entered: true, probability })
    }
}

/// Sum of squares of a column.
fn square(matrix: MatRef<'_, f64>, column: usize) -> f64 {
    (0..matrix.nrows()).map(|row| matrix[(row, column)].powi(2)).sum()
}
