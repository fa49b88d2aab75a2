//! Average run lengths of control charts on independent standard normal quantities, and the limits that give a wanted one.
//!
//! A run length is the number of tests until the first alarm. Charts that remember something obey an integral equation for
//! the run length from a state (Page 1954; Crowder 1987, A simple method for studying run-length distributions of
//! exponentially weighted moving average charts). It is solved at the nodes of a Gauss-Legendre rule.

use std::sync::LazyLock;

use nalgebra::{DMatrix, DVector};
use statrs::distribution::{Continuous, ContinuousCDF, Normal};

/// Nodes of the quadrature. The kernels are smooth, so that the error is far below that of the limits.
const NODES: usize = 40;

/// Run length of a chart of single values with limits of `limit` standard deviations.
pub fn individuals(limit: f64) -> f64 {
    1.0 / (2.0 * Normal::standard().sf(limit))
}

/// Run length of a chart of `y' = (1 - weight) y + weight z`, from 0, with constant limits of `limit` times the standard
/// deviation that y has after many tests, `sqrt(weight / (2 - weight))`.
pub fn weighted_average(weight: f64, limit: f64) -> f64 {
    let normal = Normal::standard();
    let edge = limit * (weight / (2.0 - weight)).sqrt();
    let rule = gauss_legendre(-edge, edge);
    let density = |from: f64, to: f64| normal.pdf((to - (1.0 - weight) * from) / weight) / weight;
    let lengths = solved(&rule, |from, to, share| density(from, to) * share);
    1.0 + rule
        .iter()
        .zip(lengths.iter())
        .map(|((node, share), length)| density(0.0, *node) * share * length)
        .sum::<f64>()
}

/// Run length of two sums `max(0, s + z - reference)` and `max(0, s - z - reference)`, from 0, of which one exceeds `limit`.
///
/// From 0 the two sides never are above zero together when one of them gives the alarm, so that the rates of alarms add
/// (Kemp 1961).
pub fn cumulative_sum(reference: f64, limit: f64) -> f64 {
    let normal = Normal::standard();
    let rule = gauss_legendre(0.0, limit);
    // The state zero has a probability of its own: it is the last unknown.
    let size = rule.len() + 1;
    let state = |index: usize| rule.get(index).map_or(0.0, |(node, _)| *node);
    let matrix = DMatrix::from_fn(size, size, |row, column| {
        let stay = match rule.get(column) {
            Some((node, share)) => normal.pdf(node + reference - state(row)) * share,
            None => normal.cdf(reference - state(row)),
        };
        f64::from(u8::from(row == column)) - stay
    });
    let lengths = matrix.lu().solve(&DVector::repeat(size, 1.0));
    lengths.map_or(f64::INFINITY, |lengths| lengths[size - 1] / 2.0)
}

/// Run length of a chart of `|z' - z|`, the differences of successive values, with this limit.
///
/// Successive differences share a value: the state is the last value, in narrow classes of its size.
pub fn moving_range(limit: f64) -> f64 {
    const CLASSES: usize = 80;
    const LARGEST: f64 = 6.0;
    let normal = Normal::standard();
    let width = LARGEST / CLASSES as f64;
    let middle = |class: usize| (class as f64 + 0.5) * width;
    let edges: Vec<f64> = (0..=CLASSES).map(|class| normal.cdf(class as f64 * width)).collect();
    // The part of a class that lies between two values; most lie in it as a whole, or outside.
    let part = |class: usize, low: f64, high: f64| {
        let (first, last) = (class as f64 * width, (class + 1) as f64 * width);
        let below = if low <= first { edges[class] } else { normal.cdf(low.min(last)) };
        let above = if high >= last { edges[class + 1] } else { normal.cdf(high.max(first)) };
        if low >= last || high <= first { 0.0 } else { above - below }
    };
    // On either side of zero, within the limit of the last value.
    let stay =
        |from: f64, class: usize| part(class, from - limit, from + limit) + part(class, -from - limit, limit - from);
    let matrix = DMatrix::from_fn(CLASSES, CLASSES, |row, column| {
        f64::from(u8::from(row == column)) - stay(middle(row), column)
    });
    let Some(lengths) = matrix.lu().solve(&DVector::repeat(CLASSES, 1.0)) else { return f64::INFINITY };
    let chance = |class: usize| 2.0 * (edges[class + 1] - edges[class]);
    // The first value has no difference: a run of n alarms counts n values, as that of every other chart.
    1.0 + (0..CLASSES).map(|class| chance(class) * lengths[class]).sum::<f64>()
}

/// The limit at which a run length that grows with its limit has the value `wanted`; between `low` and `high`.
pub fn limit_for(wanted: f64, low: f64, high: f64, run_length: impl Fn(f64) -> f64) -> f64 {
    let (mut low, mut high) = (low, high);
    // Regula falsi on the logarithm, which is almost straight; halving where it stands still (Illinois rule).
    // Beyond all numbers the equations are singular: that is longer than wanted.
    let distance = |limit: f64| Some((run_length(limit) / wanted).ln()).filter(|at| at.is_finite()).unwrap_or(50.0);
    let (mut at_low, mut at_high) = (distance(low), distance(high));
    if at_low >= 0.0 {
        return low;
    }
    if at_high <= 0.0 {
        return high;
    }
    for _ in 0..60 {
        let middle = low - at_low * (high - low) / (at_high - at_low);
        let at = distance(middle);
        if at.abs() < 1e-6 || high - low < 1e-9 {
            return middle;
        }
        if at > 0.0 {
            (high, at_high) = (middle, at);
            at_low /= 2.0;
        } else {
            (low, at_low) = (middle, at);
            at_high /= 2.0;
        }
    }
    (low + high) / 2.0
}

/// Run lengths from the nodes of a rule: `L = 1 + K L`.
fn solved(rule: &[(f64, f64)], kernel: impl Fn(f64, f64, f64) -> f64) -> DVector<f64> {
    let size = rule.len();
    let matrix = DMatrix::from_fn(size, size, |row, column| {
        f64::from(u8::from(row == column)) - kernel(rule[row].0, rule[column].0, rule[column].1)
    });
    matrix.lu().solve(&DVector::repeat(size, 1.0)).unwrap_or_else(|| DVector::repeat(size, f64::INFINITY))
}

/// Nodes and weights of the Gauss-Legendre rule between two numbers.
fn gauss_legendre(low: f64, high: f64) -> Vec<(f64, f64)> {
    /// Those between -1 and 1.
    static RULE: LazyLock<Vec<(f64, f64)>> = LazyLock::new(|| (0..NODES).map(node).collect());
    let (middle, half) = ((low + high) / 2.0, (high - low) / 2.0);
    RULE.iter().map(|(node, weight)| (middle + half * node, half * weight)).collect()
}

/// A root of the Legendre polynomial, by Newton's method, and its weight.
fn node(index: usize) -> (f64, f64) {
    let mut x = (std::f64::consts::PI * (index as f64 + 0.75) / (NODES as f64 + 0.5)).cos();
    let mut slope = 1.0;
    for _ in 0..20 {
        let (mut last, mut value) = (1.0, x);
        for degree in 2..=NODES {
            let degree = degree as f64;
            (last, value) = (value, ((2.0 * degree - 1.0) * x * value - (degree - 1.0) * last) / degree);
        }
        slope = NODES as f64 * (x * value - last) / (x * x - 1.0);
        x -= value / slope;
    }
    (x, 2.0 / ((1.0 - x * x) * slope * slope))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn run_lengths_are_those_of_the_literature() {
        // Three standard deviations: 370.4. Crowder 1987: weight 0.25, limit 3: 502.9; weight 0.1, limit 2.7: 344.7 or so.
        assert!((individuals(3.0) - 370.398).abs() < 1e-3);
        assert!((weighted_average(1.0, 3.0) - 370.398).abs() < 0.1, "{}", weighted_average(1.0, 3.0));
        assert!((weighted_average(0.2, 2.86) - 371.0).abs() < 0.5, "{}", weighted_average(0.2, 2.86));
        // NIST/SEMATECH e-Handbook 6.3.2.3.1: k = 0.5, h = 4 and 5: 336 and 930 on one side, 168 and 465 on two.
        assert!((cumulative_sum(0.5, 4.0) - 168.0).abs() < 0.5, "{}", cumulative_sum(0.5, 4.0));
        assert!((cumulative_sum(0.5, 5.0) - 465.0).abs() < 1.0, "{}", cumulative_sum(0.5, 5.0));
        assert!((cumulative_sum(0.5, 4.77) - 368.5).abs() < 0.5);
    }

    #[test]
    fn a_rule_integrates_polynomials() {
        let rule = gauss_legendre(-1.0, 3.0);
        let integral: f64 = rule.iter().map(|(x, share)| share * x.powi(7)).sum();
        assert!((integral - (3f64.powi(8) - 1.0) / 8.0).abs() < 1e-9 * integral);
    }

    #[test]
    fn limits_give_the_wanted_run_length() {
        for wanted in [100.0, 370.0, 1000.0] {
            let found = limit_for(wanted, 0.1, 12.0, individuals);
            assert!((individuals(found) / wanted - 1.0).abs() < 1e-5);
            let found = limit_for(wanted, 0.1, 12.0, |limit| cumulative_sum(0.5, limit));
            assert!((cumulative_sum(0.5, found) / wanted - 1.0).abs() < 1e-5);
            let found = limit_for(wanted, 0.1, 12.0, |limit| weighted_average(0.2, limit));
            assert!((weighted_average(0.2, found) / wanted - 1.0).abs() < 1e-5);
            let found = limit_for(wanted, 0.1, 12.0, moving_range);
            assert!((moving_range(found) / wanted - 1.0).abs() < 1e-5);
        }
    }
}
