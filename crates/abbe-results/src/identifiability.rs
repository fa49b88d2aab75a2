//! Identifiability: rank, lost directions, motion errors with the same effect.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::budget::UncertaintyBudget;
use abbe_settings::{Quantity, Unit};

/// A motion error of an axis that moves the tip at every recorded pose as other errors of this axis do, for any functions.
/// Different knots may make it appear determined, but the machine does not separate it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct EquivalentMotionError {
    /// Symbol of the error.
    pub error: String,
    /// The errors of the same axis that do the same, and how much of each one unit of `error` is.
    pub combination: Vec<Combination>,
    /// Which of all these errors are not estimated.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub not_estimated: Vec<String>,
    /// Directions of the tool, X, Y or Z: a further probe whose tip is elsewhere along one of them separates the errors.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub probe_offsets: Vec<char>,
}

impl EquivalentMotionError {
    /// One sentence for people.
    pub fn describe(&self) -> String {
        let parts = self.combination.iter().map(|part| {
            let (symbol, factor) = part.unit.parse().map_or((part.unit.clone(), 1.0), |unit: Unit| match unit.per {
                // As sizes of both errors in the usual units: per 1 µrad or 1 µm.
                Some((per, 1)) if unit.and_per.is_none() => {
                    let (of, factor) = Unit::of(unit.of).for_people();
                    (of, factor / Unit::of(per).for_people().1)
                }
                _ => unit.for_people(),
            });
            let size = format!("{:.6}", part.coefficient * factor);
            format!("{} {symbol} of {}", size.trim_end_matches('0').trim_end_matches('.'), part.name)
        });
        let does = if self.combination.len() == 1 { "does" } else { "do" };
        let one = match self.combination.first().and_then(|part| part.unit.parse::<Unit>().ok()) {
            Some(Unit { per: Some((Quantity::Angle, 1)), .. }) => "1 µrad",
            _ => "1 µm",
        };
        let same = format!("{one} of {} moves the tip as {} {does} at every recorded pose", self.error, and(parts));
        let told = if self.not_estimated.is_empty() {
            format!("{same}: only the functions chosen for them tell them apart, not the machine")
        } else {
            let held = and(self.not_estimated.iter().cloned());
            format!("{same}: {held} not being estimated, the values of the others contain it")
        };
        if self.probe_offsets.is_empty() {
            return told;
        }
        let along: Vec<String> = self.probe_offsets.iter().map(char::to_string).collect();
        format!("{told}; another probe offset, along {} of the tool, would tell them apart", along.join(" or "))
    }
}

/// A list for people: `a, b and c`.
fn and(parts: impl Iterator<Item = String>) -> String {
    let mut parts: Vec<String> = parts.collect();
    let Some(last) = parts.pop() else { return String::new() };
    if parts.is_empty() { last } else { format!("{} and {last}", parts.join(", ")) }
}

/// A direction in the space of the unknowns: a change of them together that has no effect on the data, or a weak one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct WeakDirection {
    /// Singular value relative to the largest, columns normalised.
    pub singular_value: f64,
    /// The change of the unknowns in that direction, parameter units; the one with the largest effect is 1.
    pub combination: Vec<Combination>,
    /// Measurements that would determine the change: sentences.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub separated_by: Vec<String>,
}

/// One unknown of a [`WeakDirection`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Combination {
    /// Name.
    pub name: String,
    /// Change in parameter units.
    pub coefficient: f64,
    /// The unit.
    pub unit: String,
}

impl WeakDirection {
    /// One sentence for people: which unknowns cannot be told apart, and the sizes that cancel each other.
    pub fn describe(&self) -> String {
        let names: Vec<&str> = self.combination.iter().map(|part| part.name.as_str()).collect();
        match names.as_slice() {
            [] => "a direction without a name is lost".to_owned(),
            [one] => format!("{one} has no effect on these measurements"),
            [one, other] => {
                format!("{one} and {other} cannot be told apart by these measurements ({})", self.changes())
            }
            [..] => format!("these measurements do not change when all of these do: {}", self.changes()),
        }
    }

    /// The same sentence with the measurement that separates them best, if one is known.
    pub fn advise(&self) -> String {
        let lost = self.describe();
        self.separated_by.first().map_or(lost.clone(), |measurement| format!("{lost}; {measurement}"))
    }

    /// The changes in the usual units, scaled so that the first change is 1.
    pub fn changes(&self) -> String {
        const SHOWN: usize = 8;
        let for_people = |part: &Combination| part.unit.parse().map_or((part.unit.clone(), 1.0), Unit::for_people);
        let first = self.combination.first().map_or(1.0, |part| part.coefficient * for_people(part).1);
        let changes = self.combination.iter().take(SHOWN).map(|part| {
            let (symbol, factor) = for_people(part);
            let change = part.coefficient * factor / first;
            // Four digits, without an exponent for sizes from 1e-3 to 1e5.
            match change.abs() {
                size if (1e-3..1e5).contains(&size) => {
                    let decimals = (3 - size.log10().floor() as i32).clamp(0, 6) as usize;
                    let text = format!("{change:+.decimals$}");
                    let text =
                        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
                    format!("{} {text} {symbol}", part.name)
                }
                _ => format!("{} {change:+.3e} {symbol}", part.name),
            }
        });
        let more = match self.combination.len().saturating_sub(SHOWN) {
            0 => String::new(),
            rest => format!(" and {rest} more"),
        };
        changes.collect::<Vec<_>>().join(", ") + &more
    }
}

/// Identifiability of a problem.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Identifiability {
    /// Number of equations.
    pub observations: usize,
    /// Number of unknowns.
    pub unknowns: usize,
    /// Numerical rank.
    pub rank: usize,
    /// Condition number with columns of norm 1, within the determined directions.
    pub condition: f64,
    /// The directions that are not determined.
    pub null_space: Vec<WeakDirection>,
    /// The combinations that are determined worst, the weakest first.
    pub weakest: Vec<WeakDirection>,
    /// Motion errors with the same effect on the tip: only the functions chosen for them separate them, not the machine.
    #[serde(rename = "same_motion", default, skip_serializing_if = "Vec::is_empty")]
    pub equivalent_motion_errors: Vec<EquivalentMotionError>,
    /// The uncertainties expected from the stated uncertainties of the inputs; none if a direction is lost.
    pub uncertainty: Option<UncertaintyBudget>,
    /// Further remarks for users: sentences.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub remarks: Vec<String>,
}
