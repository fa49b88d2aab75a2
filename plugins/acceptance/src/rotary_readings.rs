//! Readings of an R-test that turn the other way round than the ball: a sign is turned, or two columns are exchanged.

use abbe_standards::rotary_interpolation::Path;

/// Least turn, rad, and fewest rows that tell.
const TURN: f64 = std::f64::consts::PI;
const ROWS: usize = 10;

/// Scales of two linear axes, and the angle between them, differ from nominal by far less than this: what they do turns against the
/// ball by half of it, times the distance of the ball.
const OF_MACHINES: f64 = 4e-4;

/// How many times larger than what turns with the ball, and than what is left, this has to be.
const LARGER: f64 = 4.0;
const ABOVE_THE_REST: f64 = 4.0;

/// A sentence on readings, mm, of which far more turns against the ball than with it.
///
/// A ball that is not where it should be turns with the table, and so does its reading. Errors of scale and of squareness turn against it,
/// and are small; with the sign of one reading turned, or two exchanged, the reading of the ball does.
pub fn mirrored(path: &Path, distance: f64, angles: &[f64], readings: &[[f64; 3]], names: [&str; 3]) -> Option<String> {
    let found = Waves::of(path, angles, readings)?;
    if !found.is_mirrored(distance) {
        return None;
    }
    let signs: [[f64; 3]; 3] = [[-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, -1.0]];
    let negated = signs.iter().zip(names).map(|(signs, name)| {
        let own: Vec<[f64; 3]> = readings.iter().map(|own| [0, 1, 2].map(|k: usize| signs[k] * own[k])).collect();
        (format!("the sign of `{name}` turned"), own)
    });
    let exchanged = [[0, 1], [1, 2], [0, 2]].into_iter().map(|[one, other]: [usize; 2]| {
        let mut own = readings.to_vec();
        own.iter_mut().for_each(|own| own.swap(one, other));
        (format!("`{}` and `{}` exchanged", names[one], names[other]), own)
    });
    let is_right = |own: &[[f64; 3]]| {
        Waves::of(path, angles, own)
            .is_some_and(|waves| waves.against * LARGER < waves.with && waves.rest < 1.01 * found.rest)
    };
    let likely: Vec<String> =
        negated.chain(exchanged).filter(|(_, own)| is_right(own)).map(|(words, _)| words).collect();
    (!likely.is_empty()).then(|| {
        format!(
            "{:.1} um of the readings turn against the ball and {:.1} um with it, where scales and squareness make {:.1} um at most; \
             with {} they turn with it: is that what is wrong?",
            1e3 * found.against,
            1e3 * found.with,
            500.0 * OF_MACHINES * distance,
            likely.join(", or with ")
        )
    })
}

/// What turns with the ball and against it, and the root mean square of the rest; mm.
struct Waves {
    with: f64,
    against: f64,
    rest: f64,
}

impl Waves {
    /// By least squares, in the plane across the axis; none for a part of a turn, or few rows.
    fn of(path: &Path, angles: &[f64], readings: &[[f64; 3]]) -> Option<Self> {
        let ends = angles.iter().fold((f64::MAX, f64::MIN), |(low, high), own| (low.min(*own), high.max(*own)));
        if readings.len() < ROWS || ends.1 - ends.0 < TURN {
            return None;
        }
        // Radial and tangential readings: with the ball they stay as they are, the machine turns once, and what is against it twice.
        let split: Vec<[f64; 2]> = angles
            .iter()
            .zip(readings)
            .map(|(angle, own)| {
                let [radial, tangential, _] = path.split(*angle, *own);
                [radial, tangential]
            })
            .collect();
        let sense = path.split(angles[0], path.radial(angles[0] + 1e-3))[1].signum();
        let rows: Vec<[f64; 7]> = (split.iter().zip(angles))
            .flat_map(|([radial, tangential], angle)| {
                let ((s, c), (s2, c2)) = ((sense * angle).sin_cos(), (2.0 * sense * angle).sin_cos());
                [[1.0, 0.0, c, s, c2, s2, *radial], [0.0, 1.0, -s, c, -s2, c2, *tangential]]
            })
            .collect();
        let found = solved(&rows)?;
        let rest = |row: &[f64; 7]| (row[6] - (0..6).map(|k| row[k] * found[k]).sum::<f64>()).powi(2);
        let rest = (rows.iter().map(rest).sum::<f64>() / rows.len() as f64).sqrt();
        Some(Self { with: found[0].hypot(found[1]), against: found[4].hypot(found[5]), rest })
    }

    fn is_mirrored(&self, distance: f64) -> bool {
        let most = (0.5 * OF_MACHINES * distance).max(LARGER * self.with).max(ABOVE_THE_REST * self.rest);
        self.against > most
    }
}

/// Six unknowns by normal equations; none where they are not determined.
fn solved(rows: &[[f64; 7]]) -> Option<[f64; 6]> {
    let mut matrix = [[0.0; 7]; 6];
    for row in rows {
        (0..6).for_each(|i| (0..7).for_each(|j| matrix[i][j] += row[i] * row[j]));
    }
    for pivot in 0..6 {
        let own = matrix[pivot];
        if own[pivot].is_nan() || own[pivot] <= 1e-6 * rows.len() as f64 {
            return None;
        }
        for other in (0..6).filter(|other| *other != pivot) {
            let factor = matrix[other][pivot] / own[pivot];
            (0..7).for_each(|column| matrix[other][column] -= factor * own[column]);
        }
    }
    let found = [0, 1, 2, 3, 4, 5].map(|k: usize| matrix[k][6] / matrix[k][k]);
    found.iter().all(|own| own.is_finite()).then_some(found)
}

#[cfg(test)]
mod tests {
    use abbe_numerics::Generator;

    use super::*;

    const NAMES: [&str; 3] = ["meas_x", "meas_y", "meas_z"];

    /// A random machine with a C axis on the table: its ball is off by as much as it is set up, scales and squareness, straightness.
    fn machine(seed: u64, set_up: f64) -> (Path, f64, Vec<f64>, Vec<[f64; 3]>) {
        let mut generator = Generator::new(seed, 0);
        let mut next = move || generator.normal().clamp(-2.5, 2.5);
        let distance = 40.0 + 60.0 * (1.0 + next().abs());
        let sense = if seed.is_multiple_of(2) { -1.0 } else { 1.0 };
        let path = Path::new([0.0, 0.0, 1.0], [distance, 0.0, 60.0], sense).expect("a path");
        let turn = [180.0_f64, 270.0, 360.0][seed as usize % 3].to_radians();
        let (off, place) = ([set_up * next(), set_up * next()], [0.02 * next(), 0.02 * next()]);
        let (scales, square) = ([4e-5 * next(), 4e-5 * next()], 4e-5 * next());
        let (bow, noise) = (4e-3 * next(), 3e-4);
        let angles: Vec<f64> =
            (0..50).map(|row| turn * f64::from(if row < 25 { row } else { 49 - row }) / 24.0).collect();
        let readings = angles.iter().enumerate().map(|(row, angle)| {
            let (sin, cos) = (sense * angle).sin_cos();
            let (x, y) = (cos, sin);
            let lost = if row < 25 { 2e-3 } else { -2e-3 };
            [
                place[0] + off[0] * cos - off[1] * sin
                    + distance * (scales[0] * x + square * y)
                    + lost
                    + noise * next(),
                place[1] + off[0] * sin + off[1] * cos + distance * scales[1] * y + bow * x * x + noise * next(),
                4e-3 * x + noise * next(),
            ]
        });
        let readings = readings.collect();
        (path, distance, angles, readings)
    }

    #[test]
    fn readings_of_machines_get_no_word() {
        for seed in 0..3_000 {
            for set_up in [0.0, 0.003, 0.02, 0.2] {
                let (path, distance, angles, readings) = machine(seed, set_up);
                assert_eq!(mirrored(&path, distance, &angles, &readings, NAMES), None, "{seed} {set_up}");
            }
        }
    }

    #[test]
    fn readings_that_are_turned_or_exchanged_are_named() {
        type Wrong = fn(&mut [f64; 3]);
        let wrong: [(&str, Wrong); 3] = [
            ("the sign of `meas_x`", |own| own[0] = -own[0]),
            ("the sign of `meas_y`", |own| own[1] = -own[1]),
            ("`meas_x` and `meas_y` exchanged", |own| own.swap(0, 1)),
        ];
        let (mut told, mut all) = (0, 0);
        for seed in 0..300 {
            let (path, distance, angles, readings) = machine(seed, 0.2);
            for (words, change) in wrong {
                let mut changed = readings.clone();
                changed.iter_mut().for_each(change);
                let said = mirrored(&path, distance, &angles, &changed, NAMES);
                assert!(said.as_ref().is_none_or(|said| said.contains(words)), "{seed}: {said:?}");
                told += usize::from(said.is_some());
                all += 1;
            }
        }
        assert!(10 * told > 9 * all, "{told} of {all}");
    }
}
