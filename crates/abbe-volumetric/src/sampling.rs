//! Points along axes: ranges from settings or from the machine, and what settings call a position.

use std::collections::BTreeMap;

use abbe_core::{Axis, AxisKind, Error, KinematicModel, PathItem, Quantity, Result, SettingsError};
use schemars::JsonSchema;
use serde::Deserialize;

/// The range of an axis, in the unit that its name says.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Range {
    /// First position of a linear axis.
    #[serde(default)]
    pub from_mm: Option<f64>,
    /// Last position of a linear axis.
    #[serde(default)]
    pub to_mm: Option<f64>,
    /// First position of a rotary axis.
    #[serde(default)]
    pub from_deg: Option<f64>,
    /// Last position of a rotary axis.
    #[serde(default)]
    pub to_deg: Option<f64>,
}

/// Ranges by the name of the axis.
pub type Ranges = BTreeMap<String, Range>;

/// Distances of points along linear and rotary axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Steps {
    /// Of linear axes.
    pub mm: f64,
    /// Of rotary axes.
    pub deg: f64,
}

/// No axis goes farther, mm and degrees.
const LARGEST_STEP: f64 = 1e6;

impl Steps {
    /// Refuses steps that are wrong for every axis.
    pub fn check(self) -> Result<(), SettingsError> {
        for (setting, step) in [("step_mm", self.mm), ("step_deg", self.deg)] {
            if !(step > 0.0 && step <= LARGEST_STEP) {
                return Err(SettingsError::new(
                    setting,
                    format!("a positive number, at most {LARGEST_STEP}, was expected"),
                ));
            }
        }
        Ok(())
    }
}

/// Refuses ranges that are wrong for every axis. `setting` is the name of the ranges in messages.
pub fn check_ranges(ranges: &Ranges, setting: &str) -> Result<(), SettingsError> {
    for (name, range) in ranges {
        let message = match (range.from_mm.zip(range.to_mm), range.from_deg.zip(range.to_deg)) {
            (Some((from, to)), None) if range.from_deg.or(range.to_deg).is_none() => increasing(from, to),
            (None, Some((from, to))) if range.from_mm.or(range.to_mm).is_none() => increasing(from, to),
            _ => Some("`from_mm` and `to_mm`, or `from_deg` and `to_deg`, were expected"),
        };
        if let Some(message) = message {
            return Err(SettingsError::new(name, message).under([PathItem::Key(setting.to_owned())]));
        }
    }
    Ok(())
}

/// No axis goes farther, mm and degrees.
const FARTHEST: f64 = 1e6;

fn increasing(from: f64, to: f64) -> Option<&'static str> {
    match from.abs() <= FARTHEST && to.abs() <= FARTHEST {
        false => Some("no axis goes farther than 1000000 mm or degrees"),
        true => (from >= to).then_some("the range has to end beyond its start"),
    }
}

/// The unit of positions in files: its suffix, and how many of it make one in memory.
pub fn position_unit(axis: &Axis) -> (&'static str, f64) {
    match axis.kind {
        AxisKind::Linear => ("mm", 1.0),
        AxisKind::Rotary => ("deg", 180.0 / std::f64::consts::PI),
    }
}

/// The error with its setting inside another one.
pub fn within(mut error: Error, outer: &[&str]) -> Error {
    error.setting.splice(0..0, outer.iter().map(|key| PathItem::Key((*key).to_owned())));
    error
}

/// Places of axes by their index, mm or rad, from a setting like `{ X_mm: 100 }`.
///
/// Fails for an axis that the machine does not have, and for a unit that is not that of its kind.
pub fn places(list: &BTreeMap<String, f64>, setting: &str, model: &dyn KinematicModel) -> Result<BTreeMap<usize, f64>> {
    let axes = &model.info().axes;
    let place = |(column, value): (&String, &f64)| {
        let at = |error: Error| within(error, &[setting, column]);
        let (name, quantity, factor) = Quantity::of_column(column);
        let found = axis_of(model, name).map_err(at)?;
        let expected = match found.kind {
            AxisKind::Linear => Quantity::Length,
            AxisKind::Rotary => Quantity::Angle,
        };
        match quantity == expected {
            true => Ok((axes.iter().position(|axis| axis.name == name).unwrap_or_default(), value * factor)),
            false => Err(at(Error::usage(format!("`{name}{}` was expected", expected.usual_suffix())))),
        }
    };
    list.iter().map(place).collect()
}

/// The axis of that name; refuses one that the machine does not have.
pub(crate) fn axis_of<'a>(model: &'a dyn KinematicModel, name: &str) -> Result<&'a Axis> {
    let names = || model.info().axes.iter().map(|axis| axis.name.as_str());
    model
        .info()
        .axes
        .iter()
        .find(|axis| axis.name == name)
        .ok_or_else(|| Error::usage(format!("the machine has no axis {name}")).suggest(name, names()))
}

/// Refuses ranges of axes that the machine does not have.
pub fn check_axes(ranges: &Ranges, setting: &str, model: &dyn KinematicModel) -> Result<()> {
    for name in ranges.keys() {
        axis_of(model, name).map_err(|error| within(error, &[setting, name]))?;
    }
    Ok(())
}

/// Refuses positions, in mm or deg, that are beyond the travel of an axis ([`Axis::reach`]).
pub(crate) fn check_travel(axis: &Axis, from: f64, to: f64) -> Result<()> {
    let (unit, factor) = position_unit(axis);
    let (Some(reach), Some(range)) = (axis.reach(), axis.range) else { return Ok(()) };
    if from >= reach[0] * factor && to <= reach[1] * factor {
        return Ok(());
    }
    let [first, last] = range.map(|end| rounded_position(end * factor));
    let asked = if from == to { format!("at {from} {unit}") } else { format!("from {from} to {to} {unit}") };
    let message = format!("{} {asked} is beyond its travel of {first} to {last} {unit}", axis.name);
    Err(Error::usage(message).help("nothing was measured there; if the machine goes there, widen its range"))
}

/// The range of an axis in mm or deg: given under `setting`, or that of the machine; one of them has to be known.
pub fn range_of(axis: &Axis, ranges: &Ranges, setting: &str) -> Result<(f64, f64)> {
    let (unit, factor) = position_unit(axis);
    let name = &axis.name;
    if let Some(range) = ranges.get(name) {
        let (given, kind) = match axis.kind {
            AxisKind::Linear => (range.from_mm.zip(range.to_mm), "a linear axis"),
            AxisKind::Rotary => (range.from_deg.zip(range.to_deg), "a rotary axis"),
        };
        let (from, to) = given.ok_or_else(|| {
            let message = format!("{name} is {kind}: `from_{unit}` and `to_{unit}` were expected");
            within(Error::usage(message), &[setting, name])
        })?;
        check_travel(axis, from, to).map_err(|error| within(error, &[setting, name]))?;
        return Ok((from, to));
    }
    let of_axis = axis.range.map(|[from, to]| (rounded_position(from * factor), rounded_position(to * factor)));
    of_axis.ok_or_else(|| {
        Error::usage(format!("the range of axis {name} is not known"))
            .help(format!(
                "write `{setting}: {{ {name}: {{ from_{unit}: .., to_{unit}: .. }} }}` here, or `range_{unit}` into \
                 the machine description"
            ))
            .setting(setting)
    })
}

/// Points along an axis, mm or deg: the start of its range, one every step, and the end of its range; at most `most`.
pub fn points_every(axis: &Axis, (from, to): (f64, f64), steps: Steps, most: usize) -> Result<Vec<f64>> {
    let (unit, _) = position_unit(axis);
    let name = &axis.name;
    let (setting, step) = match axis.kind {
        AxisKind::Linear => ("step_mm", steps.mm),
        AxisKind::Rotary => ("step_deg", steps.deg),
    };
    // A last interval that is only rounding is left out.
    let intervals = ((to - from) / step - 1e-9).ceil().max(1.0);
    if intervals.is_nan() || intervals >= most as f64 {
        return Err(Error::usage(format!(
            "axis {name} from {from} to {to} {unit} every {step} {unit} has {} points; at most {most} fit",
            intervals + 1.0
        ))
        .help(format!("{} {unit} is the smallest step that fits", step_that_fits(to - from, most - 1)))
        .setting(setting));
    }
    let count = intervals as usize;
    Ok((0..=count)
        .map(|index| if index == count { to } else { rounded_position(from + index as f64 * step) })
        .collect())
}

/// The smallest step of three digits that makes no more than `intervals` of a range.
fn step_that_fits(range: f64, intervals: usize) -> f64 {
    let exact = range / intervals as f64;
    let digit = 10_f64.powf(exact.log10().floor() - 2.0);
    rounded_position((exact / digit - 1e-9).ceil() * digit)
}

/// Removes the rounding of conversions from radians and of sums of steps, beyond the ninth decimal.
pub fn rounded_position(position: f64) -> f64 {
    let rounded = (position * 1e9).round() / 1e9;
    if rounded.is_finite() { rounded + 0.0 } else { position }
}

#[cfg(test)]
mod tests {
    use super::*;
    use abbe_core::{Branch, path_text};
    use serde_json::json;

    fn axis(kind: AxisKind, range: Option<[f64; 2]>) -> Axis {
        let name = if kind == AxisKind::Linear { "X" } else { "B" }.to_owned();
        let branch = Branch::Tool;
        Axis {
            name,
            kind,
            branch,
            sense: 1.0,
            direction: [1.0, 0.0, 0.0],
            range,
            indexed: false,
            endless: false,
            status: 0,
        }
    }

    fn sampled(axis: &Axis, ranges: serde_json::Value, mm: f64, most: usize) -> Result<Vec<f64>, String> {
        let ranges: Ranges = serde_json::from_value(ranges).unwrap();
        range_of(axis, &ranges, "ranges")
            .and_then(|range| points_every(axis, range, Steps { mm, deg: 10.0 }, most))
            .map_err(|error| format!("{}: {error}", path_text(&error.setting)))
    }

    #[test]
    fn both_ends_are_points() {
        let (linear, rotary) = (axis(AxisKind::Linear, Some([-100.0, 100.0])), axis(AxisKind::Rotary, None));
        let cases = [
            (&linear, json!({}), 50.0, vec![-100.0, -50.0, 0.0, 50.0, 100.0]),
            (&linear, json!({}), 80.0, vec![-100.0, -20.0, 60.0, 100.0]),
            (&linear, json!({}), 1e3, vec![-100.0, 100.0]),
            (&linear, json!({ "X": { "from_mm": 0.1, "to_mm": 0.4 } }), 0.1, vec![0.1, 0.2, 0.3, 0.4]),
            (&rotary, json!({ "B": { "from_deg": -5, "to_deg": 20 } }), 50.0, vec![-5.0, 5.0, 15.0, 20.0]),
        ];
        for (axis, ranges, step, expected) in cases {
            assert_eq!(sampled(axis, ranges, step, 256).unwrap(), expected);
        }
    }

    #[test]
    fn what_cannot_be_sampled_is_refused() {
        let linear = axis(AxisKind::Linear, Some([-100.0, 100.0]));
        assert_eq!(
            sampled(&linear, json!({ "X": { "from_deg": 0, "to_deg": 1 } }), 1.0, 256).unwrap_err(),
            "ranges.X: X is a linear axis: `from_mm` and `to_mm` were expected"
        );
        assert_eq!(
            sampled(&linear, json!({}), 0.5, 256).unwrap_err(),
            "step_mm: axis X from -100 to 100 mm every 0.5 mm has 401 points; at most 256 fit (0.785 mm is the smallest \
             step that fits)"
        );
        assert_eq!(sampled(&linear, json!({}), 0.785, 256).unwrap().len(), 256);
        assert_eq!(
            sampled(&axis(AxisKind::Linear, None), json!({}), 1.0, 256).unwrap_err(),
            "ranges: the range of axis X is not known (write `ranges: { X: { from_mm: .., to_mm: .. } }` here, or \
             `range_mm` into the machine description)"
        );
    }

    #[test]
    fn settings_that_no_axis_can_make_right() {
        let both = "`from_mm` and `to_mm`, or `from_deg` and `to_deg`, were expected";
        let cases = [
            (json!({ "X": { "from_mm": 1 } }), both),
            (json!({ "X": { "from_mm": 1, "to_mm": 2, "to_deg": 3 } }), both),
            (json!({ "X": { "from_mm": 2, "to_mm": 2 } }), "the range has to end beyond its start"),
        ];
        for (ranges, expected) in cases {
            let ranges: Ranges = serde_json::from_value(ranges).unwrap();
            assert_eq!(check_ranges(&ranges, "ranges").unwrap_err().to_string(), format!("ranges.X: {expected}"));
        }
        assert_eq!(
            Steps { mm: 0.0, deg: 1.0 }.check().unwrap_err().to_string(),
            "step_mm: a positive number, at most 1000000, was expected"
        );
    }
}
