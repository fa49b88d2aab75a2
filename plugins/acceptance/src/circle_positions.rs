//! Positions of a circle that its angles or its radius contradict: a column with another sign, another unit or of another axis.

use std::f64::consts::PI;

use abbe_core::{Column, Dataset, Quantity};
use nalgebra::{Matrix3, Vector3};

/// Fewest rows of a circle or an arc, and the least mean square distance of its unit vectors from their mean: an arc of 85 degrees.
const ROWS: usize = 12;
const SPREAD: f64 = 0.17;

/// Parts of the radius by which positions are off at most (1 degree; those of a machine are off by far less), and its radius is.
const OFF: f64 = 0.02;
const RADIUS: f64 = 0.02;

/// Part of a thousand of the travel, mm, below which nothing moves on a circle.
const STILL: f64 = 1e-3;

/// Linear axes in the order in which angles turn: from X to Y, from Y to Z, from Z to X.
const AXES: [&str; 3] = ["X", "Y", "Z"];

/// A position along the first and the second axis of a plane.
type Place = [f64; 2];

/// The circle of positions at stated angles, wherever its centre is and at whichever angle it begins.
#[derive(Debug, Clone, Copy)]
struct Round {
    radius: f64,
    /// By how much angles are beside those of the positions, rad, from -pi to pi.
    beside: f64,
    /// Root mean square of what is left, mm.
    off: f64,
}

impl Round {
    /// By least squares; none for a short arc.
    fn of(angles: &[f64], places: &[Place]) -> Option<Self> {
        let count = places.len() as f64;
        let mean = |of: &dyn Fn(usize) -> f64| (0..places.len()).map(of).sum::<f64>() / count;
        let units: Vec<Place> = angles.iter().map(|angle| [angle.cos(), angle.sin()]).collect();
        let centred = |all: &[Place]| -> Vec<Place> {
            let centre = [0, 1].map(|axis: usize| mean(&|row| all[row][axis]));
            all.iter().map(|own| [own[0] - centre[0], own[1] - centre[1]]).collect()
        };
        let (units, own) = (centred(&units), centred(places));
        let spread = mean(&|row| units[row][0].powi(2) + units[row][1].powi(2));
        if places.len() < ROWS || spread.is_nan() || spread < SPREAD {
            return None;
        }
        let along = mean(&|row| units[row][0] * own[row][0] + units[row][1] * own[row][1]) / spread;
        let across = mean(&|row| units[row][0] * own[row][1] - units[row][1] * own[row][0]) / spread;
        let left = |row: usize| {
            let ([c, s], [one, other]) = (units[row], own[row]);
            (one - along * c + across * s).powi(2) + (other - along * s - across * c).powi(2)
        };
        Some(Self { radius: along.hypot(across), beside: across.atan2(along), off: mean(&left).sqrt() })
    }

    fn is_at_angles(&self, radius: f64) -> bool {
        self.off <= OFF * radius
    }

    fn fits(&self, radius: f64) -> bool {
        self.is_at_angles(radius) && (self.radius - radius).abs() <= RADIUS * radius
    }
}

/// What may be wrong: its words, and what corrects it.
type Mistake = (String, Box<dyn Fn(&Place) -> Place>);

/// A sentence on the rows of one direction whose positions are in no plane, or not at their angles (rad) on the circle of this radius,
/// mm. An offset of all angles has a sentence of its own elsewhere.
pub fn contradicted(data: &Dataset, angle: &str, angles: &[f64], rows: &[usize], radius: f64) -> Option<String> {
    if turns(data, angle) {
        return None;
    }
    if let Some(sentence) = beside_any_plane(data, rows, radius) {
        return Some(sentence);
    }
    let plane = plane(data, radius)?;
    let numbers = |axis: usize| data.numbers(&plane[axis].header.name);
    let (one, other) = (numbers(0)?, numbers(1)?);
    let angles: Vec<f64> = rows.iter().map(|row| angles[*row]).collect();
    let places: Vec<Place> = rows.iter().map(|row| [one[*row], other[*row]]).collect();
    sentence([&plane[0].header.header, &plane[1].header.header], angle, &angles, &places, radius)
}

fn sentence(names: [&str; 2], angle: &str, angles: &[f64], places: &[Place], radius: f64) -> Option<String> {
    let found = Round::of(angles, places).filter(|found| !found.fits(radius))?;
    let [one, other] = names;
    if found.off <= OFF * found.radius {
        return Some(format!(
            "the positions `{one}` and `{other}` are on a circle of {:.3} mm, and `radius_mm` is {radius}: is it that of this circle, and \
             is the unit of the positions right?",
            found.radius
        ));
    }
    let tried = mistakes(names, angle, places, radius).into_iter().filter_map(|(words, correct)| {
        let corrected: Vec<Place> = places.iter().map(&correct).collect();
        Round::of(angles, &corrected).filter(|round| round.fits(radius)).map(|round| (words, round))
    });
    let likely = tried.min_by(|(_, one), (_, other)| one.beside.abs().total_cmp(&other.beside.abs()));
    let corrected = likely.map_or_else(
        || ": are these the columns of this circle?".to_owned(),
        |(words, round)| format!(", and {:.3} mm with {words}: is that what is wrong?", round.off),
    );
    Some(format!(
        "the positions `{one}` and `{other}` are {:.3} mm off those of `{angle}` on a circle of {radius} mm (root mean square){corrected}",
        found.off
    ))
}

fn mistakes(names: [&str; 2], angle: &str, places: &[Place], radius: f64) -> Vec<Mistake> {
    let [one, other] = names;
    let size = |axis: usize| {
        let ends =
            places.iter().fold((f64::MAX, f64::MIN), |(low, high), own| (low.min(own[axis]), high.max(own[axis])));
        0.5 * (ends.1 - ends.0)
    };
    let scales = [0, 1].map(|axis| radius / size(axis));
    let times = |axis: usize| -> Mistake {
        let scale = scales[axis];
        let correct = move |own: &Place| if axis == 0 { [scale * own[0], own[1]] } else { [own[0], scale * own[1]] };
        (format!("`{}` times {scale:.4}", names[axis]), Box::new(correct))
    };
    let simple: [Mistake; 3] = [
        (format!("the sign of `{other}` or of `{angle}` turned"), Box::new(|own: &Place| [own[0], -own[1]])),
        (format!("the sign of `{one}` turned"), Box::new(|own: &Place| [-own[0], own[1]])),
        (format!("`{one}` and `{other}` exchanged"), Box::new(|own: &Place| [own[1], own[0]])),
    ];
    simple.into_iter().chain([times(0), times(1)]).collect()
}

/// What a column of numbers ranges over.
fn range(data: &Dataset, column: &Column) -> f64 {
    let numbers = data.numbers(&column.header.name).unwrap_or_default().iter();
    let [low, high] = numbers.fold([f64::MAX, f64::MIN], |[low, high], &own| [low.min(own), high.max(own)]);
    (high - low).max(0.0)
}

/// Whether values of a column differ by more than this.
fn varies(data: &Dataset, column: &Column, least: f64) -> bool {
    data.numbers(&column.header.name).is_some_and(|values| values.iter().any(|own| (own - values[0]).abs() > least))
}

/// Whether a rotary axis turns, which has an angle of its own.
fn turns(data: &Dataset, angle: &str) -> bool {
    let is_rotary = |column: &&Column| column.header.quantity == Quantity::Angle && column.header.name.len() == 1;
    angle.len() == 1 || data.columns.iter().filter(is_rotary).any(|column| varies(data, column, 1e-3 * PI))
}

/// A sentence on rows of one direction whose positions are in no plane: a circle may be tilted, and those of two circles are not one.
pub fn beside_any_plane(data: &Dataset, rows: &[usize], radius: f64) -> Option<String> {
    let columns = AXES.map(|name| data.column(name).filter(|column| column.header.quantity == Quantity::Length));
    let [Some(x), Some(y), Some(z)] = columns else { return None };
    let numbers = |column: &Column| data.numbers(&column.header.name);
    let (xs, ys, zs) = (numbers(x)?, numbers(y)?, numbers(z)?);
    let places: Vec<Vector3<f64>> = rows.iter().map(|&row| Vector3::new(xs[row], ys[row], zs[row])).collect();
    let off = from_a_plane(&places).filter(|off| *off > OFF * radius)?;
    let [x, y, z] = [x, y, z].map(|column| &column.header.header);
    Some(format!(
        "the positions `{x}`, `{y}` and `{z}` are {off:.3} mm beside any plane (root mean square): are all rows those of this circle?"
    ))
}

/// How far positions are from the plane that is nearest to them, mm (root mean square); none of few.
fn from_a_plane(places: &[Vector3<f64>]) -> Option<f64> {
    if places.len() < ROWS {
        return None;
    }
    let count = places.len() as f64;
    let centre = places.iter().sum::<Vector3<f64>>() / count;
    let spread: Matrix3<f64> = places.iter().map(|place| (place - centre) * (place - centre).transpose()).sum();
    let least = spread.symmetric_eigenvalues().min();
    Some((least.max(0.0) / count).sqrt()).filter(|off| off.is_finite())
}

/// The two linear axes that move; none where others do.
fn plane(data: &Dataset, radius: f64) -> Option<[&Column; 2]> {
    let column = |name: &str| data.column(name).filter(|column| column.header.quantity == Quantity::Length);
    // A radius that is far too large hides no axis that moves.
    let least =
        1e-3 * AXES.iter().filter_map(|name| column(name)).map(|own| range(data, own)).fold(0.0, f64::max).min(radius);
    let of = |name: &str| column(name).filter(|column| least > STILL && varies(data, column, least));
    match AXES.map(of) {
        [Some(x), Some(y), None] => Some([x, y]),
        [None, Some(y), Some(z)] => Some([y, z]),
        [Some(x), None, Some(z)] => Some([z, x]),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use abbe_numerics::Generator;
    use nalgebra::{Unit, UnitQuaternion};

    use super::*;

    const NAMES: [&str; 2] = ["X_mm", "Y_mm"];

    /// A random circle or arc of a bad machine: its angles, its positions and its radius.
    fn circle(seed: u64) -> (Vec<f64>, Vec<Place>, f64) {
        let mut generator = Generator::new(seed, 0);
        let mut part = move || 0.5 * (1.0 + (generator.normal() / 2.0).clamp(-1.0, 1.0));
        let (radius, centre) = (20.0 + 280.0 * part(), [400.0 * part() - 200.0, 400.0 * part() - 200.0]);
        let sense = if seed.is_multiple_of(2) { 1.0 } else { -1.0 };
        let sweep =
            sense * (if seed.is_multiple_of(3) { 100.0 + 120.0 * part() } else { 360.0 + 90.0 * part() }).to_radians();
        // Where the circle began, and angles that are told from another axis: that is no contradiction of this kind.
        let (from, beside) = (TAU * part(), if seed.is_multiple_of(5) { TAU * part() } else { 0.0 });
        let errors = [1e-3 * radius * part(), 1e-3 * radius * part(), 0.01 * part()];
        let rows = 40 + (seed as usize % 7) * 60;
        let angles: Vec<f64> = (0..rows).map(|row| from + sweep * row as f64 / (rows - 1) as f64).collect();
        let places = angles.iter().map(|angle| {
            let round = radius + errors[0] * (2.0 * angle).cos() + errors[1] * (3.0 * angle).sin();
            let at = angle + beside + errors[2] * angle.sin();
            [centre[0] + round * at.cos() + 0.02 * part(), centre[1] + round * at.sin()]
        });
        let places = places.collect();
        (angles, places, radius)
    }

    #[test]
    fn positions_at_their_angles_get_no_word() {
        for seed in 0..2_000 {
            let (angles, places, radius) = circle(seed);
            assert_eq!(sentence(NAMES, "angle", &angles, &places, radius), None, "{seed}");
        }
    }

    /// A circle may be tilted, and its axes are off a little; the rows of another plane are in none with those of this one.
    #[test]
    fn rows_of_two_planes_are_in_none() {
        let mut generator = Generator::new(7, 0);
        for seed in 0..2_000 {
            let (_, places, radius) = circle(seed);
            let tilt = UnitQuaternion::from_scaled_axis(Vector3::from([(); 3].map(|()| 0.4 * generator.normal())));
            let in_space = |[one, other]: Place, beside: f64| tilt * Vector3::new(one, other, beside);
            let good: Vec<_> = places.iter().map(|own| in_space(*own, 1e-3 * radius * generator.uniform())).collect();
            let off = from_a_plane(&good).unwrap();
            assert!(off < OFF * radius, "{seed}: {off} of {radius}");
            // A fifth of the rows is that of a circle in another plane through its centre.
            let count = good.len() as f64;
            let centre = good.iter().sum::<Vector3<f64>>() / count;
            let axis = tilt * Unit::new_normalize(Vector3::new(1.0, 0.0, 0.0));
            let turned = UnitQuaternion::from_axis_angle(&axis, std::f64::consts::FRAC_PI_2);
            let mixed: Vec<_> = good
                .iter()
                .enumerate()
                .map(|(row, place)| if row % 5 == 0 { centre + turned * (place - centre) } else { *place })
                .collect();
            let off = from_a_plane(&mixed).unwrap();
            assert!(off > OFF * radius, "{seed}: {off} of {radius}");
        }
        assert_eq!(from_a_plane(&[Vector3::zeros(); ROWS - 1]), None);
    }

    #[test]
    fn columns_that_are_wrong_are_named() {
        type Wrong = fn(&Place) -> Place;
        let wrong: [(&str, Wrong); 6] = [
            ("with the sign of `Y_mm`", |own| [own[0], -own[1]]),
            ("with the sign of `X_mm`", |own| [-own[0], own[1]]),
            ("with `X_mm` and `Y_mm` exchanged", |own| [own[1], own[0]]),
            ("with `X_mm` times", |own| [0.5 * own[0], own[1]]),
            ("with `Y_mm` times", |own| [own[0], 25.4 * own[1]]),
            ("and `radius_mm` is", |own| [own[0] / 25.4, own[1] / 25.4]),
        ];
        for seed in (1..500).filter(|seed| seed % 5 != 0) {
            let (angles, places, radius) = circle(seed);
            let is_arc = seed % 3 == 0;
            // Of an arc the range does not tell the factor of one column.
            for (words, change) in wrong.iter().filter(|(words, _)| !is_arc || !words.contains("times")) {
                let changed: Vec<Place> = places.iter().map(change).collect();
                let said = sentence(NAMES, "angle", &angles, &changed, radius).unwrap_or_default();
                assert!(said.contains(words), "{seed} {words}: {said}");
            }
            let said = sentence(NAMES, "angle", &angles, &places, radius / 1.5).unwrap_or_default();
            assert!(said.contains("and `radius_mm` is"), "{seed}: {said}");
        }
    }

    #[test]
    fn short_arcs_and_few_rows_say_nothing() {
        let angles: Vec<f64> = (0..50).map(|row| 0.02 * f64::from(row)).collect();
        let line: Vec<Place> = angles.iter().map(|angle| [100.0 * angle, 3.0]).collect();
        assert_eq!(sentence(NAMES, "angle", &angles, &line, 100.0), None);
        let few = [0.0, 2.0, 4.0];
        assert_eq!(sentence(NAMES, "angle", &few, &[[0.0; 2]; 3], 100.0), None);
        assert_eq!(sentence(NAMES, "angle", &[], &[], 100.0), None);
    }
}
