//! Noise of readings from row to row, whatever smooth curve they follow.

/// Fewest rows that tell.
const TELLING: usize = 20;

/// How many times larger fourth differences are than third ones at least where rows do not know each other: √(70/20) = 1.87 times for
/// white noise, less than once where readings follow a smooth curve.
const OF_NOISE: f64 = 1.4;

/// What readings scatter from row to row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RowNoise {
    /// Standard deviation, in the unit of the readings.
    pub size: f64,
    /// Whether it is noise: where readings are smooth the size is what is left of their curve.
    pub is_white: bool,
}

/// The noise of readings in the order of their rows, from their third differences, which leave nothing of parabolas; none of fewer than 20
/// numbers. What is no finite number is left out.
///
/// ```
/// let smooth: Vec<f64> = (0..50).map(|row| f64::from(row * row)).collect();
/// assert!(abbe_numerics::row_noise(&smooth).is_some_and(|noise| noise.size == 0.0 && !noise.is_white));
/// ```
pub fn row_noise(readings: &[f64]) -> Option<RowNoise> {
    let finite: Vec<f64> = readings.iter().copied().filter(|value| value.is_finite()).collect();
    if finite.len() < TELLING {
        return None;
    }
    let differences = |values: &[f64]| -> Vec<f64> { values.windows(2).map(|pair| pair[1] - pair[0]).collect() };
    let rms = |values: &[f64]| (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt();
    let third = differences(&differences(&differences(&finite)));
    let is_white = rms(&differences(&third)) > OF_NOISE * rms(&third);
    // The squares of the coefficients of a third difference have the sum 20.
    Some(RowNoise { size: rms(&third) / 20_f64.sqrt(), is_white })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Generator;

    #[test]
    fn noise_is_found_beside_smooth_curves() {
        for seed in 0..500 {
            let mut generator = Generator::new(seed, 0);
            let (rows, size) = (200, 10_f64.powf(generator.normal()));
            let curve = |row: usize| size * (6.0 * row as f64 / rows as f64).sin();
            let noise = 0.01 * size;
            let readings: Vec<f64> = (0..rows).map(|row| curve(row) + noise * generator.normal()).collect();
            let found = row_noise(&readings).expect("many rows");
            assert!(found.is_white && (0.7..1.4).contains(&(found.size / noise)), "{seed}: {found:?}");
            let smooth: Vec<f64> = (0..rows).map(curve).collect();
            let found = row_noise(&smooth).expect("many rows");
            assert!(!found.is_white && found.size < 1e-4 * size, "{seed}: {found:?}");
        }
        assert_eq!(row_noise(&[1.0; 19]), None);
    }
}
