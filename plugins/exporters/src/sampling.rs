//! What exporters share: the range of an axis, points along it, motion errors at them.

use std::collections::BTreeMap;

use abbe_core::{
    Absent, Axis, AxisKind, Calibration, Error, ErrorFunction, KinematicModel, PathItem, Result, SettingsError,
};
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

/// Refuses ranges and steps that no axis can make right.
pub fn check(ranges: &Ranges, steps: Steps) -> Result<(), SettingsError> {
    for (setting, step) in [("step_mm", steps.mm), ("step_deg", steps.deg)] {
        if !(step.is_finite() && step > 0.0) {
            return Err(SettingsError::new(setting, "a positive number was expected"));
        }
    }
    for (name, range) in ranges {
        let message = match (range.from_mm.zip(range.to_mm), range.from_deg.zip(range.to_deg)) {
            (Some((from, to)), None) if range.from_deg.or(range.to_deg).is_none() => increasing(from, to),
            (None, Some((from, to))) if range.from_mm.or(range.to_mm).is_none() => increasing(from, to),
            _ => Some("`from_mm` and `to_mm`, or `from_deg` and `to_deg`, were expected"),
        };
        if let Some(message) = message {
            return Err(SettingsError::new(name, message).under([PathItem::Key("ranges".to_owned())]));
        }
    }
    Ok(())
}

fn increasing(from: f64, to: f64) -> Option<&'static str> {
    (!(from.is_finite() && to.is_finite() && from < to)).then_some("the range has to end beyond its start")
}

/// The unit of positions in files: its suffix, and how many of it make one in memory.
pub fn position_unit(axis: &Axis) -> (&'static str, f64) {
    match axis.kind {
        AxisKind::Linear => ("mm", 1.0),
        AxisKind::Rotary => ("deg", 180.0 / std::f64::consts::PI),
    }
}

/// Refuses ranges of axes that the machine does not have.
pub fn check_axes(ranges: &Ranges, model: &dyn KinematicModel) -> Result<()> {
    for name in ranges.keys() {
        if !model.axes().iter().any(|axis| axis.name == *name) {
            let names = model.axes().iter().map(|axis| axis.name.as_str());
            let mut error = Error::usage(format!("the machine has no axis {name}")).suggest(name, names);
            error.setting = vec![PathItem::Key("ranges".to_owned()), PathItem::Key(name.clone())];
            return Err(error);
        }
    }
    Ok(())
}

/// Points along an axis, mm or deg: the start of its range, one every step, and the end of its range.
pub fn points(axis: &Axis, ranges: &Ranges, steps: Steps, most: usize) -> Result<Vec<f64>> {
    let (unit, factor) = position_unit(axis);
    let name = &axis.name;
    let given = match ranges.get(name) {
        None => None,
        Some(range) => {
            let (given, wrong) = match axis.kind {
                AxisKind::Linear => (range.from_mm.zip(range.to_mm), "a linear axis"),
                AxisKind::Rotary => (range.from_deg.zip(range.to_deg), "a rotary axis"),
            };
            let Some(given) = given else {
                let message = format!("{name} is {wrong}: `from_{unit}` and `to_{unit}` were expected");
                let mut error = Error::usage(message);
                error.setting = vec![PathItem::Key("ranges".to_owned()), PathItem::Key(name.clone())];
                return Err(error);
            };
            Some(given)
        }
    };
    let of_axis = axis.range.map(|[from, to]| (tidy(from * factor), tidy(to * factor)));
    let Some((from, to)) = given.or(of_axis) else {
        return Err(Error::usage(format!("the range of axis {name} is not known"))
            .help(format!(
                "write `ranges: {{ {name}: {{ from_{unit}: .., to_{unit}: .. }} }}` here, or `range_{unit}` into the \
                 machine description"
            ))
            .setting("ranges"));
    };
    let (setting, step) = match axis.kind {
        AxisKind::Linear => ("step_mm", steps.mm),
        AxisKind::Rotary => ("step_deg", steps.deg),
    };
    // A last interval of nothing but rounding is none.
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
    Ok((0..=count).map(|index| if index == count { to } else { tidy(from + index as f64 * step) }).collect())
}

/// The smallest step of three digits that makes no more than `intervals` of a range.
fn step_that_fits(range: f64, intervals: usize) -> f64 {
    let exact = range / intervals as f64;
    let digit = 10_f64.powf(exact.log10().floor() - 2.0);
    tidy((exact / digit - 1e-9).ceil() * digit)
}

/// Takes away what conversion from radians and sums of steps leave behind the ninth decimal.
fn tidy(position: f64) -> f64 {
    let rounded = (position * 1e9).round() / 1e9;
    if rounded.is_finite() { rounded + 0.0 } else { position }
}

/// The status of an axis at a position (in memory's unit), approached in a direction; everything else as if the data did
/// not mention it, other axes at zero.
pub fn status(model: &dyn KinematicModel, axis: &Axis, position: f64, direction: f64) -> Vec<f64> {
    let flag = format!("dir_{}", axis.name);
    let columns = model.status().iter().enumerate();
    columns
        .map(|(index, column)| match column.absent {
            _ if index == axis.status => position,
            _ if column.name == flag => direction,
            _ if model.axes().iter().any(|other| other.status == index) => 0.0,
            Absent::Taken(value) => value,
            Absent::Refused => 0.0,
        })
        .collect()
}

/// The values of a calibration in the order of the model's parameters, with the row of each in the covariance.
pub struct Values<'a> {
    values: Vec<f64>,
    covariance: &'a [Vec<f64>],
    rows: Vec<Option<usize>>,
}

impl<'a> Values<'a> {
    /// The values for a model.
    pub fn new(calibration: &'a Calibration, model: &dyn KinematicModel) -> Self {
        let known: BTreeMap<&str, f64> =
            calibration.parameters.iter().map(|parameter| (parameter.name.as_str(), parameter.value)).collect();
        let order: BTreeMap<&str, usize> =
            calibration.covariance.order.iter().enumerate().map(|(row, name)| (name.as_str(), row)).collect();
        let parameters = model.parameters().iter().map(|parameter| parameter.name.as_str());
        Self {
            values: parameters.clone().map(|name| known.get(name).copied().unwrap_or(0.0)).collect(),
            covariance: &calibration.covariance.rows,
            rows: parameters.map(|name| order.get(name).copied()).collect(),
        }
    }

    /// The value of a motion error at a status.
    pub fn value(&self, model: &dyn KinematicModel, function: &ErrorFunction, status: &[f64]) -> f64 {
        model.error_terms(function, status).iter().map(|&(parameter, factor)| factor * self.values[parameter]).sum()
    }

    /// Its standard uncertainty; parameters that were not estimated have none.
    pub fn standard_uncertainty(&self, model: &dyn KinematicModel, function: &ErrorFunction, status: &[f64]) -> f64 {
        let terms = model.error_terms(function, status);
        let terms: Vec<(usize, f64)> =
            terms.iter().filter_map(|&(parameter, factor)| Some((self.rows[parameter]?, factor))).collect();
        let mut variance = 0.0;
        for (row, a) in &terms {
            for (column, b) in &terms {
                variance += a * b * self.covariance[*row][*column];
            }
        }
        variance.max(0.0).sqrt()
    }
}

/// A number with six decimals, without a minus sign before zero.
pub fn fixed(value: f64) -> String {
    let text = format!("{value:.6}");
    match text.strip_prefix('-') {
        Some(digits) if digits.bytes().all(|byte| matches!(byte, b'0' | b'.')) => digits.to_owned(),
        _ => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{chain, key_error};
    use serde_json::json;

    fn sampled(settings: &Ranges, mm: f64, most: usize) -> Result<Vec<f64>> {
        let model = chain("w B' b X Y Z t", json!({ "X": { "range_mm": [-100, 100] } }), json!([]));
        let find = |name: &str| model.axes().iter().find(|axis| axis.name == name).unwrap();
        check_axes(settings, model.as_ref())?;
        points(find("X"), settings, Steps { mm, deg: 10.0 }, most)?;
        if settings.contains_key("B") {
            points(find("B"), settings, Steps { mm, deg: 10.0 }, most)
        } else {
            points(find("X"), settings, Steps { mm, deg: 10.0 }, most)
        }
    }

    fn ranges(value: serde_json::Value) -> Ranges {
        serde_json::from_value(value).unwrap()
    }

    #[test]
    fn both_ends_are_points() {
        let cases = [
            (json!({}), 50.0, vec![-100.0, -50.0, 0.0, 50.0, 100.0]),
            (json!({}), 80.0, vec![-100.0, -20.0, 60.0, 100.0]),
            (json!({}), 1e3, vec![-100.0, 100.0]),
            (json!({ "X": { "from_mm": 0.1, "to_mm": 0.4 } }), 0.1, vec![0.1, 0.2, 0.3, 0.4]),
            (json!({ "B": { "from_deg": -5, "to_deg": 20 } }), 50.0, vec![-5.0, 5.0, 15.0, 20.0]),
        ];
        for (settings, step, expected) in cases {
            assert_eq!(sampled(&ranges(settings), step, 256).unwrap(), expected);
        }
    }

    #[test]
    fn what_cannot_be_sampled_is_refused() {
        let cases = [
            (json!({ "V": { "from_mm": 0, "to_mm": 1 } }), 1.0, "ranges.V: the machine has no axis V"),
            (
                json!({ "X": { "from_deg": 0, "to_deg": 1 } }),
                1.0,
                "ranges.X: X is a linear axis: `from_mm` and `to_mm` were expected",
            ),
            (
                json!({}),
                0.5,
                "step_mm: axis X from -100 to 100 mm every 0.5 mm has 401 points; at most 256 fit (0.785 mm is the \
                 smallest step that fits)",
            ),
        ];
        for (settings, step, expected) in cases {
            assert_eq!(key_error(sampled(&ranges(settings), step, 256)), expected);
        }
        assert_eq!(sampled(&Ranges::new(), 0.785, 256).unwrap().len(), 256);
        let model = chain("w b X t", json!({}), json!([]));
        assert_eq!(
            key_error(points(&model.axes()[0], &Ranges::new(), Steps { mm: 1.0, deg: 1.0 }, 256)),
            "ranges: the range of axis X is not known (write `ranges: { X: { from_mm: .., to_mm: .. } }` here, or \
             `range_mm` into the machine description)"
        );
    }

    #[test]
    fn settings_that_no_axis_can_make_right() {
        let both = "`from_mm` and `to_mm`, or `from_deg` and `to_deg`, were expected";
        let cases = [
            (json!({ "X": { "from_mm": 1 } }), 1.0, format!("ranges.X: {both}")),
            (json!({ "X": { "from_mm": 1, "to_mm": 2, "to_deg": 3 } }), 1.0, format!("ranges.X: {both}")),
            (
                json!({ "X": { "from_mm": 2, "to_mm": 2 } }),
                1.0,
                "ranges.X: the range has to end beyond its start".into(),
            ),
            (json!({}), 0.0, "step_mm: a positive number was expected".into()),
        ];
        for (settings, mm, expected) in cases {
            assert_eq!(check(&ranges(settings), Steps { mm, deg: 1.0 }).unwrap_err().to_string(), expected);
        }
    }

    #[test]
    fn zero_has_no_sign() {
        assert_eq!([fixed(-1e-9), fixed(-1.5), fixed(0.0)], ["0.000000", "-1.500000", "0.000000"]);
    }
}
