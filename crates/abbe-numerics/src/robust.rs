//! Robust weights (Huber 1964; Beaton & Tukey 1974) on studentised residuals.

/// Influence of a residual as a function of its size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Loss {
    /// Influence grows up to the cutoff and is constant beyond.
    Huber,
    /// Influence returns to zero at the cutoff: residuals beyond it are left out.
    Tukey,
}

/// A robust loss with its cutoff in units of the residuals' scale.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Robust {
    /// The loss.
    pub loss: Loss,
    /// Its cutoff; 1.345 (Huber) and 4.685 (Tukey) keep 95 % efficiency on normal noise.
    pub cutoff: f64,
    /// Studentised size from which a row is called an outlier.
    pub outlier_at: f64,
}

impl Robust {
    /// Huber's loss at 95 % efficiency.
    pub const HUBER: Self = Self { loss: Loss::Huber, cutoff: 1.345, outlier_at: 4.685 };
    /// Tukey's biweight at 95 % efficiency.
    pub const TUKEY: Self = Self { loss: Loss::Tukey, cutoff: 4.685, outlier_at: 4.685 };

    /// The statistical weight of a residual of studentised size `t`, 0 to 1.
    pub fn weight(&self, t: f64) -> f64 {
        let t = t.abs() / self.cutoff;
        match self.loss {
            Loss::Huber => 1.0 / t.max(1.0),
            Loss::Tukey => {
                if t < 1.0 {
                    (1.0 - t * t).powi(2)
                } else {
                    0.0
                }
            }
        }
    }

    /// The loss of a residual of studentised size `t`; its derivative is the influence `t * weight(t)`.
    pub fn loss_at(&self, t: f64) -> f64 {
        let (square, part) = (self.cutoff * self.cutoff, t.abs() / self.cutoff);
        match self.loss {
            Loss::Huber if part > 1.0 => square * (part - 0.5),
            Loss::Huber => t * t / 2.0,
            Loss::Tukey => square / 6.0 * (1.0 - (1.0 - part * part).max(0.0).powi(3)),
        }
    }

    /// Derivative of the influence `t * weight(t)`.
    pub fn influence_slope(&self, t: f64) -> f64 {
        let t = t.abs() / self.cutoff;
        match self.loss {
            Loss::Huber => f64::from(t < 1.0),
            Loss::Tukey => {
                if t < 1.0 {
                    (1.0 - t * t) * (1.0 - 5.0 * t * t)
                } else {
                    0.0
                }
            }
        }
    }
}

/// Results of robust estimation.
#[derive(Debug, Clone, PartialEq)]
pub struct RobustReport {
    /// Statistical weight of every equation, 0 to 1.
    pub weights: Vec<f64>,
    /// Studentised residual of every equation.
    pub studentised: Vec<f64>,
}

/// Smallest scale in units of the stated uncertainties: residuals far below what was stated are never outliers.
const LEAST_SCALE: f64 = 1e-2;

/// Robust scale of studentised residuals: 1.4826 times the median absolute value.
pub(crate) fn scale(sizes: &[f64]) -> f64 {
    let mut sizes: Vec<f64> = sizes.iter().map(|size| size.abs()).filter(|size| *size > 0.0).collect();
    if sizes.is_empty() {
        return LEAST_SCALE;
    }
    let middle = sizes.len() / 2;
    let (_, median, _) = sizes.select_nth_unstable_by(middle, f64::total_cmp);
    (1.4826 * *median).max(LEAST_SCALE)
}

/// Cutoff of Tukey's loss for a scale that half of the rows may be wrong for (Rousseeuw & Yohai 1984).
const SCALE_CUTOFF: f64 = 1.547_645;

/// M-scale of studentised residuals: s where the mean of Tukey's bounded loss of `size / s` is half of its bound (Huber 1964;
/// Rousseeuw & Yohai 1984). It is that of normal noise where there are no gross errors, stays bounded as long as fewer than half of
/// the rows are wrong, and changes smoothly with every residual, as a median does not.
pub(crate) fn m_scale(sizes: &[f64]) -> f64 {
    let sizes: Vec<f64> = sizes.iter().map(|size| size.abs()).filter(|size| *size > 0.0).collect();
    let loss = |t: f64| 1.0 - (1.0 - (t / SCALE_CUTOFF).powi(2)).max(0.0).powi(3);
    let mut spread = scale(&sizes);
    // Huber's fixed point: it rises or falls towards the one solution.
    for _ in 0..200 {
        let mean = sizes.iter().map(|size| loss(size / spread)).sum::<f64>() / sizes.len().max(1) as f64;
        let next = (spread * (2.0 * mean).sqrt()).max(LEAST_SCALE);
        let settled = (next / spread - 1.0).abs() < 1e-10;
        spread = next;
        if settled {
            break;
        }
    }
    spread
}

/// Standard deviations of residuals in units of the noise, given statistical weights and `g_i = j_i (J^T W J)^-1 j_i^T`; none for
/// rows that the fit follows whatever they say.
pub(crate) fn deviations(weights: &[f64], leverages: &[f64]) -> Vec<Option<f64>> {
    let variance = |(weight, leverage): (&f64, &f64)| 1.0 + leverage * (1.0 - 2.0 * weight);
    let rows = weights.iter().zip(leverages).map(variance);
    rows.map(|variance| (variance > 1e-6).then(|| variance.sqrt())).collect()
}

/// Residuals over their own standard deviations. Rows that the fit follows whatever they say have no size.
pub(crate) fn studentised(residuals: &[f64], deviations: &[Option<f64>]) -> Vec<f64> {
    let rows = residuals.iter().zip(deviations);
    rows.map(|(residual, deviation)| deviation.map_or(0.0, |deviation| residual / deviation)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_those_of_the_influence() {
        for robust in [Robust::HUBER, Robust::TUKEY] {
            for t in [0.1, 1.0, 2.0, 4.0, 6.0] {
                let influence = |t: f64| t * robust.weight(t);
                let of_loss = (robust.loss_at(t + 1e-6) - robust.loss_at(t - 1e-6)) / 2e-6;
                assert!((of_loss - influence(t)).abs() < 1e-8, "{robust:?} at {t}");
                let difference = (influence(t + 1e-6) - influence(t - 1e-6)) / 2e-6;
                assert!((difference - robust.influence_slope(t)).abs() < 1e-8, "{robust:?} at {t}");
            }
        }
        assert_eq!(Robust::TUKEY.weight(5.0), 0.0);
    }

    #[test]
    fn the_scale_is_that_of_the_many() {
        let mut sizes: Vec<f64> = (1..=99).map(|i| f64::from(i) / 100.0).collect();
        let clean = scale(&sizes);
        sizes.extend([1e6; 10]);
        assert!((scale(&sizes) / clean - 1.0).abs() < 0.15);
        assert_eq!(scale(&[]), LEAST_SCALE);
        // Signs do not matter, and residuals on one side are no different from those on both.
        let mixed: Vec<f64> = (1..=99).map(|i| f64::from(i) / if i > 50 { 100.0 } else { -100.0 }).collect();
        assert_eq!(scale(&mixed), clean);
    }
}
