//! Coverage factors: half width of an interval, or size of a region, in standard uncertainties, that contains a quantity (or
//! several together) with a stated probability.

use statrs::distribution::{Binomial, ChiSquared, ContinuousCDF, DiscreteCDF, Hypergeometric, Normal, StudentsT};
use statrs::function::beta::beta_reg;

/// Degrees of freedom beyond which Student's quantile is the normal one with corrections.
///
/// The corrections leave out terms of the order of `1 / dof^4`, less than 1e-12 here. Inversion of the distribution is as
/// exact up to this value, but has only four digits at 1e6.
const NEARLY_NORMAL: f64 = 1e4;

/// Half width, in standard uncertainties, of the interval that contains one quantity with `probability`: the two-sided
/// quantile of Student's distribution (JCGM 100:2008, G.3). Infinite degrees of freedom mean the normal distribution.
///
/// Degrees of freedom need not be whole. NaN unless `0 < probability < 1` and `degrees_of_freedom > 0`.
pub fn coverage_factor(probability: f64, degrees_of_freedom: f64) -> f64 {
    if !is_probability(probability) || degrees_of_freedom.is_nan() || degrees_of_freedom <= 0.0 {
        return f64::NAN;
    }
    // The quantile of the lower tail is used, because 1 - 1e-12 loses digits that a tail of 1e-12 has.
    let tail = (1.0 - probability) / 2.0;
    let normal = -Normal::standard().inverse_cdf(tail);
    if degrees_of_freedom > NEARLY_NORMAL {
        return nearly_normal(normal, degrees_of_freedom);
    }
    match StudentsT::new(0.0, 1.0, degrees_of_freedom) {
        Ok(student) => upper_quantile(tail, normal, |value| student.sf(value)),
        Err(_) => f64::NAN,
    }
}

/// The value that a positive quantity exceeds with probability `tail`, given its decreasing upper tail. The search starts
/// from `start`.
///
/// Regula falsi (Illinois) on logarithms within a bracket. The inversions of the library that gives the tails do not end for
/// some degrees of freedom that are no whole numbers.
fn upper_quantile(tail: f64, start: f64, upper_tail: impl Fn(f64) -> f64) -> f64 {
    const STEPS: usize = 200;
    let off = |value: f64| upper_tail(value).ln() - tail.ln();
    let (mut low, mut high) = (start.max(1e-3), start.max(1e-3));
    let (mut at_low, mut at_high) = (off(low), off(high));
    while at_low < 0.0 && low > f64::MIN_POSITIVE {
        (high, at_high) = (low, at_low);
        low *= 0.5;
        at_low = off(low);
    }
    while at_high > 0.0 && high < f64::MAX {
        (low, at_low) = (high, at_high);
        high *= 2.0;
        at_high = off(high);
    }
    for _ in 0..STEPS {
        if high - low <= 2.0 * f64::EPSILON * high {
            break;
        }
        let share = at_low / (at_low - at_high);
        let inside = share.is_finite() && share > 0.0 && share < 1.0;
        let middle = low + (high - low) * if inside { share } else { 0.5 };
        let at_middle = off(middle);
        if at_middle == 0.0 {
            return middle;
        }
        if at_middle > 0.0 {
            (low, at_low) = (middle, at_middle);
            at_high *= 0.5;
        } else {
            (high, at_high) = (middle, at_middle);
            at_low *= 0.5;
        }
    }
    0.5 * (low + high)
}

/// Student's quantile from the normal one of the same probability (Abramowitz & Stegun 1964, 26.7.5).
fn nearly_normal(normal: f64, degrees_of_freedom: f64) -> f64 {
    let square = normal * normal;
    let first = (square + 1.0) / 4.0;
    let second = ((5.0 * square + 16.0) * square + 3.0) / 96.0;
    let third = (((3.0 * square + 19.0) * square + 17.0) * square - 15.0) / 384.0;
    normal + normal * (first + (second + third / degrees_of_freedom) / degrees_of_freedom) / degrees_of_freedom
}

/// Size of the hyper-ellipsoid that holds `quantities` normal quantities together with `probability`, in standard
/// uncertainties: the square root of a quantile of chi-squared (JCGM 102:2011, 6.5.2.3 and Table 1), or of Hotelling's T²
/// where the covariance was found with finite `degrees_of_freedom`.
///
/// The ellipsoid is `(y - y0)^T U^-1 (y - y0) <= k^2` with the covariance U. One quantity gives the factor of an
/// interval. NaN unless `0 < quantities <= degrees_of_freedom` and `0 < probability < 1`.
pub fn joint_coverage_factor(quantities: usize, probability: f64, degrees_of_freedom: f64) -> f64 {
    hotelling_quantile(probability, quantities, degrees_of_freedom).sqrt()
}

/// Half width of the sides of a hyper-rectangle that holds `quantities` normal quantities together with at least
/// `probability`, in the standard uncertainty of each, whatever their correlations (JCGM 102:2011, 6.5.3).
///
/// Each quantity may leave its interval with `(1 - probability) / quantities`: by Bonferroni's inequality one or more
/// leave with no more than the sum. With finite `degrees_of_freedom` of their standard uncertainties the intervals are those
/// of Student's t. NaN unless `quantities > 0` and `0 < probability < 1`.
pub fn rectangular_coverage_factor(quantities: usize, probability: f64, degrees_of_freedom: f64) -> f64 {
    if quantities == 0 || !is_probability(probability) {
        return f64::NAN;
    }
    if degrees_of_freedom.is_finite() {
        return coverage_factor(1.0 - (1.0 - probability) / quantities as f64, degrees_of_freedom);
    }
    -Normal::standard().inverse_cdf((1.0 - probability) / (2.0 * quantities as f64))
}

/// The value that a chi-squared quantity stays below with `probability`, with an error of at most 1e-9, absolute plus
/// relative: enough for all but the lower tail of one degree of freedom or less.
///
/// NaN unless `0 < probability < 1` and `degrees_of_freedom` is positive and finite.
pub fn chi_squared_quantile(probability: f64, degrees_of_freedom: f64) -> f64 {
    match chi_squared(degrees_of_freedom) {
        Some(distribution) if is_probability(probability) => distribution.inverse_cdf(probability),
        _ => f64::NAN,
    }
}

/// Probability that a chi-squared quantity is at least `value` by chance.
///
/// NaN if `value` is NaN or `degrees_of_freedom` is not positive and finite.
pub fn chi_squared_upper_tail(value: f64, degrees_of_freedom: f64) -> f64 {
    match chi_squared(degrees_of_freedom) {
        Some(_) if value == f64::INFINITY => 0.0,
        Some(distribution) if !value.is_nan() => distribution.sf(value.max(0.0)),
        _ => f64::NAN,
    }
}

/// Probability that the correlation of `pairs` pairs of independent normal quantities is at least as far from zero as `correlation` by
/// chance, on either side: Student's test with `pairs - 2` degrees of freedom. 1 with fewer than three pairs.
///
/// ```
/// # use abbe_numerics::correlation_by_chance;
/// // Tables of the coefficient of correlation: 0.632 of ten pairs is reached by chance in 5 %.
/// assert!((correlation_by_chance(-0.6319, 10) - 0.05).abs() < 1e-4);
/// ```
pub fn correlation_by_chance(correlation: f64, pairs: usize) -> f64 {
    if pairs < 3 || correlation.is_nan() {
        return 1.0;
    }
    let degrees_of_freedom = (pairs - 2) as f64;
    let rest = (1.0 - correlation * correlation).max(0.0);
    beta_reg(degrees_of_freedom / 2.0, 0.5, rest)
}

/// Quantile of Hotelling's T², the squared distance of `quantities` quantities whose covariance was found with these degrees of
/// freedom: `q f / (f - q + 1)` times that of F with q and f - q + 1 (Hotelling 1931); chi-squared where f is infinite. NaN
/// with fewer degrees of freedom than quantities.
pub fn hotelling_quantile(probability: f64, quantities: usize, degrees_of_freedom: f64) -> f64 {
    let (q, rest) = (quantities as f64, degrees_of_freedom - quantities as f64 + 1.0);
    if degrees_of_freedom.is_infinite() {
        return chi_squared_quantile(probability, q);
    }
    match q > 0.0 && q <= degrees_of_freedom && is_probability(probability) {
        true => {
            let quantile = upper_quantile(1.0 - probability, 1.0, |value| fisher_upper_tail(value, q, rest));
            q * degrees_of_freedom / rest * quantile
        }
        false => f64::NAN,
    }
}

/// Probability that F with `first` and `second` degrees of freedom is at least `value`, exact in the far tail, too
/// (Abramowitz & Stegun 1964, 26.6.2).
fn fisher_upper_tail(value: f64, first: f64, second: f64) -> f64 {
    beta_reg(second / 2.0, first / 2.0, second / (second + first * value))
}

/// Probability that Hotelling's T² is at least `value`; see [`hotelling_quantile`].
pub fn hotelling_upper_tail(value: f64, quantities: usize, degrees_of_freedom: f64) -> f64 {
    let (q, rest) = (quantities as f64, degrees_of_freedom - quantities as f64 + 1.0);
    if degrees_of_freedom.is_infinite() {
        return chi_squared_upper_tail(value, q);
    }
    if q > degrees_of_freedom {
        return f64::NAN;
    }
    match q > 0.0 && !value.is_nan() && !degrees_of_freedom.is_nan() {
        true => fisher_upper_tail(value.max(0.0) * rest / (q * degrees_of_freedom), q, rest),
        false => f64::NAN,
    }
}

/// The smallest central band of counts (both ends included) that contains the number of successes in `trials` independent
/// trials with at least `confidence`, if each succeeds with `probability`. The counts below the band have a probability of at
/// most `(1 - confidence) / 2`, and so do those above it.
///
/// All counts if `probability` is not in 0..=1 or `confidence` not in 0..1.
pub fn binomial_band(trials: usize, probability: f64, confidence: f64) -> (usize, usize) {
    let Ok(distribution) = Binomial::new(probability, trials as u64) else { return (0, trials) };
    if !(0.0..1.0).contains(&confidence) {
        return (0, trials);
    }
    // A tail that is exactly equal is admissible, even if rounding makes its sum a little larger.
    let tail = (1.0 - confidence) / 2.0 * (1.0 + 1e-12);
    // Low is the first count up to which there is more than the tail, high the first beyond which there is no more.
    let low = first(trials, |count| distribution.cdf(count as u64) > tail);
    let high = first(trials, |count| distribution.sf(count as u64) <= tail);
    (low, high.max(low))
}

/// The probability of at least `found` successes in `trials` independent trials, if each succeeds with `probability`.
///
/// NaN if `probability` is not in 0..=1.
///
/// ```
/// assert!((abbe_numerics::binomial_upper_tail(10, 0.5, 10) - 1.0 / 1024.0).abs() < 1e-15);
/// ```
pub fn binomial_upper_tail(trials: usize, probability: f64, found: usize) -> f64 {
    let Ok(distribution) = Binomial::new(probability, trials as u64) else { return f64::NAN };
    found.checked_sub(1).map_or(1.0, |fewer| distribution.sf(fewer as u64))
}

/// The probability that chance finds at least `found` of the `marked` ones among `drawn` that are drawn without return out of `all`.
///
/// NaN if more are marked or drawn than there are.
///
/// ```
/// // Two cards of a pack of 52 are both aces: 4/52 * 3/51.
/// assert!((abbe_numerics::drawn_by_chance(52, 4, 2, 2) - 1.0 / 221.0).abs() < 1e-12);
/// ```
pub fn drawn_by_chance(all: usize, marked: usize, drawn: usize, found: usize) -> f64 {
    let Ok(distribution) = Hypergeometric::new(all as u64, marked as u64, drawn as u64) else { return f64::NAN };
    match found.checked_sub(1) {
        Some(fewer) => distribution.sf(fewer as u64),
        None => 1.0,
    }
}

/// The first of `0..=last` that is `reached`, given that all after it are too; `last` if there is none.
fn first(last: usize, reached: impl Fn(usize) -> bool) -> usize {
    let (mut low, mut high) = (0, last);
    while low < high {
        let middle = low + (high - low) / 2;
        if reached(middle) {
            high = middle;
        } else {
            low = middle + 1;
        }
    }
    low
}

/// Effective degrees of freedom of a sum of independent parts by the Welch-Satterthwaite formula (JCGM 100:2008, G.4.1).
/// `parts` are (variance that the part contributes, degrees of freedom); variances include sensitivities and have the same
/// unit.
///
/// Infinite where no part that contributes has finite degrees of freedom; not rounded down to a whole number.
pub fn effective_degrees_of_freedom(parts: &[(f64, f64)]) -> f64 {
    let total: f64 = parts.iter().map(|(variance, _)| variance).sum();
    // Shares of the total, because the square of a variance in mm^2 may be as small as 1e-40.
    let contributing = parts.iter().filter(|(variance, _)| *variance != 0.0);
    let weighed = contributing.map(|(variance, degrees_of_freedom)| (variance / total).powi(2) / degrees_of_freedom);
    // Not `sum`, which is -0 where there is nothing to add.
    1.0 / weighed.fold(0.0, |sum, part| sum + part)
}

fn is_probability(probability: f64) -> bool {
    probability > 0.0 && probability < 1.0
}

fn chi_squared(degrees_of_freedom: f64) -> Option<ChiSquared> {
    degrees_of_freedom.is_finite().then(|| ChiSquared::new(degrees_of_freedom).ok()).flatten()
}
