//! Length measurement errors of coordinate measuring machines in the manner of ISO 10360-2:2009: E0, E with a stylus beside the
//! ram, R0.
//!
//! The text of the standard was not at hand. Five lengths on seven lines, three times each, are those of makers' public pages;
//! what happens with a value that is outside ([`Judged`]) is not confirmed by a public source and a choice of this project.
//!
//! Lengths and limits in one unit.

use std::collections::BTreeMap;

/// The edition that the symbols follow.
pub const EDITION: &str = "ISO 10360-2:2009, in its manner";
/// Sets with one value outside that may be measured again.
pub const REPEATED_SETS: usize = 5;
/// Values of a set, of which R0 is the range.
pub const VALUES: usize = 3;
/// Lines of the test of E0.
pub const LINES: usize = 7;

/// Lines of the test with the stylus beside the axis of the ram, E_L: two positions.
pub const LINES_BESIDE: usize = 2;
/// Lengths of each line.
pub const LENGTHS: usize = 5;

/// Maximum permissible error of a length: `min(A + L / K, B)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Permissible {
    /// What does not depend on the length.
    pub constant: f64,
    /// Error by length, both in one unit: what a maker writes as `L / K` in µm, with L in mm, is 0.001 / K.
    pub slope: f64,
    /// The largest one, where it is bounded.
    pub most: Option<f64>,
}

impl Permissible {
    /// At a length.
    ///
    /// ```
    /// use abbe_standards::lengths::Permissible;
    ///
    /// // 1.9 um + L/300: 272.5581 mm.
    /// let permissible = Permissible { constant: 1.9e-3, slope: 1e-3 / 300.0, most: None };
    /// assert!((permissible.at(272.5581) - 2.808527e-3).abs() < 1e-12);
    /// ```
    pub fn at(&self, length: f64) -> f64 {
        let error = self.constant + self.slope * length;
        self.most.map_or(error, |most| error.min(most))
    }
}

/// A measured length.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// The line or position.
    pub line: String,
    /// The calibrated length.
    pub reference: f64,
    /// The measured length.
    pub measured: f64,
}

impl Measured {
    /// E = measured - reference.
    pub fn error(&self) -> f64 {
        self.measured - self.reference
    }

    /// |E| / MPE.
    pub fn share(&self, permissible: &Permissible) -> f64 {
        self.error().abs() / permissible.at(self.reference)
    }

    /// Whether |E| <= MPE. What rounding of decimal numbers can be is not counted.
    pub fn is_inside(&self, permissible: &Permissible) -> bool {
        self.share(permissible) <= 1.0 + 1e-9
    }
}

/// The measurements of one length on one line.
#[derive(Debug, Clone, PartialEq)]
pub struct Set {
    /// The line or position.
    pub line: String,
    /// The calibrated length.
    pub reference: f64,
    /// Places of its values in the list of measurements.
    pub places: Vec<usize>,
    /// Range of the values if there are three: R0.
    pub range: Option<f64>,
}

impl Set {
    /// Whether a value is one of this length on this line.
    pub fn holds(&self, value: &Measured) -> bool {
        value.line == self.line && value.reference == self.reference
    }
}

/// Measurements by line and calibrated length, in the order in which they appear.
pub fn sets(measured: &[Measured]) -> Vec<Set> {
    let mut index: BTreeMap<(&str, u64), usize> = BTreeMap::new();
    let mut sets: Vec<Set> = Vec::new();
    for (place, value) in measured.iter().enumerate() {
        let at = *index.entry((value.line.as_str(), value.reference.to_bits())).or_insert_with(|| {
            sets.push(Set { line: value.line.clone(), reference: value.reference, places: Vec::new(), range: None });
            sets.len() - 1
        });
        sets[at].places.push(place);
    }
    for set in &mut sets {
        if set.places.len() == VALUES {
            let values = || set.places.iter().map(|place| measured[*place].measured);
            set.range = values().reduce(f64::max).zip(values().reduce(f64::min)).map(|(most, least)| most - least);
        }
    }
    sets
}

/// What the rule says of errors against their limits.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Judged {
    /// All are inside, after repeats where there were some.
    Inside,
    /// Sets with one value outside, at most five: these have to be measured three times again.
    Repeat(Vec<usize>),
    /// Not within the limits.
    Outside(String),
}

/// Judges sets by their values that are outside, and the repeats of these sets.
///
/// At most five sets may have one value outside; each is measured three times again and all three have to be inside. Where nothing was
/// measured nothing is inside.
///
/// `inside` tells whether a value is accepted: [`Measured::is_inside`] for simple acceptance.
pub fn judge(measured: &[Measured], sets: &[Set], repeats: &[Measured], inside: impl Fn(&Measured) -> bool) -> Judged {
    if sets.is_empty() {
        return Judged::Outside("nothing was measured".to_owned());
    }
    let outside = |set: &Set| set.places.iter().filter(|place| !inside(&measured[**place])).count();
    if let Some(set) = sets.iter().find(|set| outside(set) > 1) {
        let count = outside(set);
        return Judged::Outside(format!("{count} values of line {} at {} are outside", set.line, set.reference));
    }
    let single: Vec<usize> = (0..sets.len()).filter(|set| outside(&sets[*set]) == 1).collect();
    if single.len() > REPEATED_SETS {
        return Judged::Outside(format!("{} sets have a value outside, and {REPEATED_SETS} may", single.len()));
    }
    let again = |set: &Set| -> Vec<&Measured> { repeats.iter().filter(|value| set.holds(value)).collect() };
    if let Some(set) = single.iter().find(|set| again(&sets[**set]).iter().any(|value| !inside(value))) {
        let Set { line, reference, .. } = &sets[*set];
        return Judged::Outside(format!("line {line} at {reference} is outside in its repeats as well"));
    }
    let open: Vec<usize> = single.into_iter().filter(|set| again(&sets[*set]).len() < VALUES).collect();
    if open.is_empty() { Judged::Inside } else { Judged::Repeat(open) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: Permissible = Permissible { constant: 2.0, slope: 0.01, most: Some(4.0) };

    fn set(line: &str, reference: f64, errors: &[f64]) -> Vec<Measured> {
        let value = |error: &f64| Measured { line: line.to_owned(), reference, measured: reference + error };
        errors.iter().map(value).collect()
    }

    fn judged(measured: &[Measured], repeats: &[Measured]) -> Judged {
        judge(measured, &sets(measured), repeats, |value| value.is_inside(&LIMIT))
    }

    #[test]
    fn worked_example_of_limits_and_ranges() {
        assert_eq!([LIMIT.at(100.0), LIMIT.at(200.0), LIMIT.at(500.0)], [3.0, 4.0, 4.0]);
        let all = [set("1", 100.0, &[1.0, -2.0, 0.5]), set("2", 100.0, &[0.0, 1.0])].concat();
        let found = sets(&all);
        assert_eq!(found.iter().map(|set| set.range).collect::<Vec<_>>(), [Some(3.0), None]);
        assert_eq!(all[1].error(), -2.0);
        assert!((all[1].share(&LIMIT) - 2.0 / 3.0).abs() < 1e-15);
        // Exactly at the limit is inside.
        assert_eq!(judged(&set("1", 100.0, &[3.0, -3.0, 0.0]), &[]), Judged::Inside);
    }

    #[test]
    fn one_value_outside_is_measured_again_and_two_are_too_many() {
        let one = set("1", 100.0, &[3.5, 0.0, 0.0]);
        assert_eq!(judged(&one, &[]), Judged::Repeat(vec![0]));
        assert_eq!(judged(&one, &set("1", 100.0, &[1.0, 2.0])), Judged::Repeat(vec![0]));
        assert_eq!(judged(&one, &set("1", 100.0, &[1.0, 2.0, 2.9])), Judged::Inside);
        assert!(matches!(judged(&[], &[]), Judged::Outside(_)));
        // Repeats of another line or length tell nothing.
        assert_eq!(judged(&one, &set("2", 100.0, &[1.0, 2.0, 2.9])), Judged::Repeat(vec![0]));
        assert!(matches!(judged(&one, &set("1", 100.0, &[1.0, 2.0, 3.1])), Judged::Outside(_)));
        assert!(matches!(judged(&set("1", 100.0, &[3.5, 3.5, 0.0]), &[]), Judged::Outside(_)));
    }

    #[test]
    fn at_most_five_sets_may_have_a_value_outside() {
        let with = |count: usize| {
            (0..count).flat_map(|line| set(&line.to_string(), 50.0, &[0.0, 2.6, 0.0])).collect::<Vec<_>>()
        };
        assert_eq!(judged(&with(5), &[]), Judged::Repeat((0..5).collect()));
        assert!(matches!(judged(&with(6), &with(6)), Judged::Outside(_)));
        let again: Vec<Measured> = (0..5).flat_map(|line| set(&line.to_string(), 50.0, &[0.1; 3])).collect();
        assert_eq!(judged(&with(5), &again), Judged::Inside);
    }
}
