//! Compliance under gravity: joints that turn under the weight of what follows them.

use abbe_core::{PathItem, Quantity, SettingsError};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Argument, Family, Functions, Subject, Term};

/// Compliance under gravity: a joint or a link gives way in proportion to the moment of the weights behind it, which is a sum of
/// cosines and sines of the angles of these bodies to the vertical: `EBB1[cosB1]`, `EBB1[sinB1]`, `EBB1[cosB1+B2]`, ... in the unit of
/// the error. One pair for each body that weighs; the angle of a body is the sum of the commands of parallel joints up to it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Gravity {
    /// Motion errors by ISO 230-1 symbol, e.g. EBB1; `?` and `*` are wildcards.
    pub gravity: Vec<String>,
    /// The angles of the bodies: sums of commands of rotary axes, e.g. `B1`, `B1+B2`, `B1+B2-B3`.
    pub angles: Vec<String>,
}

/// A command with its sign, and the rest of a sum.
fn summands(sum: &str) -> Option<Vec<(f64, String)>> {
    let compact: String = sum.chars().filter(|character| !character.is_whitespace()).collect();
    let mut found: Vec<(f64, String)> = Vec::new();
    let mut sign = 1.0;
    let mut name = String::new();
    for character in compact.chars() {
        if !matches!(character, '+' | '-') {
            name.push(character);
            continue;
        }
        match (name.is_empty(), found.is_empty()) {
            (false, _) => found.push((sign, std::mem::take(&mut name))),
            // A sign before the first name.
            (true, true) if sign == 1.0 && compact.starts_with(character) => {}
            (true, _) => return None,
        }
        sign = if character == '-' { -1.0 } else { 1.0 };
    }
    let is_new = !name.is_empty() && !found.iter().any(|(_, other)| *other == name);
    found.push((sign, name));
    let is_twice = (1..found.len()).any(|index| found[..index].iter().any(|(_, other)| *other == found[index].1));
    (is_new && !is_twice).then_some(found)
}

impl Family for Gravity {
    fn symbols(&self) -> &[String] {
        &self.gravity
    }

    fn check(&self) -> Result<(), SettingsError> {
        if self.angles.is_empty() {
            return Err(SettingsError::new("angles", "the angle of at least one body was expected, e.g. `B1+B2`"));
        }
        for (index, sum) in self.angles.iter().enumerate() {
            let at = [PathItem::Key("angles".to_owned()), PathItem::Index(index)];
            if summands(sum).is_none() {
                let message = format!("`{sum}`: a sum of different axes was expected, e.g. `B1+B2`");
                return Err(SettingsError::new("", message).under(at));
            }
            if self.angles[..index].contains(sum) {
                return Err(SettingsError::new("", format!("`{sum}` stands here twice")).under(at));
            }
        }
        Ok(())
    }

    fn functions(&self, subject: &Subject<'_>) -> Result<Vec<Box<dyn Functions>>, SettingsError> {
        let mut functions = MomentsOfWeight { axes: Vec::new(), bodies: Vec::new() };
        for (index, sum) in self.angles.iter().enumerate() {
            let wrong = |message: String| {
                SettingsError::new("", message).under([PathItem::Key("angles".to_owned()), PathItem::Index(index)])
            };
            let mut factors = Vec::new();
            for (sign, name) in summands(sum).unwrap_or_default() {
                match subject.axes.iter().find(|(axis, _)| *axis == name) {
                    Some((_, Quantity::Angle)) => {}
                    Some(_) => return Err(wrong(format!("{name} is linear; a sum of rotary axes was expected"))),
                    None => return Err(wrong(format!("the chain has no axis {name}"))),
                }
                let place = functions.axes.iter().position(|axis| *axis == name).unwrap_or_else(|| {
                    functions.axes.push(name);
                    functions.axes.len() - 1
                });
                factors.push((place, sign));
            }
            let name = sum.chars().filter(|character| !character.is_whitespace()).collect();
            functions.bodies.push((name, factors));
        }
        Ok(vec![Box::new(functions)])
    }
}

/// Cosine and sine of the angle of each body.
#[derive(Debug, Clone, PartialEq)]
pub struct MomentsOfWeight {
    /// The axes whose commands are arguments.
    pub axes: Vec<String>,
    /// The bodies: name of the sum, and its axes by their indices, with signs.
    pub bodies: Vec<(String, Vec<(usize, f64)>)>,
}

impl Functions for MomentsOfWeight {
    fn arguments(&self) -> Vec<Argument> {
        self.axes.iter().cloned().map(Argument::CommandOf).collect()
    }

    fn terms(&self) -> Vec<Term> {
        let names = self.bodies.iter().flat_map(|(name, _)| [format!("[cos{name}]"), format!("[sin{name}]")]);
        names.map(|name| Term::new(name, 0)).collect()
    }

    fn values(&self, arguments: &[f64], out: &mut [f64]) {
        for (pair, (_, factors)) in out.chunks_exact_mut(2).zip(&self.bodies) {
            let (sin, cos) = factors.iter().map(|(axis, sign)| sign * arguments[*axis]).sum::<f64>().sin_cos();
            pair.copy_from_slice(&[cos, sin]);
        }
    }

    fn slopes(&self, by: usize, arguments: &[f64], out: &mut [f64]) {
        self.values(arguments, out);
        for (pair, (_, factors)) in out.chunks_exact_mut(2).zip(&self.bodies) {
            let slope: f64 = factors.iter().filter(|(axis, _)| *axis == by).map(|(_, sign)| sign).sum();
            let [cos, sin] = [pair[0], pair[1]];
            pair.copy_from_slice(&[-slope * sin, slope * cos]);
        }
    }

    fn in_c(&self, arguments: &[String]) -> Option<Vec<String>> {
        let angle = |factors: &[(usize, f64)]| -> Option<String> {
            let parts = factors.iter().map(|(axis, sign)| Some(format!("{sign:e} * {}", arguments.get(*axis)?)));
            Some(parts.collect::<Option<Vec<String>>>()?.join(" + "))
        };
        let of = |(_, factors): &(String, Vec<(usize, f64)>)| {
            let angle = angle(factors)?;
            Some([format!("cos({angle})"), format!("sin({angle})")])
        };
        Some(self.bodies.iter().map(of).collect::<Option<Vec<_>>>()?.concat())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::families::testing::{names, slopes_agree_by, values};

    fn arm() -> MomentsOfWeight {
        let axes = [("B1", Quantity::Angle), ("B2", Quantity::Angle), ("X", Quantity::Length)];
        let axes: Vec<(String, Quantity)> = axes.iter().map(|(name, of)| ((*name).to_owned(), *of)).collect();
        let subject = Subject {
            location: false,
            of: Quantity::Angle,
            command: Quantity::Angle,
            along: 0.0,
            range: None,
            axes: &axes,
            labels: &[],
        };
        let line = |angles: &[&str]| Gravity {
            gravity: vec!["EBB1".to_owned()],
            angles: angles.iter().map(|sum| (*sum).to_owned()).collect(),
        };
        let wrong = |angles: &[&str]| line(angles).functions(&subject).map(drop).unwrap_err().to_string();
        assert_eq!(wrong(&["B1+X"]), "angles[0]: X is linear; a sum of rotary axes was expected");
        assert_eq!(wrong(&["B1", "B4"]), "angles[1]: the chain has no axis B4");
        for sum in ["", "B1+", "B1++B2", "B1+B1", "+", "--B1"] {
            assert!(line(&[sum]).check().is_err(), "{sum}");
        }
        assert!(line(&["B1", "B1 "]).check().is_ok() && line(&["B1", "B1"]).check().is_err());
        assert_eq!(line(&["-B1 + B2"]).functions(&subject).unwrap()[0].terms()[0].suffix, "[cos-B1+B2]");
        let bodies = [("B1", vec![(0, 1.0)]), ("B1-B2", vec![(0, 1.0), (1, -1.0)])];
        MomentsOfWeight {
            axes: vec!["B1".to_owned(), "B2".to_owned()],
            bodies: bodies.map(|(name, factors)| (name.to_owned(), factors)).into(),
        }
    }

    #[test]
    fn values_and_names() {
        let arm = arm();
        assert_eq!(names(&arm), ["[cosB1]", "[sinB1]", "[cosB1-B2]", "[sinB1-B2]"]);
        let found = values(&arm, &[0.3, 0.5]);
        for (value, expected) in found.iter().zip([0.3_f64.cos(), 0.3_f64.sin(), 0.2_f64.cos(), -0.2_f64.sin()]) {
            assert!((value - expected).abs() < 1e-15, "{value} {expected}");
        }
    }

    proptest::proptest! {
        #[test]
        fn slopes_are_those_of_the_values(one in -4.0..4.0_f64, other in -4.0..4.0_f64, by in 0usize..2) {
            slopes_agree_by(&arm(), by, &[one, other], 1e-5, 1e-7);
        }
    }
}
