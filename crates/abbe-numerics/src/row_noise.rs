//! Noise of readings from row to row, whatever smooth curve they follow.

/// Fewest rows that tell.
const TELLING: usize = 20;

/// Part of the differences that are smaller than what noise is told by, and that size of normal numbers of standard deviation 1: jumps
/// between runs are beyond.
const PART: f64 = 0.25;
const OF_NORMAL: f64 = 0.318_639;

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
    let usual = |values: &[f64]| {
        let mut sizes: Vec<f64> = values.iter().map(|value| value.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        sizes[(PART * sizes.len() as f64) as usize] / OF_NORMAL
    };
    let third = differences(&differences(&differences(&finite)));
    let is_white = usual(&differences(&third)) > OF_NOISE * usual(&third);
    // The squares of the coefficients of a third difference have the sum 20.
    Some(RowNoise { size: usual(&third) / 20_f64.sqrt(), is_white })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Generator;

    #[test]
    fn noise_is_found_beside_smooth_curves() {
        let mut white = 0;
        for seed in 0..500 {
            let mut generator = Generator::new(seed, 0);
            let (rows, size) = (200, 10_f64.powf(generator.normal()));
            let curve = |row: usize| size * (6.0 * row as f64 / rows as f64).sin();
            let noise = 0.01 * size;
            let readings: Vec<f64> = (0..rows).map(|row| curve(row) + noise * generator.normal()).collect();
            let found = row_noise(&readings).expect("many rows");
            assert!((0.4..2.2).contains(&(found.size / noise)), "{seed}: {found:?}");
            white += usize::from(found.is_white);
            let smooth: Vec<f64> = (0..rows).map(curve).collect();
            let found = row_noise(&smooth).expect("many rows");
            assert!(!found.is_white && found.size < 1e-4 * size, "{seed}: {found:?}");
        }
        assert!(white > 470, "{white} of 500");
        assert_eq!(row_noise(&[1.0; 19]), None);
    }

    /// Runs end with jumps: a quarter of the differences is beside them.
    #[test]
    fn jumps_are_no_noise() {
        for seed in 0..200 {
            let mut generator = Generator::new(seed, 0);
            let readings: Vec<f64> = (0..24).map(|row| f64::from(row % 6) + 0.01 * generator.normal()).collect();
            let found = row_noise(&readings).expect("enough rows");
            assert!((0.001..0.1).contains(&found.size), "{seed}: {found:?}");
        }
    }
}
