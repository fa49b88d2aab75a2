//! What the residuals of a solution tell: their scatter, outliers.

use abbe_core::{Outlier, Problem, Quantity};
use abbe_numerics::{Robust, RobustReport};

/// How the residuals scatter.
pub struct Spread {
    pub used: usize,
    pub degrees_of_freedom: usize,
    pub sigma: f64,
    pub lengths: Sizes,
    pub angles: Sizes,
}

/// How large residuals are, mm or rad; zero where there are none.
pub struct Sizes {
    pub count: usize,
    pub max: f64,
    pub mean_abs: f64,
    pub rms: f64,
}

impl Sizes {
    fn of(residuals: &[f64]) -> Self {
        let sizes = || residuals.iter().map(|residual| residual.abs());
        // An empty sum is -0.
        let mean = |sum: f64| (sum + 0.0) / residuals.len().max(1) as f64;
        Self {
            count: residuals.len(),
            max: sizes().fold(0.0, f64::max),
            mean_abs: mean(sizes().sum()),
            rms: mean(sizes().map(|size| size * size).sum()).sqrt(),
        }
    }
}

impl Spread {
    /// Of the rows that are not left out by their weight. The a-posteriori factor of a robust estimate is that of Huber
    /// (1981, section 7.6): the mean square of the influence over the square of its mean slope, with his correction for
    /// the number of unknowns.
    ///
    /// `quantities` says which residuals are lengths and which angles; `weighted` are the residuals in units of their uncertainties, uncorrelated.
    pub fn new(
        residuals: &[f64],
        quantities: &[Quantity],
        weighted: &[f64],
        report: Option<&RobustReport>,
        robust: Option<Robust>,
        rank: usize,
    ) -> Self {
        let used: Vec<usize> =
            (0..residuals.len()).filter(|&row| report.is_none_or(|report| report.weights[row] > 0.0)).collect();
        let count = used.len();
        let degrees_of_freedom = count.saturating_sub(rank);
        let free = degrees_of_freedom.max(1) as f64;
        let influence = |row: usize| {
            let weight = report.map_or(1.0, |report| report.weights[row]);
            (weight * weighted[row]).powi(2)
        };
        let mean_square = used.iter().map(|&row| influence(row)).sum::<f64>() / free;
        let correction = match (report, robust) {
            (Some(report), Some(robust)) if count > 0 => {
                let slopes: Vec<f64> =
                    used.iter().map(|&row| robust.influence_slope(report.studentised[row])).collect();
                let mean = slopes.iter().sum::<f64>() / count as f64;
                let variance = slopes.iter().map(|slope| (slope - mean).powi(2)).sum::<f64>() / count as f64;
                (1.0 + rank as f64 / count as f64 * variance / mean.powi(2)) / mean
            }
            _ => 1.0,
        };
        let (angles, lengths): (Vec<usize>, Vec<usize>) =
            used.iter().partition(|&&row| quantities[row] == Quantity::Angle);
        let sizes = |rows: &[usize]| Sizes::of(&rows.iter().map(|&row| residuals[row]).collect::<Vec<_>>());
        Self {
            used: count,
            degrees_of_freedom,
            sigma: mean_square.sqrt() * correction,
            lengths: sizes(&lengths),
            angles: sizes(&angles),
        }
    }
}

/// The rows with an equation beyond the limit, largest first.
pub fn outliers(problem: &Problem, residuals: &[f64], report: &RobustReport, robust: Robust) -> Vec<Outlier> {
    let mut found: Vec<Outlier> = Vec::new();
    let (mut last, quantities) = (None, problem.quantities());
    for (equation, (set, row)) in problem.equation_rows().into_iter().enumerate() {
        if report.studentised[equation].abs() < robust.outlier_at {
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
