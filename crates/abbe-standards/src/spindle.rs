//! Error motions of a spindle in the manner of ISO 230-7.
//!
//! The text of the standard was not at hand. What could not be checked against it is an argument here, so that whoever uses a figure
//! can say it: the number of sectors, the [`Centre`], how the fundamental axial motion is told.
//!
//! Angles in rad, as the encoder counts them. Lengths in any unit.

use std::f64::consts::TAU;

/// A sum of cosines and sines of whole multiples of an angle; `cos[0]` is the constant, `sin[0]` has no meaning and is zero.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Harmonics {
    /// Coefficients of the cosines, from order 0.
    pub cos: Vec<f64>,
    /// Coefficients of the sines, from order 0.
    pub sin: Vec<f64>,
}

impl Harmonics {
    /// All zero up to this order.
    pub fn zero(highest: usize) -> Self {
        Self { cos: vec![0.0; highest + 1], sin: vec![0.0; highest + 1] }
    }

    /// The highest order.
    pub fn highest(&self) -> usize {
        self.cos.len().saturating_sub(1)
    }

    /// Its value at an angle.
    pub fn at(&self, angle: f64) -> f64 {
        let orders = self.cos.iter().zip(&self.sin).enumerate();
        orders.map(|(order, (cos, sin))| (order as f64 * angle).cos() * cos + (order as f64 * angle).sin() * sin).sum()
    }

    /// The same without one order.
    pub fn without(mut self, order: usize) -> Self {
        if order < self.cos.len() {
            (self.cos[order], self.sin[order]) = (0.0, 0.0);
        }
        self
    }

    /// A sum of two, each times a factor.
    pub fn combined(&self, factor: f64, other: &Self, other_factor: f64) -> Self {
        let sum = |one: &[f64], two: &[f64]| {
            let part = |list: &[f64], order: usize| list.get(order).copied().unwrap_or(0.0);
            (0..one.len().max(two.len())).map(|k| factor * part(one, k) + other_factor * part(two, k)).collect()
        };
        Self { cos: sum(&self.cos, &other.cos), sin: sum(&self.sin, &other.sin) }
    }

    /// Amplitude of an order.
    pub fn amplitude(&self, order: usize) -> f64 {
        match (self.cos.get(order), self.sin.get(order)) {
            (Some(cos), Some(sin)) => cos.hypot(*sin),
            _ => 0.0,
        }
    }

    /// The product with the cosine of the angle (`quarter` 0), or with its sine (1).
    fn times(&self, quarter: usize) -> Self {
        let mut product = Self::zero(self.highest() + 1);
        let mut add = |order: isize, cos: f64, sin: f64| {
            // cos(-k a) = cos(k a), sin(-k a) = -sin(k a).
            let place = order.unsigned_abs();
            product.cos[place] += cos;
            product.sin[place] += if order < 0 { -sin } else { sin };
        };
        for (order, (cos, sin)) in self.cos.iter().zip(&self.sin).enumerate() {
            let (above, below) = (order as isize + 1, order as isize - 1);
            let (cos, sin) = (0.5 * cos, 0.5 * sin);
            match quarter {
                0 => {
                    add(above, cos, sin);
                    add(below, cos, sin);
                }
                _ => {
                    // cos ka sin a = (sin (k+1)a - sin (k-1)a)/2, sin ka sin a = (cos (k-1)a - cos (k+1)a)/2.
                    add(above, -sin, cos);
                    add(below, sin, -cos);
                }
            }
        }
        product.sin[0] = 0.0;
        product
    }
}

/// What goes round with the spindle and what goes round against it in the fundamental of two directions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fundamental {
    /// Eccentricity of the artefact in both directions at angle 0: the coefficient of exp(i angle) in x + i y.
    pub eccentricity: [f64; 2],
    /// Coefficient of exp(-i angle), its imaginary part with the other sign: an error motion. `[cos, sin]` in the reading along x.
    pub backward: [f64; 2],
}

impl Fundamental {
    /// Of motions along x and along y, a quarter of a turn further on.
    pub fn of(x: &Harmonics, y: &Harmonics) -> Self {
        let one =
            |motion: &Harmonics| (motion.cos.get(1).copied().unwrap_or(0.0), motion.sin.get(1).copied().unwrap_or(0.0));
        let ((x_cos, x_sin), (y_cos, y_sin)) = (one(x), one(y));
        Self {
            eccentricity: [0.5 * (x_cos + y_sin), 0.5 * (y_cos - x_sin)],
            backward: [0.5 * (x_cos - y_sin), 0.5 * (y_cos + x_sin)],
        }
    }

    /// The fundamentals along x and y: `[cos, sin]` of both.
    pub fn along(&self) -> [[f64; 2]; 2] {
        let ([x, y], [cos, sin]) = (self.eccentricity, self.backward);
        [[x + cos, sin - y], [y + sin, x - cos]]
    }
}

/// The motion along a direction that turns with the spindle and points along x at angle 0: `x cos + y sin`.
///
/// The eccentricity becomes a constant, constants become a fundamental, the backward fundamental an ellipse (order 2).
pub fn rotating(x: &Harmonics, y: &Harmonics) -> Harmonics {
    x.times(0).combined(1.0, &y.times(1), 1.0)
}

/// What an error motion is counted from in its polar plot, to first order in the motion over the radius of the plot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Centre {
    /// Least squares circle: mean and fundamental are taken off.
    LeastSquares,
    /// The circles of the smallest zone (minimum radial separation).
    MinimumZone,
    /// The centre of the polar chart: nothing but the mean is taken off.
    PolarChart,
}

/// A range: largest less smallest, as a sum of values of the motion at some angles, so that its uncertainty can be propagated.
#[derive(Debug, Clone, PartialEq)]
pub struct Range {
    /// The range.
    pub value: f64,
    /// What was taken off.
    pub centre: Centre,
    /// Angles with their weights. For [`Centre::LeastSquares`] the motion counts without its fundamental.
    pub active: Vec<(f64, f64)>,
}

impl Range {
    /// The range of a motion over as many angles of a turn.
    pub fn of(motion: &Harmonics, angles: usize, centre: Centre) -> Self {
        let motion = if centre == Centre::LeastSquares { motion.clone().without(1) } else { motion.clone() };
        let place = |index: usize| index as f64 * TAU / angles as f64;
        let values: Vec<f64> = (0..angles).map(|index| motion.at(place(index))).collect();
        if centre == Centre::MinimumZone {
            let (value, active) = smallest_zone(&values);
            let active = active.into_iter().map(|(index, weight)| (place(index), weight)).collect();
            return Self { value, centre, active };
        }
        let (most, least) = extremes(&values);
        Self { value: values[most] - values[least], centre, active: vec![(place(most), 1.0), (place(least), -1.0)] }
    }

    /// How the range changes with a change of the motion: what this range is of the change.
    pub fn change(&self, by: &Harmonics) -> f64 {
        let by = if self.centre == Centre::LeastSquares { by.clone().without(1) } else { by.clone() };
        self.active.iter().map(|(angle, weight)| weight * by.at(*angle)).sum()
    }
}

/// Places of the largest and of the smallest value.
fn extremes(values: &[f64]) -> (usize, usize) {
    let better = |sign: f64| {
        let wins = |best: usize, place: usize| if sign * values[place] > sign * values[best] { place } else { best };
        (0..values.len()).reduce(wins).unwrap_or(0)
    };
    (better(1.0), better(-1.0))
}

/// The smallest zone around values at equal steps of a turn, a constant and a fundamental taken off: its width, and it as a sum of
/// values. Exchange of single points of the reference (Stiefel 1959); constant, cosine and sine have the property of Haar.
fn smallest_zone(values: &[f64]) -> (f64, Vec<(usize, f64)>) {
    let count = values.len();
    let place = |index: usize| index as f64 * TAU / count as f64;
    let mut reference: Vec<usize> = (0..4).map(|part| part * count / 4).collect();
    let mut found = (0.0, Vec::new());
    for _ in 0..10 * count {
        let weights = alternating([0, 1, 2, 3].map(|own| place(reference[own])));
        let level: f64 = reference.iter().zip(weights).map(|(own, weight)| weight * values[*own]).sum();
        // Twice the level is the width; weights that make it positive.
        let active = reference.iter().zip(weights).map(|(own, weight)| (*own, 2.0 * weight * level.signum()));
        found = (2.0 * level.abs(), active.collect());
        let Some(curve) = through(&reference, values, level, &place) else { return found };
        let rest = |index: usize| {
            let angle = place(index);
            values[index] - curve[0] - curve[1] * angle.cos() - curve[2] * angle.sin()
        };
        let wins = |best: usize, index: usize| if rest(index).abs() > rest(best).abs() { index } else { best };
        let worst = (0..count).reduce(wins).unwrap_or(0);
        if rest(worst).abs() <= level.abs() * (1.0 + 1e-12) + f64::MIN_POSITIVE || reference.contains(&worst) {
            return found;
        }
        exchange(&mut reference, worst, &rest);
    }
    found
}

/// Weights of four values that no constant, cosine and sine changes; their sizes add up to 1 and their signs alternate.
fn alternating(angles: [f64; 4]) -> [f64; 4] {
    // The determinant of (1, cos, sin) of the three others.
    let minor = |left: usize| {
        let rest: Vec<f64> = (0..4).filter(|own| *own != left).map(|own| angles[own]).collect();
        let half = |one: usize, two: usize| (0.5 * (rest[two] - rest[one])).sin();
        4.0 * half(0, 1) * half(1, 2) * half(0, 2)
    };
    let minors = [0, 1, 2, 3].map(minor);
    let sum: f64 = minors.iter().map(|minor| minor.abs()).sum();
    [0, 1, 2, 3].map(|own| if own % 2 == 0 { minors[own] / sum } else { -minors[own] / sum })
}

/// Constant, cosine and sine that leave plus and minus the level at the first three places of the reference.
fn through(reference: &[usize], values: &[f64], level: f64, place: &dyn Fn(usize) -> f64) -> Option<[f64; 3]> {
    let [a, b, c] = [0, 1, 2].map(|own| place(reference[own]));
    let target = [0, 1, 2].map(|own| values[reference[own]] - if own % 2 == 0 { level } else { -level });
    let row = |angle: f64| [1.0, angle.cos(), angle.sin()];
    let matrix = [row(a), row(b), row(c)];
    let determinant = |m: &[[f64; 3]; 3]| {
        m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
            + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
    };
    let whole = determinant(&matrix);
    let solved = [0, 1, 2].map(|column| {
        let mut with = matrix;
        with.iter_mut().zip(target).for_each(|(row, target)| row[column] = target);
        determinant(&with) / whole
    });
    solved.iter().all(|value| value.is_finite()).then_some(solved)
}

/// Takes a place into the reference for a neighbour whose rest has the same sign.
fn exchange(reference: &mut Vec<usize>, worst: usize, rest: &dyn Fn(usize) -> f64) {
    let same = |place: usize| (rest(place) > 0.0) == (rest(worst) > 0.0);
    let above = reference.iter().position(|own| *own > worst);
    match above {
        Some(0) if same(reference[0]) => reference[0] = worst,
        Some(0) => {
            reference.pop();
            reference.insert(0, worst);
        }
        Some(next) if same(reference[next]) => reference[next] = worst,
        Some(next) => reference[next - 1] = worst,
        None if same(reference[3]) => reference[3] = worst,
        None => {
            reference.remove(0);
            reference.push(worst);
        }
    }
}

/// Largest and smallest reading within each sector of a turn. Sectors are centred on multiples of their width.
#[derive(Debug, Clone, PartialEq)]
pub struct Sectors(Vec<Option<[f64; 2]>>, Vec<usize>);

impl Sectors {
    /// Without readings.
    pub fn new(count: usize) -> Self {
        Self(vec![None; count], vec![0; count])
    }

    /// Adds a reading at an angle.
    pub fn push(&mut self, angle: f64, reading: f64) {
        self.push_in(self.sector(angle), reading);
    }

    /// The sector of an angle.
    pub fn sector(&self, angle: f64) -> usize {
        let count = self.0.len() as f64;
        let nearest = (angle / TAU * count + 0.5).floor();
        // Exact for whole numbers, and many times as fast as their remainder.
        (nearest - (nearest / count).floor() * count) as usize
    }

    /// Adds a reading to a sector that there is.
    pub fn push_in(&mut self, sector: usize, reading: f64) {
        let [low, high] = self.0[sector].unwrap_or([reading; 2]);
        self.0[sector] = Some([low.min(reading), high.max(reading)]);
        self.1[sector] += 1;
    }

    /// Smallest and largest reading of a sector.
    pub fn extremes(&self, sector: usize) -> Option<[f64; 2]> {
        self.0.get(sector).copied().flatten()
    }

    /// The fewest readings that a sector has, and which one it is.
    pub fn fewest(&self) -> Option<(usize, usize)> {
        self.1.iter().copied().enumerate().min_by_key(|(_, readings)| *readings)
    }

    /// The asynchronous error motion value: the largest range of a sector.
    pub fn largest(&self) -> Option<f64> {
        self.0.iter().flatten().map(|[low, high]| high - low).reduce(f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers from -1 to 1 without a law.
    fn random(seed: u64) -> impl FnMut() -> f64 {
        let mut state = seed;
        move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f64 / f64::from(1 << 23) - 1.0
        }
    }

    fn motion(highest: usize, next: &mut dyn FnMut() -> f64) -> Harmonics {
        let mut motion = Harmonics::zero(highest);
        motion.cos.iter_mut().for_each(|value| *value = next());
        motion.sin.iter_mut().skip(1).for_each(|value| *value = next());
        motion
    }

    #[test]
    fn a_turning_direction_sees_both_motions() {
        let mut next = random(1);
        for _ in 0..50 {
            let (x, y) = (motion(7, &mut next), motion(7, &mut next));
            let turning = rotating(&x, &y);
            for _ in 0..20 {
                let angle = 10.0 * next();
                let expected = x.at(angle) * angle.cos() + y.at(angle) * angle.sin();
                assert!((turning.at(angle) - expected).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn eccentricity_is_a_constant_for_a_turning_direction_and_the_backward_part_an_ellipse() {
        let of = |fundamental: Fundamental| {
            let [x, y] = fundamental.along().map(|[cos, sin]| Harmonics { cos: vec![0.0, cos], sin: vec![0.0, sin] });
            let back = Fundamental::of(&x, &y);
            for (one, other) in [(back.eccentricity, fundamental.eccentricity), (back.backward, fundamental.backward)] {
                assert!((one[0] - other[0]).hypot(one[1] - other[1]) < 1e-15);
            }
            rotating(&x, &y)
        };
        let eccentric = of(Fundamental { eccentricity: [3.0, -4.0], backward: [0.0, 0.0] });
        assert_eq!((eccentric.cos[0], eccentric.amplitude(1), eccentric.amplitude(2)), (3.0, 0.0, 0.0));
        let backward = of(Fundamental { eccentricity: [0.0, 0.0], backward: [0.3, 0.4] });
        assert!((backward.amplitude(2) - 0.5).abs() < 1e-15 && backward.cos[0].abs() + backward.amplitude(1) < 1e-15);
        // Twice the amplitude of an ellipse is its range.
        assert!((Range::of(&backward, 720, Centre::LeastSquares).value - 1.0).abs() < 1e-4);
    }

    /// The zone about the best of many centres.
    fn by_trying(values: &[f64]) -> f64 {
        let zone = |x: f64, y: f64| {
            let rest = values.iter().enumerate().map(|(index, value)| {
                let angle = index as f64 * TAU / values.len() as f64;
                value - x * angle.cos() - y * angle.sin()
            });
            let (most, least) = rest.fold((f64::MIN, f64::MAX), |(m, l), value| (m.max(value), l.min(value)));
            most - least
        };
        let (mut best, mut step) = ([0.0, 0.0, zone(0.0, 0.0)], 1.0);
        while step > 1e-7 {
            let around = (0..16).map(|part| {
                let angle = TAU * f64::from(part) / 16.0;
                let (x, y) = (best[0] + step * angle.cos(), best[1] + step * angle.sin());
                [x, y, zone(x, y)]
            });
            let next = around.reduce(|a, b| if b[2] < a[2] { b } else { a }).expect("sixteen");
            if next[2] < best[2] { best = next } else { step *= 0.7 }
        }
        best[2]
    }

    #[test]
    fn the_smallest_zone_is_no_larger_than_any_that_is_tried() {
        let mut next = random(2);
        for highest in [2, 3, 5, 9] {
            for _ in 0..15 {
                let motion = motion(highest, &mut next);
                let values: Vec<f64> = (0..180).map(|index| motion.at(f64::from(index) * TAU / 180.0)).collect();
                let [zone, circle, chart] = [Centre::MinimumZone, Centre::LeastSquares, Centre::PolarChart]
                    .map(|centre| Range::of(&motion, 180, centre));
                let tried = by_trying(&values);
                assert!(zone.value <= tried * (1.0 + 1e-9), "{} {tried}", zone.value);
                assert!(zone.value >= tried * (1.0 - 1e-3), "{} {tried}", zone.value);
                assert!(zone.value <= circle.value * (1.0 + 1e-12) && zone.value <= chart.value * (1.0 + 1e-12));
            }
        }
    }

    #[test]
    fn a_range_is_the_sum_that_it_says_and_changes_as_it_says() {
        let mut next = random(3);
        for centre in [Centre::MinimumZone, Centre::LeastSquares, Centre::PolarChart] {
            for _ in 0..20 {
                let (one, by) = (motion(6, &mut next), motion(6, &mut next));
                let range = Range::of(&one, 360, centre);
                assert!((range.change(&one) - range.value).abs() < 1e-11, "{centre:?}");
                let step = 1e-7;
                let further = Range::of(&one.combined(1.0, &by, step), 360, centre).value;
                let before = Range::of(&one.combined(1.0, &by, -step), 360, centre).value;
                let slope = (further - before) / (2.0 * step);
                assert!((slope - range.change(&by)).abs() < 1e-5 * (1.0 + slope.abs()), "{centre:?}");
            }
        }
    }

    #[test]
    fn sectors_stand_on_multiples_of_their_width() {
        let mut sectors = Sectors::new(4);
        assert_eq!((sectors.largest(), sectors.fewest()), (None, Some((0, 0))));
        for (angle, reading) in [(-0.7, 1.0), (0.7, 4.0), (0.9, 9.0), (TAU - 0.8, 2.0), (TAU * 5.0, 1.5)] {
            sectors.push(angle, reading);
        }
        assert_eq!(sectors.largest(), Some(3.0));
        assert_eq!((sectors.extremes(0), sectors.extremes(1)), (Some([1.0, 4.0]), Some([9.0, 9.0])));
        assert_eq!((sectors.extremes(2), sectors.extremes(3)), (None, Some([2.0, 2.0])));
        assert_eq!(sectors.fewest(), Some((2, 0)));
    }
}
