//! Likely causes of values that are larger than an error should be: numbers of the set-up that they look like.

use abbe_core::{Calibration, Problem, Quantity};
use serde_json::Value;

use crate::plausibility::LargeError;

/// A value looks like a number if it differs by less than this part.
const ALIKE: f64 = 0.02;

/// Least number of features that are off by the same amount.
const FEATURES: usize = 3;

/// Common deviation of features that is told, mm.
const COMMON: f64 = 0.5;

/// Features are off alike if their scatter is below this part of what they are off by.
const SCATTER: f64 = 0.2;

/// Sentences on large errors: what they are as large as, and on features that are off alike.
pub fn likely_causes(problem: &Problem, calibration: &Calibration, large: &[LargeError]) -> Vec<String> {
    let numbers = lengths(&problem.model.info().settings);
    let of_parameter = large.iter().filter_map(|large| {
        let is_tool = TOOL.contains(&large.unknown.name.as_str());
        let cause = match large.unknown.unit.of {
            Quantity::Length if is_tool => cause(large.size, &of_tool(&numbers)),
            Quantity::Length if TABLE.contains(&large.unknown.name.as_str()) => {
                cause(large.size, &of_table(problem, &large.unknown.name, &numbers))
            }
            Quantity::Length if large.unknown.unit.per.is_none() => cause(large.size, &numbers),
            _ => None,
        };
        match cause {
            Some(cause) => Some(format!("{} is {cause}", large.describe())),
            None if large.is_implausible() && is_tool => Some(format!(
                "{} is where the tip of the tool is beside its nominal place: look at `tool_length_mm` and `probe_offset_mm`, or at \
                 `tip_mm` of a robot",
                large.describe()
            )),
            None if large.is_implausible() => None,
            None => Some(format!("{} is large for such an error", large.describe())),
        }
    });
    of_parameter.chain(alike(problem, calibration, &numbers)).collect()
}

/// Errors of the set-up of the tool.
const TOOL: [&str; 3] = ["dxt", "dyt", "dzt"];

/// What a radius is of a diameter.
const HALF: f64 = 0.5;

/// The numbers that say where the tip is: all but those of axes and of joints before it.
fn of_tool(numbers: &[(String, f64)]) -> Vec<(String, f64)> {
    let is_of_tool = |(name, _): &&(String, f64)| !name.starts_with("axes.") && !name.contains(".dh");
    numbers.iter().filter(is_of_tool).cloned().collect()
}

/// Errors of where the artefacts stand on the table, in the order of x, y and z.
const TABLE: [&str; 3] = ["dxw", "dyw", "dzw"];

/// The numbers that say where features are: their nominal places along this direction, and those of settings that say nothing of the
/// tool.
fn of_table(problem: &Problem, name: &str, numbers: &[(String, f64)]) -> Vec<(String, f64)> {
    let is_of_tool = |name: &str| {
        name.starts_with("styli") || ["tool_length", "stylus", "probe", "tip_mm"].iter().any(|own| name.contains(own))
    };
    let direction = TABLE.iter().position(|own| *own == name).unwrap_or_default();
    let places = problem.sets.iter().flat_map(|set| {
        set.info().features.iter().map(move |feature| {
            let name = format!("nominal {} of {} in {}", ["x", "y", "z"][direction], feature.label, set.name);
            (name, feature.point[direction])
        })
    });
    let settings = numbers.iter().filter(|(name, _)| !is_of_tool(name)).cloned();
    places.filter(|(_, place)| *place != 0.0).chain(settings).collect()
}

/// Part of a length that is too much if mm were taken for inches, and how much better than the length itself it has to fit.
const TOO_MUCH: f64 = 1.0 - 1.0 / 25.4;
const PLAINER: f64 = 5.0;

/// What a length is as large as among the numbers of the set-up.
fn cause(size: f64, numbers: &[(String, f64)]) -> Option<String> {
    let ways = [
        (1.0, "as large as"),
        (2.0, "twice, as with a wrong sign of,"),
        (HALF, "half, as with a diameter for a radius in,"),
        (24.4, "what is missing if inches were taken for mm in"),
        (TOO_MUCH, "what is too much if mm were taken for inches in"),
    ];
    let mut best: Option<(f64, String)> = None;
    for (factor, way) in ways {
        for (name, number) in numbers {
            let may_be = factor != HALF || name.contains("radius");
            let off = (size.abs() / (number.abs() * factor) - 1.0).abs();
            // Hardly less than the number itself is that number, unless it fits far better.
            let off = if factor == TOO_MUCH { off * PLAINER } else { off };
            if may_be && off < ALIKE && best.as_ref().is_none_or(|(least, _)| off < *least) {
                best = Some((off, format!("{way} `{name}` ({number} mm)")));
            }
        }
    }
    best.map(|(_, words)| words)
}

/// The lengths of settings that are not zero, by the keys that lead to them.
fn lengths(settings: &Value) -> Vec<(String, f64)> {
    fn collect(value: &Value, path: &str, is_length: bool, found: &mut Vec<(String, f64)>) {
        match value {
            Value::Number(number) if is_length => {
                found.extend(number.as_f64().filter(|number| *number != 0.0).map(|number| (path.to_owned(), number)));
            }
            Value::Array(items) => items.iter().for_each(|item| collect(item, path, is_length, found)),
            Value::Object(items) => {
                items.iter().filter(|(key, _)| *key != "errors" && !key.starts_with("range")).for_each(|(key, item)| {
                    let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
                    collect(item, &path, key.ends_with("_mm"), found);
                })
            }
            _ => {}
        }
    }
    let mut found = Vec::new();
    collect(settings, "", false, &mut found);
    found
}

/// Features of one kind that are all off by the same length: what all of them have in common is wrong.
fn alike(problem: &Problem, calibration: &Calibration, numbers: &[(String, f64)]) -> Vec<String> {
    let mut sentences = Vec::new();
    for set in &problem.sets {
        let info = set.info();
        let mut kinds: Vec<&str> = info.unknowns.iter().filter_map(|own| kind(&own.name)).collect();
        kinds.sort_unstable();
        kinds.dedup();
        for wanted in kinds {
            let own = info.unknowns.iter().zip(&info.start).filter(|(own, _)| kind(&own.name) == Some(wanted));
            let own = own.filter(|(own, _)| own.unit.of == Quantity::Length && own.unit.per.is_none());
            let found = own.filter_map(|(own, start)| {
                Some((own.name.as_str(), calibration.get(&format!("{}.{}", set.name, own.name))?.value - start))
            });
            let (names, off): (Vec<&str>, Vec<f64>) = found.unzip();
            sentences.extend(apart(&set.name, &names, &off));
            let count = off.len() as f64;
            let mean = off.iter().sum::<f64>() / count.max(1.0);
            let scatter = (off.iter().map(|off| (off - mean).powi(2)).sum::<f64>() / count.max(1.0)).sqrt();
            if off.len() < FEATURES || mean.abs() < COMMON || scatter > SCATTER * mean.abs() {
                continue;
            }
            let inputs = info.inputs.iter().map(|input| (input.parameter.name.clone(), input.value));
            let known: Vec<(String, f64)> =
                numbers.iter().cloned().chain(inputs.filter(|(_, value)| *value != 0.0)).collect();
            let why = cause(mean, &known).map_or_else(String::new, |cause| format!(", which is {cause}"));
            sentences.push(format!(
                "all {} `{}.*.{wanted}` are off by about {mean:.3} mm{why}: the radius of the stylus, or the place of the artefact, may be wrong",
                off.len(),
                set.name
            ));
        }
    }
    sentences
}

/// Distance from all others of a feature that is told, mm, and in units of their median distance from each other's median.
const APART: f64 = 1.0;
const SPREADS_APART: f64 = 20.0;

/// Distance from its nominal place of one of few features that is told, mm.
const ONE_OF_FEW: f64 = 3.0;

/// Features that are off by much more than most of their kind; of few features, those that are far off.
fn apart(set: &str, names: &[&str], off: &[f64]) -> Option<String> {
    let middle = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied()
    };
    let are_few = off.len() <= 2 * FEATURES;
    let median = if are_few { 0.0 } else { middle(off.to_vec())? };
    let far: Vec<f64> = off.iter().map(|off| (off - median).abs()).collect();
    let limit = if are_few { ONE_OF_FEW } else { APART.max(SPREADS_APART * middle(far.clone())?) };
    let found: Vec<String> = (names.iter().zip(off).zip(&far))
        .filter(|(_, far)| **far > limit)
        .map(|((name, off), _)| format!("`{set}.{name}` is off by {off:.3} mm"))
        .collect();
    let told = found.iter().take(FEATURES).cloned().collect::<Vec<_>>().join(", ");
    let more = if found.len() > FEATURES { format!(" and {} more", found.len() - FEATURES) } else { String::new() };
    let others = if are_few { "" } else { ", the others are not" };
    (!found.is_empty()).then(|| format!("{told}{more}{others}: nominal places or normals may be wrong"))
}

/// The last part of the name of a feature's unknown: `d` of `facet[7].d`.
fn kind(name: &str) -> Option<&str> {
    name.rsplit_once("].").map(|(_, kind)| kind)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A length that is twice a place to the micrometre is not as large as a length that is 1 % beside it.
    #[test]
    fn the_number_that_is_nearest_is_named() {
        let numbers = [("styli.3.tip_mm".to_owned(), -300.0), ("nominal x of 1 in sphere".to_owned(), -148.0)];
        let expected = "twice, as with a wrong sign of, `nominal x of 1 in sphere` (-148 mm)";
        assert_eq!(cause(296.01, &numbers).as_deref(), Some(expected));
        assert_eq!(cause(-301.0, &numbers).as_deref(), Some("as large as `styli.3.tip_mm` (-300 mm)"));
        assert_eq!(cause(250.0, &numbers), None);
    }
}
