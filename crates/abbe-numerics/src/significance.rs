//! Probabilities of test statistics.

use statrs::distribution::{ContinuousCDF, FisherSnedecor, Normal};

/// An F statistic that chance never makes.
const CERTAIN: f64 = 1e100;

/// Probability that an F statistic with these degrees of freedom is at least `value` by chance; None without degrees of
/// freedom.
pub fn f_test(value: f64, numerator: usize, denominator: usize) -> Option<f64> {
    let distribution = FisherSnedecor::new(numerator as f64, denominator as f64).ok()?;
    // The distribution cannot be evaluated far beyond all that chance makes.
    value.is_finite().then(|| if value > CERTAIN { 0.0 } else { distribution.sf(value.max(0.0)) })
}

/// Probability that a standard normal quantity is at least `value` away from zero.
pub fn two_sided_normal(value: f64) -> f64 {
    2.0 * Normal::standard().sf(value.abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_of_the_tables() {
        // F(0.95; 4, 20) = 2.866, and 1.96 for the normal distribution.
        assert!((f_test(2.8661, 4, 20).unwrap_or_default() - 0.05).abs() < 1e-4);
        assert!((two_sided_normal(1.959_964) - 0.05).abs() < 1e-6);
        assert_eq!(f_test(1.0, 0, 3), None);
        for value in [1e99, 1e200, f64::MAX] {
            assert!(f_test(value, 3, 40).is_some_and(|p| p < 1e-99));
        }
    }
}
