//! Statistics of the residuals of a solution: scatter, outliers.

use abbe_core::{EquationIndex, Outlier, Problem, Quantity, ResidualSums, Result, SizeSums};
use abbe_numerics::{CovarianceRoot, Robust, RobustReport, scatter_factor};

use crate::weighted::Weighted;

/// How the residuals scatter.
pub struct ResidualStatistics {
    /// Equations that take part, constraints included.
    pub used: usize,
    /// Their number less the rank.
    pub degrees_of_freedom: usize,
    /// The part of the degrees of freedom that belongs to the readings; constraints do not scatter.
    pub redundancy: f64,
    /// The a-posteriori factor on the stated uncertainties of the readings.
    pub sigma: f64,
    /// How large the residuals of lengths are.
    pub lengths: Sizes,
    /// How large those of angles are.
    pub angles: Sizes,
}

/// A redundancy below this counts as zero: rounding errors of the redundancy are at most 1e-10.
const LEAST_REDUNDANCY: f64 = 1e-6;

/// The equations of a problem that are constraints: what certificates state.
#[derive(Default)]
pub struct Constraints {
    equations: Vec<bool>,
    /// How many of the unknowns' directions they determine beside the readings: the trace of their part of the hat matrix.
    determined: f64,
}

impl Constraints {
    /// The constraints of a problem; `covariance_root` is of all its rows at x.
    pub fn new(problem: &Problem, x: &[f64], covariance_root: &CovarianceRoot) -> Result<Self> {
        let equations = problem.constraints();
        if !equations.contains(&true) {
            return Ok(Self::default());
        }
        let alone: Vec<f64> = equations.iter().map(|constraint| f64::from(*constraint)).collect();
        let determined = covariance_root.information(&Weighted::new(problem)?.factor(x, Some(&alone))?).trace();
        Ok(Self { equations, determined })
    }

    fn is_one(&self, equation: EquationIndex) -> bool {
        self.equations.get(equation.0).copied().unwrap_or(false)
    }
}

/// How large residuals are, mm or rad; zero where there are none.
pub struct Sizes {
    /// Their number.
    pub count: usize,
    /// The largest absolute value.
    pub max: f64,
    /// The mean absolute value.
    pub mean_abs: f64,
    /// The root mean square.
    pub rms: f64,
}

impl From<SizeSums> for Sizes {
    fn from(sums: SizeSums) -> Self {
        let mean = |sum: f64| sum / sums.count.max(1) as f64;
        Self { count: sums.count, max: sums.max, mean_abs: mean(sums.absolute), rms: mean(sums.squares).sqrt() }
    }
}

impl ResidualStatistics {
    /// Statistics of the rows whose weight is not zero. The a-posteriori factor of a robust estimate is made of the
    /// mean square of the influence and of its slopes ([`scatter_factor`]).
    ///
    /// `quantities` says which residuals are lengths and which angles; `weighted` are the residuals in units of their
    /// uncertainties, uncorrelated. Constraints are counted as rows, but give no information on the scatter of readings.
    pub fn new(
        residuals: &[f64],
        quantities: &[Quantity],
        weighted: &[f64],
        report: Option<&RobustReport>,
        (rank, constraints): (usize, &Constraints),
    ) -> Self {
        let used: Vec<EquationIndex> = EquationIndex::first(residuals.len())
            .filter(|&row| report.is_none_or(|report| report.weights[row] > 0.0))
            .collect();
        let readings: Vec<EquationIndex> = used.iter().copied().filter(|&row| !constraints.is_one(row)).collect();
        let count = readings.len();
        let degrees_of_freedom = used.len().saturating_sub(rank);
        let determined = rank as f64 - constraints.determined;
        let redundancy = count as f64 - determined;
        let influence = |row: EquationIndex| {
            let weight = report.map_or(1.0, |report| report.weights[row]);
            (weight * weighted[row]).powi(2)
        };
        let free = if redundancy > LEAST_REDUNDANCY { redundancy } else { 1.0 };
        let mean_square = readings.iter().map(|&row| influence(row)).sum::<f64>() / free;
        let correction = correction(&readings, report, determined);
        let (angles, lengths): (Vec<EquationIndex>, Vec<EquationIndex>) =
            used.iter().partition(|&&row| quantities[row] == Quantity::Angle);
        let sizes = |rows: &[EquationIndex]| Sizes::from(SizeSums::of(rows.iter().map(|&row| residuals[row])));
        Self {
            used: used.len(),
            degrees_of_freedom,
            redundancy: if redundancy > LEAST_REDUNDANCY { redundancy } else { 0.0 },
            sigma: mean_square.sqrt() * correction,
            lengths: sizes(&lengths),
            angles: sizes(&angles),
        }
    }
}

impl From<(&ResidualSums, usize)> for ResidualStatistics {
    /// Statistics of independent rows that all count alike, and determine `rank` unknowns.
    fn from((sums, rank): (&ResidualSums, usize)) -> Self {
        let used = sums.lengths.count + sums.angles.count;
        let degrees_of_freedom = used.saturating_sub(rank);
        let redundancy = degrees_of_freedom as f64;
        Self {
            used,
            degrees_of_freedom,
            redundancy,
            sigma: (sums.weighted_squares / redundancy.max(1.0)).sqrt(),
            lengths: sums.lengths.into(),
            angles: sums.angles.into(),
        }
    }
}

/// The root mean square of the distances, mm, of rows that have three residuals of lengths, as points in space have, all of them
/// used; none if no row has.
pub fn radial_rms(problem: &Problem, residuals: &[f64], is_used: impl Fn(EquationIndex) -> bool) -> Option<f64> {
    let squares = point_squares(problem, residuals, is_used);
    (!squares.is_empty()).then(|| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
}

/// The squares of these distances, mm².
pub(crate) fn point_squares(problem: &Problem, residuals: &[f64], is_used: impl Fn(EquationIndex) -> bool) -> Vec<f64> {
    let (rows, quantities) = (problem.equation_rows(), problem.quantities());
    let equations: Vec<EquationIndex> = EquationIndex::first(residuals.len()).collect();
    let is_point = |row: &&[EquationIndex]| {
        row.len() == 3 && row.iter().all(|equation| quantities[*equation] == Quantity::Length && is_used(*equation))
    };
    equations
        .chunk_by(|one, other| rows[one.0] == rows[other.0])
        .filter(is_point)
        .map(|row| row.iter().map(|equation| residuals[*equation].powi(2)).sum())
        .collect()
}

/// The factor of the scatter of some rows that determine `determined` unknowns ([`scatter_factor`]). 1 without robust weights.
pub fn correction(rows: &[EquationIndex], report: Option<&RobustReport>, determined: f64) -> f64 {
    let Some(report) = report else { return 1.0 };
    let slopes: Vec<f64> = rows.iter().map(|&row| report.slopes[row]).collect();
    scatter_factor(&slopes, determined)
}

/// The rows with an equation beyond the limit, largest first.
pub fn outliers(problem: &Problem, residuals: &[f64], report: &RobustReport, robust: Robust) -> Vec<Outlier> {
    let mut found: Vec<Outlier> = Vec::new();
    let (mut last, quantities) = (None, problem.quantities());
    let constraints = problem.constraints();
    for (equation, (set, row)) in EquationIndex::enumerate(problem.equation_rows()) {
        if constraints[equation] || report.studentised[equation].abs() < robust.outlier_at {
            continue;
        }
        let residual_um = residuals[equation] * if quantities[equation] == Quantity::Angle { 1e6 } else { 1e3 };
        if last == Some((set, row))
            && let Some(same) = found.last_mut()
        {
            if residual_um.abs() > same.residual_um.abs() {
                same.residual_um = residual_um;
            }
            same.weight = same.weight.min(report.weights[equation]);
            continue;
        }
        last = Some((set, row));
        let origin = problem.origin(set, row);
        found.push(Outlier {
            stage: problem.sets[set].name.clone(),
            file: origin.map_or_else(String::new, |(file, _)| file.display().to_string()),
            line: origin.map_or(0, |(_, origin)| origin.line),
            row: origin.map_or(0, |(_, origin)| origin.row),
            residual_um,
            weight: report.weights[equation],
        });
    }
    found
}
