//! Common part of families that are declared over the travel of an axis: its ends, and trends that are removed over it.

use abbe_core::{PathItem, Quantity, SettingsError};

use super::{Argument, Functions, Subject, Term, suits};

/// Settings of a line on the travel of the axis.
pub(crate) struct Travel {
    pub range_mm: Option<[f64; 2]>,
    pub range_deg: Option<[f64; 2]>,
    pub without_line: bool,
    pub without_once_per_turn: bool,
}

impl Travel {
    pub fn check(&self) -> Result<(), SettingsError> {
        for (setting, range) in [("range_mm", self.range_mm), ("range_deg", self.range_deg)] {
            if let Some([from, to]) = range
                && !(from.is_finite() && to.is_finite() && from < to)
            {
                return Err(SettingsError::new(setting, "a range is two numbers, the smaller one first"));
            }
        }
        match (self.range_mm.is_some() && self.range_deg.is_some(), self.without_line && self.without_once_per_turn) {
            (true, _) => Err(SettingsError::new("range_deg", "there is `range_mm` already")),
            (_, true) => Err(SettingsError::new("without_once_per_turn", "there is `without_line` already")),
            _ => Ok(()),
        }
    }

    /// The range of the line, else that of the axis, mm or rad.
    pub fn range(&self, subject: &Subject<'_>) -> Result<Option<[f64; 2]>, SettingsError> {
        suits(("range", "range"), subject, self.range_mm.is_some(), self.range_deg.is_some())?;
        Ok(self.range_mm.or(self.range_deg.map(|range| range.map(f64::to_radians))).or(subject.range))
    }

    /// The range, which has to be known for `what`.
    pub fn required_range(&self, subject: &Subject<'_>, what: &str) -> Result<[f64; 2], SettingsError> {
        let setting = if subject.command == Quantity::Angle { "range_deg" } else { "range_mm" };
        let message = format!("{what} needs the travel: `{setting}` here or of the axis");
        self.range(subject)?.ok_or_else(|| SettingsError::new("", message))
    }

    /// The functions without the trend that the settings remove.
    pub fn without_trend(
        &self,
        functions: Box<dyn Functions>,
        subject: &Subject<'_>,
    ) -> Result<Box<dyn Functions>, SettingsError> {
        let (setting, trend, quantity) = match (self.without_line, self.without_once_per_turn) {
            (false, false) => return Ok(functions),
            (true, _) => ("without_line", Trend::Line, Quantity::Length),
            _ => ("without_once_per_turn", Trend::OncePerTurn, Quantity::Angle),
        };
        if subject.command != quantity {
            let axis = if quantity == Quantity::Length { "linear" } else { "rotary" };
            return Err(SettingsError::new(setting, format!("this is for errors of a {axis} axis")));
        }
        Ok(Box::new(WithoutTrend::new(functions, trend, self.required_range(subject, &format!("`{setting}`"))?)))
    }

    /// Fails if a function would be zero after the trend is removed.
    pub fn check_degrees(&self, setting: &str, degrees: &[u8]) -> Result<(), SettingsError> {
        match degrees.iter().position(|degree| *degree < 2) {
            Some(index) if self.without_line => {
                let message =
                    format!("degree {} is nothing but a line, which `without_line` takes off", degrees[index]);
                Err(SettingsError::new("", message).under([PathItem::Key(setting.to_owned()), PathItem::Index(index)]))
            }
            _ => Ok(()),
        }
    }
}

/// The trend that is removed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trend {
    /// The least-squares line.
    Line,
    /// The least-squares sine and cosine of the angle.
    OncePerTurn,
}

/// Functions without their own least-squares line, or once-per-turn part, over the travel (Soons 1993, eq. 3.4-3.10): for any
/// coefficients, the error has no such trend. The trend belongs to the location errors of the axis.
#[derive(Debug)]
pub struct WithoutTrend {
    functions: Box<dyn Functions>,
    trend: Trend,
    range: [f64; 2],
    /// The trend of each function: coefficients of both parts of the trend.
    parts: Vec<[f64; 2]>,
}

impl WithoutTrend {
    /// Takes a trend off functions of the command alone.
    pub fn new(functions: Box<dyn Functions>, trend: Trend, range: [f64; 2]) -> Self {
        let count = functions.terms().len();
        let mut without = Self { functions, trend, range, parts: vec![[0.0; 2]; count] };
        // Normal equations of both parts of the trend.
        let (mut normal, mut right) = ([[0.0; 2]; 2], vec![[0.0; 2]; count]);
        let mut values = vec![0.0; count];
        for (command, weight) in quadrature(range, without.functions.breaks()) {
            let trend = without.trend_at(command).0;
            without.functions.values(&[command], &mut values);
            for i in 0..2 {
                (0..2).for_each(|j| normal[i][j] += weight * trend[i] * trend[j]);
                right.iter_mut().zip(&values).for_each(|(right, value)| right[i] += weight * trend[i] * value);
            }
        }
        let [[a, b], [_, c]] = normal;
        for (part, [p, q]) in without.parts.iter_mut().zip(right) {
            *part = [(c * p - b * q) / (a * c - b * b), (a * q - b * p) / (a * c - b * b)];
        }
        without
    }

    /// Both parts of the trend at a command, and their slopes.
    fn trend_at(&self, command: f64) -> ([f64; 2], [f64; 2]) {
        match self.trend {
            Trend::Line => {
                // From the middle, in half widths: so both parts have the same size and are orthogonal.
                let (middle, half) = (0.5 * (self.range[0] + self.range[1]), 0.5 * (self.range[1] - self.range[0]));
                ([1.0, (command - middle) / half], [0.0, 1.0 / half])
            }
            Trend::OncePerTurn => {
                let (sin, cos) = command.sin_cos();
                ([cos, sin], [-sin, cos])
            }
        }
    }

    fn take_off(&self, trend: [f64; 2], out: &mut [f64]) {
        out.iter_mut().zip(&self.parts).for_each(|(out, part)| *out -= part[0] * trend[0] + part[1] * trend[1]);
    }
}

impl Functions for WithoutTrend {
    fn arguments(&self) -> Vec<Argument> {
        self.functions.arguments()
    }

    fn terms(&self) -> Vec<Term> {
        self.functions.terms()
    }

    fn values(&self, arguments: &[f64], out: &mut [f64]) {
        self.functions.values(arguments, out);
        self.take_off(self.trend_at(arguments[0]).0, out);
    }

    fn values_side_by_side(&self, places: usize, arguments: &[f64], room: &mut Vec<f64>, out: &mut [f64]) {
        self.functions.values_side_by_side(places, arguments, room, out);
        for (place, command) in arguments[..places].iter().enumerate() {
            let trend = self.trend_at(*command).0;
            for (function, part) in self.parts.iter().enumerate() {
                out[function * places + place] -= part[0] * trend[0] + part[1] * trend[1];
            }
        }
    }

    fn slopes(&self, by: usize, arguments: &[f64], out: &mut [f64]) {
        self.functions.slopes(by, arguments, out);
        self.take_off(self.trend_at(arguments[0]).1, out);
    }

    fn range(&self) -> Option<[f64; 2]> {
        Some(self.range)
    }

    fn breaks(&self) -> &[f64] {
        self.functions.breaks()
    }
}

/// Nodes of a rule; it is exact for polynomials up to degree `2 NODES - 1`.
const NODES: u8 = 12;

/// Number of parts of every piece, so that sine and cosine are integrated to rounding, too.
const PARTS: u8 = 8;

/// Nodes and weights for integrals over a range of functions that are smooth between `breaks`: the Gauss-Legendre rule in
/// every piece. For piecewise polynomials that is the closed form of Soons' integrals (1993, eq. 3.8), apart from rounding.
fn quadrature([from, to]: [f64; 2], breaks: &[f64]) -> Vec<(f64, f64)> {
    let inner = breaks.iter().copied().filter(|at| from < *at && *at < to);
    let ends: Vec<f64> = std::iter::once(from).chain(inner).chain([to]).collect();
    let rule = gauss_legendre();
    let mut all = Vec::new();
    for piece in ends.windows(2) {
        let half = 0.5 * (piece[1] - piece[0]) / f64::from(PARTS);
        for part in 0..PARTS {
            let middle = piece[0] + half * f64::from(2 * part + 1);
            all.extend(rule.iter().map(|(node, weight)| (middle + half * node, half * weight)));
        }
    }
    all
}

/// Nodes and weights on -1..1: the zeros of the Legendre polynomial by Newton's method.
fn gauss_legendre() -> Vec<(f64, f64)> {
    let count = f64::from(NODES);
    let node = |index: u8| {
        let mut x = (std::f64::consts::PI * (f64::from(index) + 0.75) / (count + 0.5)).cos();
        for _ in 0..20 {
            let (value, slope) = legendre(NODES, x);
            x -= value / slope;
        }
        let slope = legendre(NODES, x).1;
        (x, 2.0 / ((1.0 - x * x) * slope * slope))
    };
    (0..NODES).map(node).collect()
}

/// The Legendre polynomial of a degree and its slope, by Bonnet's recursion.
pub(crate) fn legendre(degree: u8, x: f64) -> (f64, f64) {
    let (mut before, mut current) = ((1.0, 0.0), (x, 1.0));
    if degree == 0 {
        return before;
    }
    for n in 1..degree {
        let n = f64::from(n);
        let value = ((2.0 * n + 1.0) * x * current.0 - n * before.0) / (n + 1.0);
        let slope = before.1 + (2.0 * n + 1.0) * current.0;
        (before, current) = (current, (value, slope));
    }
    current
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::families::testing::{names, side_by_side_is_each, slopes_agree, values};
    use crate::families::{OrdinaryPolynomial, PiecewisePolynomial};

    fn pieces(knots: &[f64], first: u8, range: [f64; 2]) -> Box<dyn Functions> {
        Box::new(PiecewisePolynomial::new(knots.to_vec(), first..=2, 1, Some(range)))
    }

    #[test]
    fn a_parabola_without_its_line_by_hand() {
        // q^2 over 0..6: its line is 6 q - 6, from the integrals of eq. 3.8.
        let without = WithoutTrend::new(Box::new(OrdinaryPolynomial { degrees: vec![2] }), Trend::Line, [0.0, 6.0]);
        for q in [0.0, 1.0, 4.5] {
            assert!((values(&without, &[q])[0] - (q * q - 6.0 * q + 6.0)).abs() < 1e-13);
        }
        assert_eq!(names(&without), ["[2]"]);
    }

    #[test]
    fn values_side_by_side_are_those_of_each_place() {
        let places: Vec<f64> = (0..8).map(|place| 0.9 * f64::from(place) - 3.0).collect();
        for trend in [Trend::Line, Trend::OncePerTurn] {
            side_by_side_is_each(&WithoutTrend::new(pieces(&[-1.0, 1.5], 1, [-3.0, 4.0]), trend, [-3.0, 4.0]), &places);
        }
    }

    #[test]
    fn the_angle_without_its_first_harmonic() {
        // On -pi..pi the angle itself is 2 sin q - sin 2q + ...
        let angle = Box::new(OrdinaryPolynomial { degrees: vec![1] });
        let without = WithoutTrend::new(angle, Trend::OncePerTurn, [-std::f64::consts::PI, std::f64::consts::PI]);
        assert!((values(&without, &[1.0])[0] - (1.0 - 2.0 * 1.0_f64.sin())).abs() < 1e-13);
    }

    #[test]
    fn the_line_of_a_straightness_is_that_of_its_terms() {
        // Straightness of a milling machine over 0..700 mm: constant and slope follow from the other three terms (they were found
        // independently from the integrals of eq. 3.8).
        let range = [0.0, 700.0];
        let without = WithoutTrend::new(pieces(&[350.0, 550.0], 2, range), Trend::Line, range);
        let coefficients = [-3.75411e-8, -7.35588e-8, 2.49098e-7];
        for q in [0.0, 123.0, 400.0, 700.0] {
            let found: f64 = values(&without, &[q]).iter().zip(coefficients).map(|(value, by)| value * by).sum();
            let beyond = |knot: f64| (q - knot).max(0.0).powi(2);
            let shape = coefficients[0] * q * q + coefficients[1] * beyond(350.0) + coefficients[2] * beyond(550.0);
            let expected = shape - 0.004271145683673469 + 3.2869566034985423e-5 * q;
            assert!((found - expected).abs() < 1e-15, "{found} {expected}");
        }
    }

    #[test]
    fn the_rule_is_exact_for_its_degree() {
        let integral: f64 = gauss_legendre().iter().map(|(x, weight)| weight * x.powi(22)).sum();
        assert!((integral - 2.0 / 23.0).abs() < 1e-15);
    }

    proptest! {
        #[test]
        fn no_line_is_left(from in -300.0..300.0_f64, width in 50.0..900.0_f64, knots in prop::collection::btree_set(1u8..99, 1..8)) {
            let range = [from, from + width];
            let knots: Vec<f64> = knots.into_iter().map(|part| from + width * f64::from(part) / 100.0).collect();
            let without = WithoutTrend::new(pieces(&knots, 2, range), Trend::Line, range);
            // By the rule of Simpson, exact for what is a cubic in each cell: knots are at ends of cells.
            let cells = 200;
            let mut moments = vec![[0.0; 2]; without.terms().len()];
            for node in 0..=2 * cells {
                let weight = [2.0, 4.0][node % 2] - f64::from(node == 0 || node == 2 * cells);
                let place = node as f64 / (2 * cells) as f64;
                for (moment, value) in moments.iter_mut().zip(values(&without, &[from + width * place])) {
                    moment[0] += weight * value / (6 * cells) as f64;
                    moment[1] += weight * value * (place - 0.5) / (6 * cells) as f64;
                }
            }
            for moment in moments {
                prop_assert!(moment.iter().all(|moment| moment.abs() < 1e-9 * width * width), "{moment:?}");
            }
        }

        #[test]
        fn slopes_are_those_of_the_values(at in 0.01..0.99_f64, turn in any::<bool>()) {
            let (trend, range) = if turn { (Trend::OncePerTurn, [-3.0, 3.0]) } else { (Trend::Line, [-30.0, 50.0]) };
            let place = |part: f64| range[0] + part * (range[1] - range[0]);
            let without = WithoutTrend::new(pieces(&[place(0.3), place(0.7)], 2, range), trend, range);
            slopes_agree(&without, place(at), 1e-5, 1e-6);
        }

        #[test]
        fn legendre_polynomials_have_their_slopes(x in -1.0..1.0_f64, degree in 0u8..10) {
            let step = 1e-6;
            let difference = (legendre(degree, x + step).0 - legendre(degree, x - step).0) / (2.0 * step);
            prop_assert!((difference - legendre(degree, x).1).abs() < 1e-6);
        }
    }
}
