//! Points that were found, all of them, where a mistake in a column would put them: in another unit, mirrored, exchanged.

/// How many times farther points have to be from their places than they are with a mistake, or than they scatter.
pub const FAR: f64 = 10.0;

/// Smallest spread that counts, mm: points of parts are hardly ever nearer to each other than ten times of it.
pub const LEAST_SPREAD: f64 = 0.02;

/// Fewest points that tell.
const FEWEST: usize = 6;

/// Part of the points that a mistake has to explain.
const EXPLAINED: f64 = 0.8;

/// Names of coordinates.
const AXES: [&str; 3] = ["x", "y", "z"];

/// How many times too large lengths are in another unit: inches and metres for millimetres, and the other way round.
const UNITS: [f64; 4] = [25.4, 1.0 / 25.4, 1e3, 1e-3];

/// The number in the middle; zero if there is none.
pub fn median(mut numbers: Vec<f64>) -> f64 {
    numbers.sort_by(f64::total_cmp);
    numbers.get(numbers.len() / 2).copied().unwrap_or_default()
}

/// What is left of differences when their median, axis by axis, is taken off: that, and the median distance from it, mm.
pub fn shift_and_spread(differences: &[[f64; 3]]) -> ([f64; 3], f64) {
    let (shift, distances) = shift_and_distances(differences);
    (shift, median(distances))
}

/// The median of differences, axis by axis, and the distances from it in their order of size, mm.
fn shift_and_distances(differences: &[[f64; 3]]) -> ([f64; 3], Vec<f64>) {
    let shift = [0, 1, 2].map(|axis| median(differences.iter().map(|by| by[axis]).collect()));
    let distance = |by: &[f64; 3]| length([0, 1, 2].map(|axis| by[axis] - shift[axis]));
    let mut distances: Vec<f64> = differences.iter().map(distance).collect();
    distances.sort_by(f64::total_cmp);
    (shift, distances)
}

/// The length of a vector.
pub fn length(by: [f64; 3]) -> f64 {
    by.iter().fold(0.0, |all: f64, part| all.hypot(*part))
}

/// A mistake with which points are where they should be, one by one with `expected`.
#[derive(Debug, Clone, PartialEq)]
pub struct Mistaken {
    /// What the points are, as a whole: `mirrored along x`.
    pub what: String,
    /// How far they are from their places, wherever the part lies, mm; with the mistake, and as they are.
    pub with: f64,
    pub without: f64,
}

/// What a mistake makes of the place of a point.
type Change = Box<dyn Fn([f64; 3]) -> [f64; 3]>;

/// A mistake: what it is, what it makes of a place, and whether a line of points tells it.
struct Trial {
    what: String,
    change: Change,
    is_told_by_a_line: bool,
}

fn trials() -> Vec<Trial> {
    let scaled = |what: String, factors: [f64; 3]| Trial {
        what,
        change: Box::new(move |at| [0, 1, 2].map(|axis| factors[axis] * at[axis])),
        is_told_by_a_line: true,
    };
    let mut all = Vec::new();
    for factor in UNITS {
        let times =
            if factor > 1.0 { format!("{factor} times as far") } else { format!("1/{:.4} as far", 1.0 / factor) };
        let times = times.replace(".0000", "").replace("25.4000", "25.4");
        all.push(scaled(format!("{times} from each other, as in another unit"), [factor; 3]));
        for (axis, name) in AXES.iter().enumerate() {
            let factors = [0, 1, 2].map(|other| if other == axis { factor } else { 1.0 });
            all.push(scaled(format!("{times} from each other along {name}, as in another unit"), factors));
        }
    }
    for (axis, name) in AXES.iter().enumerate() {
        let factors = [0, 1, 2].map(|other| if other == axis { -1.0 } else { 1.0 });
        all.push(Trial { is_told_by_a_line: false, ..scaled(format!("mirrored along {name}"), factors) });
    }
    for (one, other) in [(0, 1), (1, 2), (0, 2)] {
        let change = move |mut at: [f64; 3]| {
            at.swap(one, other);
            at
        };
        let what = format!("with {} and {} exchanged", AXES[one], AXES[other]);
        all.push(Trial { what, change: Box::new(change), is_told_by_a_line: false });
    }
    all
}

/// The mistake that explains where points were found, if they are far from where they are expected and near with it. The part may lie
/// beside its place, or turned: no mistake explains that.
pub fn mistaken(expected: &[[f64; 3]], found: &[[f64; 3]]) -> Option<Mistaken> {
    let spread = |places: &[[f64; 3]], part: f64| {
        let differences = found.iter().zip(places).map(|(found, at)| [0, 1, 2].map(|axis| found[axis] - at[axis]));
        let distances = shift_and_distances(&differences.collect::<Vec<_>>()).1;
        distances.get((part * distances.len() as f64) as usize).copied().unwrap_or_default()
    };
    let without = spread(expected, 0.5);
    if expected.len() < FEWEST || without < FAR * LEAST_SPREAD {
        return None;
    }
    let explains = |trial: Trial| {
        let places: Vec<[f64; 3]> = expected.iter().map(|at| (trial.change)(*at)).collect();
        let (with, widths) = (spread(&places, EXPLAINED), widths(&places));
        // Points that lie in a line are mirrored by a turn of the part, and points at one place are where anything would put them.
        let width = if trial.is_told_by_a_line { widths[2] } else { widths[1] };
        let is_explained = FAR * with.max(LEAST_SPREAD) < without && FAR * with < width;
        is_explained.then_some(Mistaken { what: trial.what, with, without })
    };
    trials().into_iter().filter_map(explains).min_by(|one, other| one.with.total_cmp(&other.with))
}

/// How far places are from their middle along the three axes, the smallest first.
fn widths(places: &[[f64; 3]]) -> [f64; 3] {
    let of = |axis: usize| {
        let middle = median(places.iter().map(|at| at[axis]).collect());
        median(places.iter().map(|at| (at[axis] - middle).abs()).collect())
    };
    let mut widths = [0, 1, 2].map(of);
    widths.sort_by(f64::total_cmp);
    widths
}

#[cfg(test)]
mod tests {
    use abbe_numerics::Generator;

    use super::*;

    /// Points of a part: on a grid or anywhere, on a line, in a plane or in space, and where they were found, with errors of form.
    fn part(seed: u64) -> (Vec<[f64; 3]>, Vec<[f64; 3]>, Generator) {
        let mut random = Generator::new(seed, 0);
        let count = 4 + seed as usize % 20;
        let dimensions = 1 + seed as usize % 3;
        let size = 10_f64.powf(1.5 + 0.5 * random.normal().clamp(-2.0, 2.0));
        let step = if seed % 4 < 2 { size / 3.0 } else { 1e-3 };
        let place = |random: &mut Generator| {
            let at = [0, 1, 2]
                .map(|axis| if axis < dimensions { (size * random.normal() / step).round() * step } else { 5.0 });
            [0, 1, 2].map(|axis| at[(axis + seed as usize) % 3])
        };
        let expected: Vec<[f64; 3]> = (0..count).map(|_| place(&mut random)).collect();
        let form = 10_f64.powf(-2.5 + random.normal().clamp(-2.0, 2.0));
        let found = expected.iter().map(|at| at.map(|value| value + form * random.normal())).collect();
        (expected, found, random)
    }

    /// Parts that lie somewhere, turned by any angle about any axis, warm, with holes that are off, a part of them by much.
    #[test]
    fn good_parts_get_no_word() {
        for seed in 0..30_000 {
            let (expected, mut found, mut random) = part(seed);
            let turn = [0.0, 1e-3, 0.1, 3.0][seed as usize % 4] * random.normal();
            let half = [std::f64::consts::FRAC_PI_2, std::f64::consts::PI][seed as usize / 8 % 2];
            let turn = if seed % 5 == 0 { half } else { turn };
            let axis = seed as usize / 4 % 3;
            let (one, other) = ((axis + 1) % 3, (axis + 2) % 3);
            let (shift, warm) = ([0, 1, 2].map(|_| 100.0 * random.normal()), 1.0 + 1e-3 * random.normal());
            for at in &mut found {
                let (x, y) = (at[one], at[other]);
                at[one] = turn.cos() * x - turn.sin() * y;
                at[other] = turn.sin() * x + turn.cos() * y;
                *at = [0, 1, 2].map(|axis| warm * at[axis] + shift[axis]);
            }
            let off = found.len() / 3;
            found.iter_mut().take(if seed % 3 == 0 { off } else { 0 }).for_each(|at| at[0] += 2.0 * random.normal());
            // A flat part that stands, or lies on its other side, is where a mistake would have it: that is asked.
            let [narrow, _, wide] = widths(&expected);
            let is_turned_in_its_plane = seed % 3 == 1 && (axis + seed as usize) % 3 == 2;
            let is_flat_and_turned_over = narrow < 0.05 * wide && turn.abs() > 0.3 && !is_turned_in_its_plane;
            if !is_flat_and_turned_over {
                assert_eq!(mistaken(&expected, &found), None, "{seed}");
            }
        }
    }

    #[test]
    fn mistakes_are_named() {
        type Wrong = fn([f64; 3]) -> [f64; 3];
        let wrong: [(&str, Wrong); 6] = [
            ("25.4 times as far from each other, as", |at| at.map(|value| 25.4 * value)),
            ("1/25.4 as far from each other, as", |at| at.map(|value| value / 25.4)),
            ("1000 times as far from each other along y", |[x, y, z]| [x, 1e3 * y, z]),
            ("1/1000 as far from each other, as", |at| at.map(|value| value / 1e3)),
            ("mirrored along x", |[x, y, z]| [-x, y, z]),
            ("with y and z exchanged", |[x, y, z]| [x, z, y]),
        ];
        let (mut told, mut all) = (0, 0);
        for seed in 0..2_000 {
            let (expected, found, _) = part(seed);
            for (words, change) in wrong {
                let changed: Vec<[f64; 3]> = found.iter().map(|at| change(*at).map(|value| value + 30.0)).collect();
                let said = mistaken(&expected, &changed);
                // A point may be mirrored by two planes alike.
                let is_named = said.as_ref().is_none_or(|said| said.what.contains(words.split(' ').next().unwrap()));
                assert!(is_named, "{seed} {words}: {said:?}");
                all += 1;
                told += usize::from(said.is_some());
            }
        }
        assert!(2 * told > all, "{told} of {all}");
    }
}
