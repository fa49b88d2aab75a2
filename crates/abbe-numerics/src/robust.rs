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

/// What the other rows do to the residual of a row, in units of the scale of the noise.
///
/// They say by themselves what the row should read, with a variance of `prediction` (v). The row deviates from that by its deleted
/// residual e, whose standard deviation is `sqrt(1 + v)`; with the weight w the fit follows it, and leaves the residual
/// `r = e / (1 + v w)`. The row is weighed by the size of e, not of r. So a row that the fit would follow far is weighed by what
/// the others think of it, and there is one weight for it whatever it had before: r rises with e.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RowLoss {
    /// The loss of e over its standard deviation.
    pub robust: Robust,
    /// Variance of what the other rows say, at least 0.
    pub prediction: f64,
}

/// Steps of the search for the deleted residual; Newton's method needs about five.
const SEARCH: usize = 100;

/// Variances of predictions below this have a series instead of the closed form of the loss.
const SMALL_PREDICTION: f64 = 1e-2;

impl RowLoss {
    fn deviation(&self) -> f64 {
        (1.0 + self.prediction).sqrt()
    }

    /// The residual that is left of a deleted residual of this studentised size.
    fn residual(&self, t: f64) -> f64 {
        t * self.deviation() / (1.0 + self.prediction * self.robust.weight(t))
    }

    /// The studentised size of the deleted residual of a row with this residual, with its sign.
    pub fn size(&self, residual: f64) -> f64 {
        let wanted = residual.abs();
        let (mut low, mut high) = (wanted / self.deviation(), wanted * self.deviation());
        if !high.is_finite() || self.robust.weight(high) == 1.0 {
            return high.copysign(residual);
        }
        let mut t = high;
        for _ in 0..SEARCH {
            let off = self.residual(t) - wanted;
            if off > 0.0 {
                high = t
            } else {
                low = t
            }
            let followed = 1.0 + self.prediction * self.robust.weight(t);
            let slope = self.deviation() * (followed - self.prediction * self.decline(t)) / (followed * followed);
            let step = t - off / slope;
            let next = if step > low && step < high { step } else { (low + high) / 2.0 };
            let settled = (next - t).abs() <= 1e-15 * t;
            t = next;
            if settled {
                break;
            }
        }
        t.copysign(residual)
    }

    /// `t dw/dt`, never positive.
    fn decline(&self, t: f64) -> f64 {
        self.robust.influence_slope(t) - self.robust.weight(t)
    }

    /// The loss of a row whose deleted residual has this studentised size. Its derivative to the residual is the influence
    /// `residual * weight`.
    pub fn loss(&self, t: f64) -> f64 {
        let Self { robust, prediction } = *self;
        let (t, cutoff) = (t.abs(), robust.cutoff);
        let squared = (1.0 + prediction) * cutoff * cutoff;
        // The least that the row and the others lose together, as a function of e.
        let together = match robust.loss {
            Loss::Huber if t > cutoff => {
                let beyond = t / cutoff - 1.0;
                squared * (0.5 / (1.0 + prediction) + beyond - prediction * (beyond / (1.0 + prediction)).ln_1p())
            }
            Loss::Huber => t * t / 2.0,
            Loss::Tukey => {
                let left = (1.0 - (t / cutoff).powi(2)).max(0.0);
                squared / 2.0 * (self.integral(1.0) - self.integral(left))
            }
        };
        together - prediction / 2.0 * (self.residual(t) * robust.weight(t)).powi(2)
    }

    /// The integral of `v^2 / (1 + prediction v^2)` from 0.
    fn integral(&self, v: f64) -> f64 {
        let prediction = self.prediction;
        if prediction >= SMALL_PREDICTION {
            let root = prediction.sqrt();
            return (v - (root * v).atan() / root) / prediction;
        }
        (0..8).map(|k| (-prediction).powi(k) * v.powi(2 * k + 3) / f64::from(2 * k + 3)).sum()
    }

    /// Derivative of the influence to the residual, for a deleted residual of this studentised size.
    pub fn slope(&self, t: f64) -> f64 {
        let (weight, decline) = (self.robust.weight(t), self.decline(t));
        let followed = 1.0 + self.prediction * weight;
        (weight * followed + decline) / (followed - self.prediction * decline)
    }
}

/// Results of robust estimation.
#[derive(Debug, Clone, PartialEq)]
pub struct RobustReport {
    /// Statistical weight of every equation, 0 to 1.
    pub weights: Vec<f64>,
    /// Studentised deleted residual of every equation: how far it is from what the others say.
    pub studentised: Vec<f64>,
    /// Derivative of the influence of every equation to its residual.
    pub slopes: Vec<f64>,
}

/// Smallest scale in units of the stated uncertainties: residuals far below what was stated are never outliers. What products of errors
/// leave of exact data is no noise, and would leave out rows until the others determine nothing.
const LEAST_SCALE: f64 = 0.1;

/// The same of absolute sizes above zero, ascending, each with its number of rows.
pub(crate) fn counted_scale(sizes: &[(f64, f64)]) -> f64 {
    let middle = (sizes.iter().map(|(_, count)| count).sum::<f64>() / 2.0).floor();
    let mut before = 0.0;
    let median = sizes.iter().find(|(_, count)| {
        before += count;
        before > middle
    });
    median.map_or(LEAST_SCALE, |(size, _)| (1.4826 * size).max(LEAST_SCALE))
}

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
    let counted: Vec<(f64, f64)> = sizes.iter().map(|size| (size.abs(), 1.0)).filter(|(size, _)| *size > 0.0).collect();
    m_scale_from(scale(sizes), &counted)
}

/// The same of absolute sizes above zero, ascending, each with its number of rows.
pub(crate) fn counted_m_scale(sizes: &[(f64, f64)]) -> f64 {
    m_scale_from(counted_scale(sizes), sizes)
}

fn m_scale_from(mut spread: f64, sizes: &[(f64, f64)]) -> f64 {
    let loss = |t: f64| 1.0 - (1.0 - (t / SCALE_CUTOFF).powi(2)).max(0.0).powi(3);
    let rows = sizes.iter().map(|(_, count)| count).sum::<f64>().max(1.0);
    // Huber's fixed point: it rises or falls towards the one solution.
    for _ in 0..200 {
        let mean = sizes.iter().map(|(size, count)| count * loss(size / spread)).sum::<f64>() / rows;
        let next = (spread * (2.0 * mean).sqrt()).max(LEAST_SCALE);
        let settled = (next / spread - 1.0).abs() < 1e-10;
        spread = next;
        if settled {
            break;
        }
    }
    spread
}

/// What multiplies the scatter `sqrt(sum of squared influences / (n - m))` of n rows that determine m unknowns, so that it is the
/// factor of the standard uncertainties; `slopes` are the derivatives of the rows' influence at their studentised residuals. 1 if all
/// are 1, as without a loss, and where no rows are to spare.
///
/// A row pulls the estimate, and by it its own residual, the more the larger m/n is. With g such that the mean of `1 / (1 + g slope)`
/// is `1 - m/n`, the factor is `(1 - m/n) g / (m/n)` (El Karoui, Bean, Bickel, Lim & Yu 2013, on robust regression with many
/// unknowns). Its first terms in m/n are those of Huber (1981, section 7.6), which are 3 % too small at m/n = 0.3 with Tukey's loss.
/// Where so many rows have lost their slope that there is no g, or one beyond 100, the factor is that of this g: the
/// uncertainties are large, as they are then.
pub fn scatter_factor(slopes: &[f64], determined: f64) -> f64 {
    let counted: Vec<(f64, f64)> = slopes.iter().map(|slope| (*slope, 1.0)).collect();
    counted_scatter_factor(&counted, determined)
}

/// The same of slopes each of which so many rows have, about.
///
/// ```
/// use abbe_numerics::{counted_scatter_factor, scatter_factor};
///
/// let all = scatter_factor(&[1.0, 0.5, 0.5, -0.2, 1.0], 1.0);
/// assert!((counted_scatter_factor(&[(-0.2, 1.0), (0.5, 2.0), (1.0, 2.0)], 1.0) - all).abs() < 1e-12);
/// ```
pub fn counted_scatter_factor(slopes: &[(f64, f64)], determined: f64) -> f64 {
    let count = slopes.iter().map(|(_, count)| count).sum::<f64>();
    let share = determined / count;
    if slopes.is_empty() || share >= 1.0 {
        return 1.0;
    }
    let mean = |of: &dyn Fn(f64) -> f64| slopes.iter().map(|&(slope, rows)| rows * of(slope)).sum::<f64>() / count;
    if share < 1e-9 {
        return 1.0 / mean(&|slope| slope).max(1.0 / LARGEST_G);
    }
    // The mean is a convex function of g up to the first pole, so that Newton's steps from 0 come from one side.
    let least = slopes.iter().map(|(slope, _)| *slope).fold(0.0, f64::min);
    let last = if least < 0.0 { (-0.99 / least).min(LARGEST_G) } else { LARGEST_G };
    let mut g = 0.0;
    for _ in 0..100 {
        let excess = mean(&|slope| 1.0 / (1.0 + g * slope)) - (1.0 - share);
        let descent = mean(&|slope| slope / (1.0 + g * slope).powi(2));
        if excess < 1e-12 {
            break;
        }
        let next = g + excess / descent;
        if descent <= 0.0 || next > last {
            g = last;
            break;
        }
        g = next;
    }
    (1.0 - share) * g / share
}

/// Largest g of [`scatter_factor`].
const LARGEST_G: f64 = 100.0;

/// Standard deviations of residuals in units of the noise, given statistical weights and `g_i = j_i (J^T W J)^-1 j_i^T`; none for
/// rows that the fit follows whatever they say.
pub(crate) fn deviations(weights: &[f64], leverages: &[f64]) -> Vec<Option<f64>> {
    weights.iter().zip(leverages).map(|(weight, leverage)| deviation(*weight, *leverage)).collect()
}

/// That of one row.
pub(crate) fn deviation(weight: f64, leverage: f64) -> Option<f64> {
    let variance = 1.0 + leverage * (1.0 - 2.0 * weight);
    (variance > 1e-6).then(|| variance.sqrt())
}

/// Variance of what the rows without each row say of it, in units of the noise, given statistical weights and
/// `g_i = j_i (J^T W J)^-1 j_i^T`; none for rows that the fit follows whatever they say.
pub(crate) fn prediction_variances(weights: &[f64], leverages: &[f64]) -> Vec<Option<f64>> {
    weights.iter().zip(leverages).map(|(weight, leverage)| prediction_variance(*weight, *leverage)).collect()
}

/// That of one row.
pub(crate) fn prediction_variance(weight: f64, leverage: f64) -> Option<f64> {
    let left = 1.0 - weight * leverage;
    (left > 1e-6).then(|| leverage / left)
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
            for prediction in [0.0, 1e-3, 0.0099, 0.0101, 0.3, 4.0, 50.0] {
                let row = RowLoss { robust, prediction };
                for t in [0.1, 1.0, 2.0, 4.0, 4.6, 6.0, 100.0] {
                    let residual = row.residual(t);
                    assert!((row.size(residual) / t - 1.0).abs() < 1e-12, "{row:?} at {t}");
                    assert_eq!(row.size(-residual), -row.size(residual));
                    // The influence is the derivative of the loss, and its own derivative is the slope.
                    let step = 1e-5 * residual;
                    let [less, more] = [-step, step].map(|step| row.size(residual + step));
                    let influence = |t: f64| row.residual(t) * robust.weight(t);
                    let of_loss = (row.loss(more) - row.loss(less)) / (2.0 * step);
                    assert!((of_loss - influence(t)).abs() < 1e-6 * (1.0 + residual), "{row:?} at {t}: {of_loss}");
                    let difference = (influence(more) - influence(less)) / (2.0 * step);
                    assert!((difference - row.slope(t)).abs() < 1e-5, "{row:?} at {t}: {difference}");
                    // The others hold a row at least as strongly as its influence falls: there is one place for it.
                    assert!(1.0 + prediction * row.slope(t) > 0.0);
                }
            }
            // Without such a variance the usual loss.
            let row = RowLoss { robust, prediction: 0.0 };
            assert_eq!((row.size(3.0), row.slope(3.0)), (3.0, robust.influence_slope(3.0)));
        }
        assert_eq!(Robust::TUKEY.weight(5.0), 0.0);
        let [huber, tukey] =
            [Robust::HUBER, Robust::TUKEY].map(|robust| RowLoss { robust, prediction: 0.0 }.loss(10.0));
        assert!((huber - 1.345 * (10.0 - 1.345 / 2.0)).abs() < 1e-9 && (tukey - 4.685 * 4.685 / 6.0).abs() < 1e-9);
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
