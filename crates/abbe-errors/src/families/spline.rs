//! Natural cubic splines through values at knots.

use abbe_core::SettingsError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::knots::{Knots, knots};
use super::{Argument, Family, Functions, Subject, Term, suits};

/// Natural cubic splines through values at knots, `EXX[spl0]`, `EXX[spl1]`, ... in the unit of the error; straight beyond the
/// first and the last knot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Spline {
    /// Motion errors by ISO 230-1 symbol, e.g. EXX; `?` and `*` are wildcards.
    pub spline: Vec<String>,
    /// Knots of errors of a linear axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub knots_mm: Option<Knots>,
    /// Knots of errors of a rotary axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub knots_deg: Option<Knots>,
    /// Values that are zero by definition and no parameters, e.g. `EXX[spl5]`; `?` and `*` are wildcards.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub zero: Vec<String>,
}

/// A natural spline has the second derivative as an unknown at inner knots only; with two knots it would be a line.
const FEWEST: usize = 3;

impl Family for Spline {
    fn symbols(&self) -> &[String] {
        &self.spline
    }

    fn zero(&self) -> &[String] {
        &self.zero
    }

    fn check(&self) -> Result<(), SettingsError> {
        knots("a spline", &self.knots_mm, &self.knots_deg, FEWEST).map(|_| ())
    }

    fn functions(&self, subject: &Subject<'_>) -> Result<Vec<Box<dyn Functions>>, SettingsError> {
        suits(("knots", "knots"), subject, self.knots_mm.is_some(), self.knots_deg.is_some())?;
        let knots = knots("a spline", &self.knots_mm, &self.knots_deg, FEWEST)?;
        Ok(vec![Box::new(NaturalSpline::new(knots))])
    }
}

/// Cardinal natural cubic splines: function k is 1 at knot k and 0 at the others, with second derivatives that are
/// continuous, zero at the ends and beyond (de Boor 2001, ch. IV). Each coefficient changes the spline everywhere, but less
/// with the distance from its knot.
#[derive(Debug, Clone, PartialEq)]
pub struct NaturalSpline {
    knots: Vec<f64>,
    /// Second derivative at every knot (rows) of every function.
    bends: Vec<Vec<f64>>,
}

impl NaturalSpline {
    /// The functions of increasing knots, two at least.
    pub fn new(knots: Vec<f64>) -> Self {
        let count = knots.len();
        let mut bends = vec![vec![0.0; count]; count];
        let width = |k: usize| knots[k + 1] - knots[k];
        // h0 m0 + 2 (h0 + h1) m1 + h1 m2 = 6 (rise of the right slope over the left one), by elimination and substitution.
        let mut upper = vec![0.0; count];
        for knot in 1..count.saturating_sub(1) {
            let (left, right) = (width(knot - 1), width(knot));
            let pivot = 2.0 * (left + right) - left * upper[knot - 1];
            upper[knot] = right / pivot;
            let (done, rest) = bends.split_at_mut(knot);
            for (bend, before) in rest[0].iter_mut().zip(&done[knot - 1]) {
                *bend = -left * before / pivot;
            }
            rest[0][knot - 1] += 6.0 / left / pivot;
            rest[0][knot] -= 6.0 * (1.0 / left + 1.0 / right) / pivot;
            rest[0][knot + 1] += 6.0 / right / pivot;
        }
        for knot in (1..count.saturating_sub(1)).rev() {
            let (rest, done) = bends.split_at_mut(knot + 1);
            for (bend, after) in rest[knot].iter_mut().zip(&done[0]) {
                *bend -= upper[knot] * after;
            }
        }
        Self { knots, bends }
    }

    /// The interval of a command; the first and the last interval extend beyond the ends.
    fn interval(&self, command: f64) -> usize {
        self.knots.partition_point(|knot| *knot <= command).clamp(1, self.knots.len() - 1) - 1
    }

    /// The combination of values at both ends of the interval and second derivatives there: weights of both, for the value or
    /// the slope.
    fn combine(&self, interval: usize, ends: [f64; 2], bends: [f64; 2], out: &mut [f64]) {
        let (left, right) = (&self.bends[interval], &self.bends[interval + 1]);
        for ((out, left), right) in out.iter_mut().zip(left).zip(right) {
            *out = bends[0] * left + bends[1] * right;
        }
        out[interval] += ends[0];
        out[interval + 1] += ends[1];
    }

    /// The first or last knot if a command is beyond it.
    fn beyond(&self, command: f64) -> Option<f64> {
        let (first, last) = (self.knots[0], self.knots[self.knots.len() - 1]);
        (command < first).then_some(first).or((command > last).then_some(last))
    }
}

impl Functions for NaturalSpline {
    fn arguments(&self) -> Vec<Argument> {
        vec![Argument::Command]
    }

    fn terms(&self) -> Vec<Term> {
        (0..self.knots.len()).map(|knot| Term::new(format!("[spl{knot}]"), 0)).collect()
    }

    fn values(&self, arguments: &[f64], out: &mut [f64]) {
        let command = arguments[0];
        let interval = self.interval(command);
        let (from, to) = (self.knots[interval], self.knots[interval + 1]);
        let width = to - from;
        let (left, right) = ((to - command) / width, (command - from) / width);
        let bends = match self.beyond(command) {
            None => [left, right].map(|part| (part * part * part - part) * width * width / 6.0),
            // The slope at the end times the distance of the command beyond it.
            Some(end) => slope_of_bends(if end == from { [1.0, 0.0] } else { [0.0, 1.0] }, width)
                .map(|slope| slope * (command - end)),
        };
        self.combine(interval, [left, right], bends, out);
    }

    fn slopes(&self, _: usize, arguments: &[f64], out: &mut [f64]) {
        let interval = self.interval(arguments[0]);
        let (from, to) = (self.knots[interval], self.knots[interval + 1]);
        let (width, command) = (to - from, self.beyond(arguments[0]).unwrap_or(arguments[0]));
        let parts = [(to - command) / width, (command - from) / width];
        self.combine(interval, [-1.0 / width, 1.0 / width], slope_of_bends(parts, width), out);
    }
}

/// Contribution of the second derivatives at both ends of an interval to the slope. The arguments are the relative distances
/// from the right and from the left end.
fn slope_of_bends([left, right]: [f64; 2], width: f64) -> [f64; 2] {
    [(1.0 - 3.0 * left * left) * width / 6.0, (3.0 * right * right - 1.0) * width / 6.0]
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::families::testing::{slopes, slopes_agree, values};

    fn knots() -> impl Strategy<Value = Vec<f64>> {
        (-300.0..300.0_f64, prop::collection::vec(5.0..120.0_f64, 2..12)).prop_map(|(first, widths)| {
            let mut knots = vec![first];
            widths.iter().for_each(|width| knots.push(knots[knots.len() - 1] + width));
            knots
        })
    }

    fn bend(spline: &NaturalSpline, at: f64) -> Vec<f64> {
        let step = 1e-4;
        let (above, below) = (slopes(spline, &[at + step]), slopes(spline, &[at - step]));
        above.iter().zip(below).map(|(above, below)| (above - below) / (2.0 * step)).collect()
    }

    proptest! {
        #[test]
        fn every_function_is_one_at_its_own_knot_only(knots in knots()) {
            let spline = NaturalSpline::new(knots.clone());
            for (k, knot) in knots.iter().enumerate() {
                for (j, value) in values(&spline, &[*knot]).into_iter().enumerate() {
                    let expected = f64::from(j == k);
                    prop_assert!((value - expected).abs() < 1e-13, "{j} at {k}: {value}");
                }
            }
        }

        #[test]
        fn straight_lines_stay_straight_everywhere(knots in knots(), at in -1.0..2.0_f64) {
            let spline = NaturalSpline::new(knots.clone());
            let at = knots[0] + at * (knots[knots.len() - 1] - knots[0]);
            let line = |q: f64| 2.5 - 0.75 * q;
            let value: f64 = values(&spline, &[at]).iter().zip(&knots).map(|(value, knot)| value * line(*knot)).sum();
            let slope: f64 = slopes(&spline, &[at]).iter().zip(&knots).map(|(slope, knot)| slope * line(*knot)).sum();
            prop_assert!((value - line(at)).abs() < 1e-9, "{value} {}", line(at));
            prop_assert!((slope + 0.75).abs() < 1e-10, "{slope}");
        }

        #[test]
        fn value_slope_and_bend_do_not_jump_at_knots(knots in knots()) {
            let spline = NaturalSpline::new(knots.clone());
            for knot in knots {
                let near = 1e-7;
                for of in [values, slopes] {
                    let (left, right) = (of(&spline, &[knot - near]), of(&spline, &[knot + near]));
                    for (left, right) in left.iter().zip(right) {
                        prop_assert!((left - right).abs() < 1e-6, "{left} {right}");
                    }
                }
                for (left, right) in bend(&spline, knot - 1e-3).iter().zip(bend(&spline, knot + 1e-3)) {
                    prop_assert!((left - right).abs() < 1e-3, "{left} {right}");
                }
            }
        }

        #[test]
        fn ends_and_what_is_beyond_are_not_bent(knots in knots(), beyond in 0.01..500.0_f64) {
            let spline = NaturalSpline::new(knots.clone());
            let last = knots[knots.len() - 1];
            for (end, at) in [(knots[0], knots[0] - beyond), (last, last + beyond)] {
                let (slope, value) = (slopes(&spline, &[end]), values(&spline, &[end]));
                prop_assert_eq!(&slopes(&spline, &[at]), &slope);
                for (k, outside) in values(&spline, &[at]).into_iter().enumerate() {
                    prop_assert!((outside - value[k] - slope[k] * (at - end)).abs() < 1e-11 * (1.0 + beyond));
                }
            }
            for bend in [&spline.bends[0], &spline.bends[knots.len() - 1]] {
                prop_assert!(bend.iter().all(|bend| *bend == 0.0));
            }
        }

        #[test]
        fn slopes_are_those_of_the_values(knots in knots(), at in -0.5..1.5_f64) {
            let at = knots[0] + at * (knots[knots.len() - 1] - knots[0]);
            slopes_agree(&NaturalSpline::new(knots), at, 1e-5, 1e-8);
        }
    }

    #[test]
    fn a_parabola_with_natural_ends_by_hand() {
        // Knots 0, 1, 2 and the values 0, 1, 0: m1 = -3, so the value in the middle of an interval is 1/2 + 3/16.
        let spline = NaturalSpline::new(vec![0.0, 1.0, 2.0]);
        assert!((spline.bends[1][1] + 3.0).abs() < 1e-15);
        assert!((values(&spline, &[0.5])[1] - 0.6875).abs() < 1e-15);
        assert!((slopes(&spline, &[-4.0])[1] - 1.5).abs() < 1e-15);
        assert!((values(&spline, &[-4.0])[1] + 6.0).abs() < 1e-15);
    }
}
