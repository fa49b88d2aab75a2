//! Reads compensation lists of ISG and Beckhoff.

use std::collections::BTreeMap;
use std::path::Path;

use abbe_compensation::AxisTable;
use abbe_compensation::active::{Believed, is_of_axis};
use abbe_core::{Error, KinematicModel, Result};
use abbe_volumetric::position_unit;

use crate::existing::{Placed, text, wrong};
use crate::isg::SCALE;

/// No list has more points.
const MOST: f64 = 10_000.0;

/// Refuses a line of the head that names another axis.
fn check_head(
    (name, value): (&str, &str),
    path: &Path,
    line: usize,
    output: usize,
    numbered: &dyn Fn(u16) -> Option<usize>,
    model: &dyn KinematicModel,
) -> Result<()> {
    let axes = &model.info().axes;
    let named = match name {
        "kopf.log_achs_name" => Some(value),
        "kopf.log_achs_nr" => value.parse().ok().and_then(numbered).map(|axis| axes[axis].name.as_str()),
        _ => None,
    };
    named
        .map_or(Ok(()), |named| is_of_axis(&axes[output], named, axes, path, line + 1))
        .map_err(|error| error.setting("existing"))
}

/// The tables of the list of an axis, values in mm and rad. `numbered` is the index of the axis of a number.
pub fn read(
    path: &Path,
    output: usize,
    numbered: &dyn Fn(u16) -> Option<usize>,
    model: &dyn KinematicModel,
    believed: &Believed<'_>,
) -> Result<Vec<AxisTable>> {
    let mut entries: BTreeMap<String, f64> = BTreeMap::new();
    let mut lines: BTreeMap<String, usize> = BTreeMap::new();
    for (line, text) in text(path)?.lines().enumerate() {
        let mut words = text.split_whitespace();
        let Some(name) = words.next() else { continue };
        if !name.starts_with("kw.") {
            check_head((name, words.next().unwrap_or_default()), path, line, output, numbered, model)?;
            continue;
        }
        let value = words.next().and_then(|value| value.parse().ok()).filter(|value: &f64| value.is_finite());
        let value = value.ok_or_else(|| wrong(path, line, format!("a number was expected after `{name}`")))?;
        entries.insert(name.to_owned(), value);
        lines.insert(name.to_owned(), line);
    }
    let fails = |message: String| Error::data(message).in_file(path).setting("existing");
    let entry = |name: &str| entries.get(name).copied();
    let needed = |name: String| entry(&name).ok_or_else(|| fails(format!("`{name}` is missing")));
    let mut tables = Vec::new();
    for (list, columns) in [("kw.ssfk", ["pos", "neg"]), ("kw.crosscomp", ["correction", "correction"])] {
        let has = entries.keys().any(|name| name.strip_prefix(list).is_some_and(|rest| rest.starts_with('.')));
        if !has {
            continue;
        }
        if entry(&format!("{list}.unit")) != Some(1.0) {
            return Err(fails(format!("`{list}.unit 1` was expected: positions in 0.1 µm")));
        }
        let is_screw = list == "kw.ssfk";
        let input = match is_screw {
            true => output,
            false => {
                let number = needed(format!("{list}.master_ax_nr"))?;
                let whole = (number.fract() == 0.0 && (0.0..65_536.0).contains(&number)).then_some(number as u16);
                whole.and_then(numbered).ok_or_else(|| fails(format!("`axis_numbers` does not name axis {number}")))?
            }
        };
        let count = match is_screw {
            true => needed(format!("{list}.kw_nr_max"))?,
            false => needed(format!("{list}.last_index"))? + 1.0,
        };
        if count.fract() != 0.0 || !(1.0..=MOST).contains(&count) {
            return Err(fails(format!("`{list}` has {count} points; a whole number from 1 to {MOST} was expected")));
        }
        let columns = if is_screw && entry("kw.ssfk.bilateral") != Some(1.0) { ["pos", "pos"] } else { columns };
        let interval = entry(&format!("{list}.interval")).filter(|interval| *interval != 0.0);
        let axes = &model.info().axes;
        let (along, of) = (position_unit(&axes[input]).1 * SCALE, position_unit(&axes[output]).1 * SCALE);
        let points = 0..count as usize;
        let value = |index: usize, column: &str| needed(format!("{list}.table[{index}].{column}"));
        let place = |index: usize| match interval {
            Some(interval) => Ok((needed(format!("{list}.kw_startpos"))? + index as f64 * interval) / along),
            None => value(index, "setpoint").map(|place| place / along),
        };
        let column = |name: &str| {
            points.clone().map(|index| value(index, name).map(|value| value / of)).collect::<Result<Vec<f64>>>()
        };
        let lines_of = |name: &str| -> Vec<usize> {
            let line = |index| lines.get(&format!("{list}.table[{index}].{name}")).copied().unwrap_or_default();
            points.clone().map(line).collect()
        };
        let places = [lines_of(columns[0]), lines_of(columns[1])];
        let table = AxisTable {
            input,
            output,
            positions: points.clone().map(place).collect::<Result<_>>()?,
            forward: column(columns[0])?,
            reverse: column(columns[1])?,
            repeats: is_screw && entry("kw.ssfk.modulo") == Some(1.0),
        };
        Placed { table: &table, lines: [&places[0], &places[1]] }.check(believed, path, model)?;
        tables.push(table);
    }
    match tables.is_empty() {
        true => Err(fails("it has neither `kw.ssfk` nor `kw.crosscomp`".to_owned())),
        false => Ok(tables),
    }
}
