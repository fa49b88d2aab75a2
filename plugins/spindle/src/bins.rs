//! Sums of readings with harmonics of the angle, and values of harmonics, for many readings.
//!
//! A turn is cut into bins so narrow that within one of them a few powers of the angle from its centre say all about any harmonic. So
//! a reading costs as many sums as there are powers, however many harmonics there are.

use std::f64::consts::TAU;

use abbe_standards::spindle::Harmonics;

/// Powers of the angle from the centre of a bin, from 0.
const POWERS: usize = 10;

/// Most that the highest harmonic turns from the centre of a bin to its edge, rad: what lies beyond the last power is below 2e-15.
const REACH: f64 = 0.15;

/// A turn without the last bits of its digits, so that small whole multiples are exact, and what is cut off.
const TURN: f64 = 6.283_185_303_211_212;
const TURN_REST: f64 = 3.968_374_318_722_162e-9;

/// Beyond 2^51 and below 2^53, where numbers have no decimals: to add and subtract it rounds to a whole number.
const WHOLE: f64 = 6_755_399_441_055_744.0;

fn whole(value: f64) -> f64 {
    (value + WHOLE) - WHOLE
}

/// Bins of a turn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bins {
    count: usize,
    width: f64,
    by_width: f64,
}

impl Bins {
    /// As many as harmonics to this order need.
    pub fn new(highest: usize) -> Self {
        let count = (0.5 * TAU * highest.max(1) as f64 / REACH).ceil() as usize;
        Self { count, width: TAU / count as f64, by_width: count as f64 / TAU }
    }

    /// The bin of an angle, and the angle from its centre.
    fn place(&self, angle: f64) -> (usize, f64) {
        let turns = whole(angle / TAU);
        let rest = (angle - turns * TURN) - turns * TURN_REST;
        let nearest = whole(rest * self.by_width);
        let bin = if nearest < 0.0 { nearest + self.count as f64 } else { nearest };
        // Rounding may leave the half of a turn in a bin beyond the last one.
        ((bin as usize).min(self.count - 1), rest - self.centre(nearest))
    }

    fn centre(&self, nearest: f64) -> f64 {
        nearest * self.width
    }

    /// The angle of the centre of a bin.
    fn angle(&self, bin: usize) -> f64 {
        let bin = bin as f64;
        self.centre(if 2.0 * bin > self.count as f64 { bin - self.count as f64 } else { bin })
    }
}

fn powers(by: f64) -> [f64; POWERS] {
    let mut powers = [1.0; POWERS];
    for power in 1..POWERS {
        powers[power] = powers[power - 1] * by;
    }
    powers
}

/// The powers of an order over the factorials of their exponents.
fn over_factorials(order: usize) -> [f64; POWERS] {
    let mut terms = [1.0; POWERS];
    for power in 1..POWERS {
        terms[power] = terms[power - 1] * order as f64 / power as f64;
    }
    terms
}

/// Sums of several quantities over readings, by bins and powers.
#[derive(Debug, Clone)]
pub struct Moments {
    bins: Bins,
    quantities: usize,
    sums: Vec<[f64; POWERS]>,
}

impl Moments {
    /// Without readings; enough for harmonics up to this order.
    pub fn new(highest: usize, quantities: usize) -> Self {
        let bins = Bins::new(highest);
        Self { bins, quantities, sums: vec![[0.0; POWERS]; bins.count * quantities] }
    }

    /// Adds the quantities of a reading at an angle.
    pub fn push(&mut self, angle: f64, quantities: &[f64]) {
        let (bin, by) = self.bins.place(angle);
        let powers = powers(by);
        let sums = &mut self.sums[bin * self.quantities..][..self.quantities];
        for (sums, quantity) in sums.iter_mut().zip(quantities) {
            sums.iter_mut().zip(&powers).for_each(|(sum, power)| *sum += quantity * power);
        }
    }

    /// Sums of a quantity times the cosine and the sine of whole multiples of the angle, up to this order.
    pub fn with_harmonics(&self, quantity: usize, highest: usize) -> Harmonics {
        let mut found = Harmonics::zero(highest);
        let terms: Vec<[f64; POWERS]> = (0..=highest).map(over_factorials).collect();
        for (bin, sums) in self.sums.chunks_exact(self.quantities).enumerate() {
            let sums = &sums[quantity];
            let (sin, cos) = self.bins.angle(bin).sin_cos();
            let (mut c, mut s) = (1.0, 0.0);
            for (order, terms) in terms.iter().enumerate() {
                // Real and imaginary part of the sum over exp(i order by).
                let part = |power: usize| terms[power] * sums[power];
                let quarter = |first: usize| (first..POWERS).step_by(4).map(part).sum::<f64>();
                let (real, imaginary) = (quarter(0) - quarter(2), quarter(1) - quarter(3));
                found.cos[order] += c * real - s * imaginary;
                found.sin[order] += s * real + c * imaginary;
                (c, s) = (c * cos - s * sin, s * cos + c * sin);
            }
        }
        found.sin[0] = 0.0;
        found
    }
}

/// Most functions of a table.
pub const FUNCTIONS: usize = 4;

/// Values of some sums of harmonics, at many angles.
#[derive(Debug, Clone)]
pub struct Table {
    bins: Bins,
    /// By bins, powers and functions.
    coefficients: Vec<[[f64; FUNCTIONS]; POWERS]>,
}

impl Table {
    /// Of these functions, [`FUNCTIONS`] at most.
    pub fn new(functions: &[Harmonics]) -> Self {
        let bins = Bins::new(functions.iter().map(Harmonics::highest).max().unwrap_or(0));
        let mut coefficients = vec![[[0.0; FUNCTIONS]; POWERS]; bins.count];
        let terms: Vec<[f64; POWERS]> =
            (0..=functions.iter().map(Harmonics::highest).max().unwrap_or(0)).map(over_factorials).collect();
        for (bin, own) in coefficients.iter_mut().enumerate() {
            let (sin, cos) = bins.angle(bin).sin_cos();
            let (mut c, mut s) = (1.0, 0.0);
            for (order, terms) in terms.iter().enumerate() {
                for (place, function) in functions.iter().enumerate().filter(|(_, own)| order <= own.highest()) {
                    let (by_cos, by_sin) = (function.cos[order], function.sin[order]);
                    let (value, slope) = (by_cos * c + by_sin * s, by_sin * c - by_cos * s);
                    let derivatives = [value, slope, -value, -slope];
                    for power in 0..POWERS {
                        own[power][place] += terms[power] * derivatives[power % 4];
                    }
                }
                (c, s) = (c * cos - s * sin, s * cos + c * sin);
            }
        }
        Self { bins, coefficients }
    }

    /// The values of all functions at an angle; zero beyond the last one.
    pub fn at(&self, angle: f64) -> [f64; FUNCTIONS] {
        let (bin, by) = self.bins.place(angle);
        let mut values = [0.0; FUNCTIONS];
        for coefficients in self.coefficients[bin].iter().rev() {
            values.iter_mut().zip(coefficients).for_each(|(value, own)| *value = *value * by + own);
        }
        values
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

    fn function(highest: usize, next: &mut dyn FnMut() -> f64) -> Harmonics {
        let mut function = Harmonics::zero(highest);
        function.cos.iter_mut().for_each(|value| *value = next());
        function.sin.iter_mut().skip(1).for_each(|value| *value = next());
        function
    }

    #[test]
    fn a_turn_has_no_digits_that_multiples_lose() {
        assert_eq!(TURN.to_bits() & 0x3ff_ffff, 0);
        assert!((TURN + TURN_REST - TAU).abs() < 1e-15 && TURN_REST.abs() < 1e-7);
    }

    #[test]
    fn tables_are_the_functions() {
        let mut next = random(7);
        for highest in [0, 1, 2, 24, 100, 500] {
            let functions: Vec<Harmonics> = (0..FUNCTIONS).map(|_| function(highest, &mut next)).collect();
            let table = Table::new(&functions);
            for far in [1.0, 10.0, 1e4] {
                for _ in 0..200 {
                    let angle = far * next();
                    for (value, function) in table.at(angle).iter().zip(&functions) {
                        let allowed = 1e-14 * (1.0 + highest as f64) * (1.0 + 0.1 * highest as f64)
                            + 1e-16 * far * highest as f64 * highest as f64;
                        assert!((value - function.at(angle)).abs() < allowed, "{highest} {angle}");
                    }
                }
            }
            // Edges of the turn.
            for angle in [0.5 * TAU, -0.5 * TAU, TAU, 1e5 * TAU, 0.5 * TAU - 1e-15, 1.5 * TAU] {
                let allowed = 1e-12 + 1e-15 * angle.abs() * (highest * highest) as f64;
                assert!((table.at(angle)[0] - functions[0].at(angle)).abs() < allowed, "{highest} {angle}");
            }
        }
    }

    #[test]
    fn moments_give_the_sums() {
        let mut next = random(9);
        for highest in [1, 5, 48, 200] {
            let mut moments = Moments::new(highest, 2);
            let mut expected = [Harmonics::zero(highest), Harmonics::zero(highest)];
            for row in 0..300 {
                let (angle, reading) = (f64::from(row) * 0.31 + 0.1 * next(), 1.0 + next());
                moments.push(angle, &[1.0, reading]);
                for (expected, quantity) in expected.iter_mut().zip([1.0, reading]) {
                    for order in 0..=highest {
                        let (sin, cos) = (order as f64 * angle).sin_cos();
                        expected.cos[order] += quantity * cos;
                        expected.sin[order] += quantity * sin;
                    }
                }
            }
            for (quantity, expected) in expected.iter().enumerate() {
                let found = moments.with_harmonics(quantity, highest).combined(1.0, expected, -1.0);
                let worst = found.cos.iter().chain(&found.sin).fold(0.0_f64, |worst, value| worst.max(value.abs()));
                assert!(worst < 1e-12 * highest as f64, "{highest}: {worst:e}");
            }
        }
    }
}
