//! B-splines of the command.

use abbe_core::{Quantity, SettingsError, Whole};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::knots::{Knots, knots, within};
use super::travel::Travel;
use super::{Argument, Family, Functions, Subject, Term, suits};

/// B-splines over the travel: `EXX[bs0]`, `EXX[bs1]`, ... in the unit of the error, each different from zero on a few pieces only.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BSpline {
    /// Motion errors by ISO 230-1 symbol, e.g. EXX; `?` and `*` are wildcards.
    #[serde(rename = "b-spline")]
    pub b_spline: Vec<String>,
    /// Degree of the pieces, 1 to 5.
    pub degree: Whole<1, 5>,
    /// Inner knots of errors of a linear axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub knots_mm: Option<Knots>,
    /// Inner knots of errors of a rotary axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub knots_deg: Option<Knots>,
    /// Travel of a linear axis. Default: the range of the axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range_mm: Option<[f64; 2]>,
    /// Travel of a rotary axis. Default: the range of the axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range_deg: Option<[f64; 2]>,
    /// For straightness: the error has no least-squares line over the travel. The first and the last function then
    /// follow from the others and are left out.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub without_line: bool,
    /// Coefficients that are zero by definition and no parameters, e.g. `EXX[bs0]`; `?` and `*` are wildcards.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub zero: Vec<String>,
}

impl BSpline {
    fn travel(&self) -> Travel {
        Travel {
            range_mm: self.range_mm,
            range_deg: self.range_deg,
            without_line: self.without_line,
            without_once_per_turn: false,
        }
    }
}

impl Family for BSpline {
    fn symbols(&self) -> &[String] {
        &self.b_spline
    }

    fn zero(&self) -> &[String] {
        &self.zero
    }

    fn check(&self) -> Result<(), SettingsError> {
        knots("a B-spline", &self.knots_mm, &self.knots_deg, 1)?;
        self.travel().check()
    }

    fn functions(&self, subject: &Subject<'_>) -> Result<Vec<Box<dyn Functions>>, SettingsError> {
        suits(("knots", "knots"), subject, self.knots_mm.is_some(), self.knots_deg.is_some())?;
        let range = self.travel().required_range(subject, "a B-spline")?;
        let knots = knots("a B-spline", &self.knots_mm, &self.knots_deg, 1)?;
        within(&knots, range, subject.command == Quantity::Angle)?;
        let splines = BSplines::new(&knots, self.degree.get() as u8, range);
        Ok(vec![
            self.travel()
                .without_trend(Box::new(if self.without_line { splines.inner() } else { splines }), subject)?,
        ])
    }
}

/// B-splines of inner knots and a travel, by the recursion of Cox and de Boor (de Boor 2001, ch. IX). Together they are 1 everywhere.
#[derive(Debug, Clone, PartialEq)]
pub struct BSplines {
    /// All knots; each end occurs degree + 1 times.
    knots: Vec<f64>,
    degree: usize,
    /// Number of functions that are left out at each end.
    ends: usize,
}

impl BSplines {
    /// The functions of increasing inner knots.
    pub fn new(inner: &[f64], degree: u8, [from, to]: [f64; 2]) -> Self {
        let degree = usize::from(degree);
        let knots = [&vec![from; degree + 1], inner, &vec![to; degree + 1]].concat();
        Self { knots, degree, ends: 0 }
    }

    /// The functions without the first and the last one. Together with lines, the remaining ones span the same space.
    pub fn inner(self) -> Self {
        Self { ends: 1, ..self }
    }

    fn count(&self) -> usize {
        self.knots.len() - self.degree - 1
    }

    /// The `degree + 1` functions that are not zero at a command, of a lower degree if wished, and the piece that it is on;
    /// beyond the ends those of the first or the last piece are continued.
    fn local(&self, command: f64, degree: usize) -> (usize, Vec<f64>) {
        let last = self.knots.len() - self.degree - 2;
        let piece = self.knots.partition_point(|knot| *knot <= command).clamp(self.degree + 1, last + 1) - 1;
        let mut values = vec![0.0; degree + 1];
        values[0] = 1.0;
        for order in 1..=degree {
            let mut saved = 0.0;
            for (r, value) in values[..order].iter_mut().enumerate() {
                let (right, left) = (self.knots[piece + r + 1], self.knots[piece + 1 + r - order]);
                let part = *value / (right - left);
                *value = saved + (right - command) * part;
                saved = (command - left) * part;
            }
            values[order] = saved;
        }
        (piece, values)
    }

    /// Adds a value of function `index` to `out`; `index` counts the functions that are left out at the ends, too.
    fn put(&self, index: usize, value: f64, out: &mut [f64]) {
        if let Some(out) = index.checked_sub(self.ends).and_then(|index| out.get_mut(index)) {
            *out += value;
        }
    }
}

impl Functions for BSplines {
    fn arguments(&self) -> Vec<Argument> {
        vec![Argument::Command]
    }

    fn terms(&self) -> Vec<Term> {
        (self.ends..self.count() - self.ends).map(|index| Term::new(format!("[bs{index}]"), 0)).collect()
    }

    fn values(&self, arguments: &[f64], out: &mut [f64]) {
        out.fill(0.0);
        let (piece, values) = self.local(arguments[0], self.degree);
        values.into_iter().enumerate().for_each(|(r, value)| self.put(piece - self.degree + r, value, out));
    }

    fn slopes(&self, _: usize, arguments: &[f64], out: &mut [f64]) {
        out.fill(0.0);
        let (piece, lower) = self.local(arguments[0], self.degree - 1);
        for (r, value) in lower.into_iter().enumerate() {
            // Function j of one degree less starts at knot j. It is added to function j and subtracted from function j - 1.
            let j = piece - (self.degree - 1) + r;
            let slope = self.degree as f64 * value / (self.knots[j + self.degree] - self.knots[j]);
            self.put(j, slope, out);
            self.put(j - 1, -slope, out);
        }
    }

    fn range(&self) -> Option<[f64; 2]> {
        Some([self.knots[0], self.knots[self.knots.len() - 1]])
    }

    fn breaks(&self) -> &[f64] {
        &self.knots[self.degree + 1..self.knots.len() - self.degree - 1]
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::families::testing::{names, slopes, slopes_agree, values};
    use crate::families::{Trend, WithoutTrend};

    #[test]
    fn values_by_hand() {
        // One cubic piece: Bernstein polynomials.
        let bernstein = BSplines { ends: 0, ..BSplines::new(&[], 3, [0.0, 2.0]) };
        assert_eq!(values(&bernstein, &[1.0]), [0.125, 0.375, 0.375, 0.125]);
        // Degree 1: hats.
        let hats = BSplines::new(&[1.0, 3.0], 1, [0.0, 4.0]);
        assert_eq!(names(&hats), ["[bs0]", "[bs1]", "[bs2]", "[bs3]"]);
        assert_eq!(values(&hats, &[2.5]), [0.0, 0.25, 0.75, 0.0]);
        assert_eq!(values(&hats, &[4.0]), [0.0, 0.0, 0.0, 1.0]);
        assert_eq!(slopes(&hats, &[2.5]), [0.0, -0.5, 0.5, 0.0]);
        assert_eq!(names(&hats.inner()), ["[bs1]", "[bs2]"]);
    }

    #[test]
    fn without_lines_the_inner_ones_and_lines_give_all() {
        // The rank of the values of inner functions without line, and two lines, at many places is that of all splines.
        let (range, knots) = ([0.0, 10.0], [2.0, 3.0, 7.0]);
        let all = BSplines::new(&knots, 3, range);
        let inner = WithoutTrend::new(Box::new(all.clone().inner()), Trend::Line, range);
        let place = |index: usize| 10.0 * index as f64 / 40.0;
        let mut columns: Vec<Vec<f64>> = vec![vec![1.0; 41], (0..41).map(|index| place(index) / 10.0).collect()];
        for function in 0..inner.terms().len() {
            columns.push((0..41).map(|index| values(&inner, &[place(index)])[function]).collect());
        }
        assert_eq!(columns.len(), all.terms().len());
        // Gram and Schmidt: every column keeps a part of its own.
        for index in 0..columns.len() {
            let (done, rest) = columns.split_at_mut(index);
            let before = rest[0].iter().map(|value| value * value).sum::<f64>().sqrt();
            for other in done.iter() {
                let along: f64 = rest[0].iter().zip(other).map(|(a, b)| a * b).sum();
                rest[0].iter_mut().zip(other).for_each(|(value, other)| *value -= along * other);
            }
            let norm = rest[0].iter().map(|value| value * value).sum::<f64>().sqrt();
            assert!(norm > 1e-3 * before, "column {index}: {norm} of {before}");
            rest[0].iter_mut().for_each(|value| *value /= norm);
        }
    }

    proptest! {
        #[test]
        fn together_they_are_one(at in -0.5..10.5_f64, degree in 1u8..6) {
            let splines = BSplines::new(&[2.0, 3.0, 7.0], degree, [0.0, 10.0]);
            let sum: f64 = values(&splines, &[at]).iter().sum();
            let slope: f64 = slopes(&splines, &[at]).iter().sum();
            prop_assert!((sum - 1.0).abs() < 1e-11 && slope.abs() < 1e-10, "{sum} {slope}");
        }

        #[test]
        fn neither_value_nor_slope_jumps_at_knots(knot in 0usize..3, degree in 2u8..6) {
            let knots = [2.0, 3.0, 7.0];
            let splines = BSplines::new(&knots, degree, [0.0, 10.0]);
            for of in [values, slopes] {
                let (left, right) = (of(&splines, &[knots[knot] - 1e-9]), of(&splines, &[knots[knot] + 1e-9]));
                for (left, right) in left.iter().zip(right) {
                    prop_assert!((left - right).abs() < 1e-6, "{left} {right}");
                }
            }
        }

        #[test]
        fn slopes_are_those_of_the_values(at in 0.0..10.0_f64, degree in 2u8..6) {
            slopes_agree(&BSplines::new(&[2.0, 3.0, 7.0], degree, [0.0, 10.0]), at, 1e-6, 1e-5);
        }
    }
}
