//! Reads tables of SINUMERIK: `$AA_ENC_COMP` and `$AN_CEC`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use abbe_compensation::AxisTable;
use abbe_compensation::active::Believed;
use abbe_core::{Error, KinematicModel, Result};
use abbe_volumetric::position_unit;

use crate::existing::{Placed, text, wrong};

/// Tables as they stand in files, values in mm and rad.
#[derive(Debug, Default)]
pub struct Tables {
    /// `$AA_ENC_COMP`.
    pub encoder: Vec<AxisTable>,
    /// `$AN_CEC`.
    pub sag: Vec<AxisTable>,
    /// Each table by itself, with the file where it stands.
    pub read: Vec<(PathBuf, AxisTable)>,
}

/// One table of a file: variables by name, values by point.
#[derive(Debug, Default)]
struct Raw {
    line: usize,
    numbers: BTreeMap<String, f64>,
    axes: BTreeMap<String, String>,
    /// With their lines.
    values: BTreeMap<usize, (usize, f64)>,
}

/// Adds the tables of a file. `machine_axis` is the index of a machine axis by its name in the control; encoder tables are those of one
/// encoder.
pub fn read(
    path: &Path,
    encoder: u8,
    machine_axis: &dyn Fn(&str) -> Option<usize>,
    model: &dyn KinematicModel,
    believed: &Believed<'_>,
    found: &mut Tables,
) -> Result<()> {
    // Encoder tables by encoder and axis, the others by their index.
    let mut raw: BTreeMap<(bool, String), Raw> = BTreeMap::new();
    let before = found.read.len();
    for (line, text) in text(path)?.lines().enumerate() {
        let text = text.split(';').next().unwrap_or_default().trim();
        let Some((name, value)) = text.split_once('=').filter(|_| text.starts_with('$')) else { continue };
        let fails = || wrong(path, line, format!("`{text}` is no line of a compensation table"));
        let (name, indices) = name.trim().trim_end_matches(']').split_once('[').ok_or_else(fails)?;
        let indices: Vec<&str> = indices.split(',').map(str::trim).collect();
        let is_encoder = name.starts_with("$AA_ENC_COMP");
        let Some(variable) = name.strip_prefix("$AA_ENC_COMP").or_else(|| name.strip_prefix("$AN_CEC")) else {
            continue;
        };
        let (table, point) = match (is_encoder, indices.as_slice()) {
            (true, [encoder, point, axis]) => (format!("{encoder},{axis}"), Some(*point)),
            (true, [encoder, axis]) => (format!("{encoder},{axis}"), None),
            (false, [table, point]) => ((*table).to_owned(), Some(*point)),
            (false, [table]) => ((*table).to_owned(), None),
            _ => return Err(fails()),
        };
        let own = raw.entry((is_encoder, table)).or_insert_with(|| Raw { line, ..Raw::default() });
        let value = value.trim().trim_matches(|bracket| matches!(bracket, '(' | ')' | '"')).trim();
        if variable.ends_with("_AXIS") {
            own.axes.insert(variable.to_owned(), value.to_owned());
            continue;
        }
        let value: f64 = value.parse().ok().filter(|value: &f64| value.is_finite()).ok_or_else(fails)?;
        match point {
            Some(point) => drop(own.values.insert(point.parse().map_err(|_| fails())?, (line, value))),
            None => drop(own.numbers.insert(variable.to_owned(), value)),
        }
    }
    if raw.is_empty() {
        return Err(Error::data("it has no `$AA_ENC_COMP` and no `$AN_CEC`").in_file(path).setting("existing"));
    }
    for ((is_encoder, name), raw) in raw {
        if let Some(other) = name.split_once(',').map(|(index, _)| index).filter(|index| *index != encoder.to_string())
        {
            let message =
                format!("this is a table of encoder {other}, and `encoder` is {encoder}: leave out what is not active");
            return Err(wrong(path, raw.line, message));
        }
        let axis = name.split_once(',').map(|(_, axis)| axis.to_owned());
        let fails = |message: String| wrong(path, raw.line, message);
        let axis_of = |variable: &str| {
            let named = axis.as_ref().or_else(|| raw.axes.get(variable));
            let of_table = || fails(format!("table {name} has no `{variable}`: is the file whole?"));
            let named = named.ok_or_else(of_table)?;
            machine_axis(named).ok_or_else(|| fails(format!("`machine_axes` does not name {named}")))
        };
        let (input, output) = (axis_of("_INPUT_AXIS")?, axis_of("_OUTPUT_AXIS")?);
        let table = table(&raw, input, output, model).map_err(fails)?;
        let line = |point: usize| raw.values.get(&point).map_or(raw.line, |(line, _)| *line);
        let lines: Vec<usize> = (0..table.positions.len()).map(line).collect();
        Placed { table: &table, lines: [&lines, &lines] }.check(believed, path, model)?;
        if let Some(other) = same(&table, &found.read[..before]) {
            let message = format!("this table stands in `{}`, too, and would be added twice", other.display());
            return Err(wrong(path, raw.line, message).help("name each table that is active once in `existing`"));
        }
        found.read.push((path.to_owned(), table.clone()));
        let list = if is_encoder { &mut found.encoder } else { &mut found.sag };
        match list.iter_mut().find(|other| other.is_for_same_axes(&table)) {
            Some(other) => {
                *other = other
                    .plus(&table)
                    .map_err(|_| fails("tables of the same axes have different points".to_owned()))?;
            }
            None => list.push(table),
        }
    }
    Ok(())
}

/// The earlier file that has the same table; tables of nothing but zeros add nothing.
fn same<'a>(table: &AxisTable, before: &'a [(PathBuf, AxisTable)]) -> Option<&'a Path> {
    let corrects = table.forward.iter().chain(&table.reverse).any(|value| *value != 0.0);
    before.iter().find(|(_, other)| corrects && other == table).map(|(path, _)| path.as_path())
}

fn table(raw: &Raw, input: usize, output: usize, model: &dyn KinematicModel) -> Result<AxisTable, String> {
    let number = |name: &str| raw.numbers.get(name).copied();
    let needed = |name: &str| number(name).ok_or_else(|| format!("this table has no `{name}`"));
    let (step, from, to) = (needed("_STEP")?, needed("_MIN")?, needed("_MAX")?);
    if number("_MULT_BY_TABLE").is_some_and(|table| table != 0.0) {
        return Err("tables that are multiplied are not read".to_owned());
    }
    let last = (to - from) / step;
    if !(step > 0.0 && last.is_finite() && (0.5..1e6).contains(&last) && (last - last.round()).abs() < 1e-6) {
        return Err("the range of this table is no whole number of steps".to_owned());
    }
    let axes = &model.info().axes;
    let (along, of) = (position_unit(&axes[input]).1, position_unit(&axes[output]).1);
    let points = 0..=last.round() as usize;
    let positions = points.clone().map(|point| (from + point as f64 * step) / along).collect();
    let values: Vec<f64> = points.map(|point| raw.values.get(&point).map_or(0.0, |(_, value)| *value) / of).collect();
    let direction = number("_DIRECTION").unwrap_or(0.0);
    let where_used = |used: bool| if used { values.clone() } else { vec![0.0; values.len()] };
    let (forward, reverse) = (where_used(direction >= 0.0), where_used(direction <= 0.0));
    let repeats = number("_IS_MODULO").is_some_and(|modulo| modulo != 0.0);
    Ok(AxisTable { input, output, positions, forward, reverse, repeats })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_that_stand_in_two_files_are_the_same_unless_they_are_empty() {
        let table = |values: [f64; 2]| AxisTable {
            positions: vec![0.0, 100.0],
            forward: values.to_vec(),
            reverse: values.to_vec(),
            ..AxisTable::default()
        };
        let before =
            [(PathBuf::from("zeros.ini"), table([0.0, 0.0])), (PathBuf::from("cec.ini"), table([0.001, 0.002]))];
        assert_eq!(same(&table([0.001, 0.002]), &before), Some(Path::new("cec.ini")));
        // What one file adds to another one.
        assert_eq!(same(&table([0.001, 0.0021]), &before), None);
        assert_eq!(same(&table([0.0, 0.0]), &before), None);
        // A table of one direction beside that of the other.
        let mut forward = table([0.001, 0.002]);
        forward.reverse = vec![0.0; 2];
        assert_eq!(same(&forward, &before), None);
    }
}
