//! Decisions on conformity after ISO 14253-1 and JCGM 106:2012: zones, probability of conformity, and risks.
//!
//! The rules are those of [`Rule`], which every limit of every validator is decided by. The factor 1.65 of the edition of 2017 (95 %) is
//! from public notes on the standard and ILAC-G8; it is one-sided, so the tolerance has to be wide against the uncertainty.

use abbe_results::{Decision, Rule};

/// The values that a specification allows; its limits belong to it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Tolerance {
    /// The smallest allowed value; none if there is no such limit.
    pub lower: Option<f64>,
    /// The largest allowed value; none if there is no such limit.
    pub upper: Option<f64>,
}

/// A measured value with its expanded uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured {
    /// The value.
    pub value: f64,
    /// Expanded uncertainty U.
    pub expanded: f64,
    /// Its coverage factor k.
    pub coverage: f64,
}

impl Measured {
    /// Standard uncertainty u = U / k.
    pub fn standard_uncertainty(&self) -> f64 {
        self.expanded / self.coverage
    }
}

/// The guard band w of a rule: 0 for simple acceptance, the stated U for ISO 14253-1:1998 and for the binary rule, and 1.65 u (at 95 %)
/// for ISO 14253-1:2017.
pub fn guard_band(rule: Rule, measured: Measured) -> f64 {
    match rule {
        Rule::Iso14253Of1998 { .. } | Rule::Binary { .. } => measured.expanded,
        Rule::Simple {} | Rule::Iso14253Of2017 { .. } => rule.factor() * measured.standard_uncertainty(),
    }
}

/// The answer of a rule: pass inside of the acceptance zone; for rules with three answers inconclusive within the guard bands on either
/// side of a limit, else fail. Fails for a value or uncertainty that is no number, or an uncertainty below zero.
///
/// ```
/// use abbe_results::{Decision, Rule};
/// use abbe_standards::conformity::{Measured, Tolerance, decide};
///
/// let rule = Rule::Iso14253Of2017 { probability: 0.95 };
/// let upper = Tolerance { upper: Some(10.0), lower: None };
/// let of = |value| decide(rule, Measured { value, expanded: 1.0, coverage: 2.0 }, upper);
/// // 10 - 0.825 and 10 + 0.825 are the borders.
/// assert_eq!([9.1, 9.5, 10.9].map(of), [Decision::Pass, Decision::Inconclusive, Decision::Fail]);
/// ```
pub fn decide(rule: Rule, measured: Measured, tolerance: Tolerance) -> Decision {
    let band = guard_band(rule, measured);
    match band >= 0.0 && measured.value.is_finite() {
        true => rule.answer(measured.value, band, tolerance.lower, tolerance.upper),
        false => Decision::Fail,
    }
}

/// The zone of accepted values for a guard band: from `lower + w` to `upper - w`; none if it is empty. Infinite where there is no limit.
pub fn acceptance_zone(tolerance: Tolerance, band: f64) -> Option<[f64; 2]> {
    let low = tolerance.lower.map_or(f64::NEG_INFINITY, |lower| lower + band);
    let high = tolerance.upper.map_or(f64::INFINITY, |upper| upper - band);
    (low <= high).then_some([low, high])
}

/// Probability of conformity: that the true value is within the tolerance, for a normal distribution about the measured value and
/// nothing known beforehand (JCGM 106:2012, 7.3 and 7.4). A value without uncertainty conforms or not.
///
/// ```
/// use abbe_standards::conformity::{Tolerance, probability};
///
/// let both = Tolerance { lower: Some(-1.0), upper: Some(1.0) };
/// // Within one standard uncertainty of the middle.
/// assert!((probability(0.0, 1.0, both) - 0.682_689_492_137).abs() < 1e-10);
/// ```
pub fn probability(value: f64, standard_uncertainty: f64, tolerance: Tolerance) -> f64 {
    let inside = |value: f64| {
        tolerance.lower.is_none_or(|lower| value >= lower) && tolerance.upper.is_none_or(|upper| value <= upper)
    };
    if standard_uncertainty == 0.0 {
        return if inside(value) { 1.0 } else { 0.0 };
    }
    let below = |limit: f64| abbe_results::normal_below((limit - value) / standard_uncertainty);
    // Of both tails the smaller sum of errors: what is beyond a limit is taken as such, not as one less the rest.
    let beyond = tolerance.lower.map_or(0.0, below)
        + tolerance.upper.map_or(0.0, |upper| abbe_results::normal_below((value - upper) / standard_uncertainty));
    (1.0 - beyond).clamp(0.0, 1.0)
}

/// The risk of a decision on one measured value (JCGM 106:2012, 9.3): that what is accepted does not conform (specific consumer's risk,
/// false acceptance), or that what is rejected conforms (specific producer's risk, false rejection). None if nothing is decided.
pub fn specific_risk(rule: Rule, measured: Measured, tolerance: Tolerance) -> Option<f64> {
    let conforms = probability(measured.value, measured.standard_uncertainty(), tolerance);
    match decide(rule, measured, tolerance) {
        Decision::Pass => Some(1.0 - conforms),
        Decision::Fail => Some(conforms),
        Decision::Inconclusive => None,
    }
}

/// What is known of items before they are measured: a normal distribution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Process {
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub deviation: f64,
}

/// Global risks (JCGM 106:2012, 9.5) of items of a process that are measured with a standard uncertainty and accepted within the zone
/// of the guard band w: that an item does not conform and is accepted, and that it conforms and is not.
///
/// The integral over the items is made by Simpson's rule over ten standard deviations to either side, split where the conformity
/// changes. None unless deviation and uncertainty are positive.
pub fn global_risks(process: Process, standard_uncertainty: f64, band: f64, tolerance: Tolerance) -> Option<[f64; 2]> {
    let Process { mean, deviation } = process;
    if !(deviation > 0.0 && standard_uncertainty > 0.0 && band.is_finite() && mean.is_finite()) {
        return None;
    }
    let zone = acceptance_zone(tolerance, band);
    let accepted = |item: f64| {
        zone.map_or(0.0, |[lower, upper]| {
            probability(item, standard_uncertainty, Tolerance { lower: Some(lower), upper: Some(upper) })
        })
    };
    let density = |item: f64| {
        let z = (item - mean) / deviation;
        (-0.5 * z * z).exp() / (deviation * (2.0 * std::f64::consts::PI).sqrt())
    };
    let [first, last] = [mean - 10.0 * deviation, mean + 10.0 * deviation];
    let lower = tolerance.lower.map_or(first, |lower| lower.clamp(first, last));
    let upper = tolerance.upper.map_or(last, |upper| upper.clamp(lower, last));
    // Steps that see both the spread of items and the uncertainty.
    let step = 0.02 * deviation.min(standard_uncertainty);
    let over = |from: f64, to: f64, value: &dyn Fn(f64) -> f64| {
        let halves = 2 * (((to - from) / step / 2.0).ceil() as usize).clamp(1, 100_000);
        let width = (to - from) / halves as f64;
        let weight = |place: usize| if place == 0 || place == halves { 1.0 } else { 2.0 + 2.0 * (place % 2) as f64 };
        (0..=halves).map(|place| weight(place) * value(from + width * place as f64)).sum::<f64>() * width / 3.0
    };
    let wrong = |item: f64| density(item) * accepted(item);
    let lost = |item: f64| density(item) * (1.0 - accepted(item));
    Some([over(first, lower, &wrong) + over(upper, last, &wrong), over(lower, upper, &lost)])
}

#[cfg(test)]
mod tests;
