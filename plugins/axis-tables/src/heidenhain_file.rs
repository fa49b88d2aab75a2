//! Reads tables of Heidenhain: errors along axes (`.COM`), location errors of kinematics tables (`.TAB`).

use std::collections::BTreeMap;
use std::path::Path;

use abbe_compensation::AxisTable;
use abbe_compensation::active::{Believed, is_of_axis};
use abbe_compensation::rigid::{LETTERS, Six};
use abbe_core::{Axis, AxisKind, Error, KinematicModel, Result};
use abbe_volumetric::position_unit;

use crate::existing::{Placed, text, wrong};
use crate::tables::axis_of;

/// A file along an axis, as it stands there: positions and values in mm and degrees.
pub struct Columns {
    pub positions: Vec<f64>,
    /// All columns but `NR` and `AXISPOS`, by their names.
    pub values: Vec<(String, Vec<f64>)>,
    /// The line of each point, counted from 0.
    pub lines: Vec<usize>,
}

impl Columns {
    /// The file of an axis of a machine with these axes.
    pub fn read(path: &Path, axis: &Axis, axes: &[Axis]) -> Result<Self> {
        let text = text(path)?;
        let fails = |message: &str| Error::data(message).in_file(path).setting("existing");
        let mut lines =
            text.lines().enumerate().map(|(line, text)| (line, text.trim())).filter(|(_, text)| !text.is_empty());
        let begin = lines.next().filter(|(_, text)| text.starts_with("BEGIN "));
        let (first, begin) = begin.ok_or_else(|| fails("`BEGIN` was expected in the first line"))?;
        if begin.ends_with(" INCH") {
            return Err(fails("a table in mm was expected"));
        }
        if let Some(named) = named(begin) {
            is_of_axis(axis, named, axes, path, first + 1).map_err(|error| error.setting("existing"))?;
        }
        let head = lines.next().map(|(_, text)| text).filter(|text| text.starts_with("NR"));
        let columns: Vec<&str> =
            head.ok_or_else(|| fails("`NR` was expected in the second line"))?.split_whitespace().collect();
        let mut rows: Vec<Vec<f64>> = Vec::new();
        let mut of_rows = Vec::new();
        let mut has_end = false;
        for (line, text) in lines {
            if text == "[END]" {
                has_end = true;
                break;
            }
            let numbers: Option<Vec<f64>> = text.split_whitespace().map(|word| word.parse().ok()).collect();
            let numbers = numbers.filter(|row| row.len() == columns.len() && row.iter().all(|value| value.is_finite()));
            rows.push(numbers.ok_or_else(|| wrong(path, line, format!("{} numbers were expected", columns.len())))?);
            of_rows.push(line);
        }
        if rows.len() < 2 || !has_end {
            return Err(fails("at least two lines of numbers and `[END]` were expected"));
        }
        let column = |place: usize| rows.iter().map(|row| row[place]).collect::<Vec<f64>>();
        let along = columns.iter().position(|name| *name == "AXISPOS");
        let positions = match (along, after(begin, "DATUM:").zip(after(begin, "DISTANCE:"))) {
            (Some(place), _) => column(place),
            (None, Some((datum, distance))) => (0..rows.len()).map(|row| datum + row as f64 * distance).collect(),
            (None, None) => return Err(fails("`AXISPOS`, or `DATUM:` and `DISTANCE:`, were expected")),
        };
        let values = columns.iter().enumerate().filter(|(_, name)| !["NR", "AXISPOS"].contains(name));
        let values = values.map(|(place, name)| ((*name).to_owned(), column(place))).collect();
        Ok(Self { positions, values, lines: of_rows })
    }

    /// The values of a column.
    pub fn get(&self, name: &str) -> Option<&Vec<f64>> {
        self.values.iter().find(|(own, _)| own == name).map(|(_, values)| values)
    }
}

/// What a kinematics table holds besides the nominal machine.
pub struct Located {
    /// Axes in the order of their lines.
    pub axes: Vec<String>,
    /// Location errors by axis, mm and degrees: the lines that are named `X0C` and the like.
    pub errors: BTreeMap<String, Six>,
}

impl Located {
    pub fn read(path: &Path, believed: &Believed<'_>) -> Result<Self> {
        let text = text(path)?;
        let fails = |message: &str| Error::data(message).in_file(path).setting("existing_kinematics");
        let mut lines = text.lines().enumerate();
        let begin =
            lines.next().is_some_and(|(_, line)| line.starts_with("BEGIN ") && !line.trim_end().ends_with("INCH"));
        let head = lines.next().map(|(_, line)| line).filter(|line| begin && line.starts_with("NR"));
        let head =
            head.ok_or_else(|| fails("a kinematics table in mm was expected: `BEGIN`, then a line with `NR`"))?;
        let starts = ["DOC", "KEY", "AXIS", "COORD", "COMPTAB"].map(|name| head.find(name));
        let [Some(doc), Some(key), Some(axis), Some(coordinate), Some(source)] = starts else {
            return Err(fails("columns DOC, KEY, AXIS, COORD and COMPTAB were expected"));
        };
        let mut located = Self { axes: Vec::new(), errors: BTreeMap::new() };
        let mut has_end = false;
        for (line, text) in lines {
            if text.trim_end() == "[END]" {
                has_end = true;
                break;
            }
            let cell = |from: usize, to: usize| {
                let characters = text.chars().skip(from).take(to.saturating_sub(from));
                characters.collect::<String>().trim().to_owned()
            };
            let (doc, key, axis) = (cell(doc, key), cell(key, axis), cell(axis, coordinate));
            if key == "MachAxis" {
                located.axes.push(axis);
                continue;
            }
            let letter =
                LETTERS.iter().position(|letter| doc.strip_prefix(*letter).is_some_and(|rest| rest.starts_with('0')));
            let (Some(six), "Trans") = (letter, key.as_str()) else { continue };
            let value = cell(coordinate, source).parse().ok().filter(|value: &f64| value.is_finite());
            let Some(value) = value.filter(|_| axis == LETTERS[six]) else {
                let message = format!("a number in COORD, and {} in AXIS, were expected of `{doc}`", LETTERS[six]);
                return Err(wrong(path, line, message));
            };
            let kind = if six < 3 { AxisKind::Linear } else { AxisKind::Rotary };
            believed
                .value(kind, value, path, line + 1, "is it that of this machine?")
                .map_err(|error| error.setting("existing_kinematics"))?;
            located.errors.entry(doc[2..].to_owned()).or_default()[six] += value;
        }
        if !has_end {
            return Err(fails("`[END]` was expected in the last line"));
        }
        Ok(located)
    }
}

/// The tables of a file along an axis, values in mm and rad as they stand in the file.
pub fn read(path: &Path, input: usize, model: &dyn KinematicModel, believed: &Believed<'_>) -> Result<Vec<AxisTable>> {
    let axes = &model.info().axes;
    let file = Columns::read(path, &axes[input], axes)?;
    let along = position_unit(&model.info().axes[input]).1;
    let positions: Vec<f64> = file.positions.iter().map(|place| place / along).collect();
    let mut tables = Vec::new();
    for (name, forward) in file.values.iter().filter(|(name, _)| name != "BACKLASH") {
        let output = axis_of(model, name).map_err(|error| error.in_file(path).setting("existing"))?;
        let of = position_unit(&model.info().axes[output]).1;
        let reverse = file.get("BACKLASH").filter(|_| output == input).unwrap_or(forward).clone();
        let repeats = model.info().axes[input].endless;
        let table =
            AxisTable { input, output, positions: positions.clone(), forward: forward.clone(), reverse, repeats };
        let table = table.map(|value| value / of);
        tables.push(table);
    }
    if file.get("BACKLASH").is_some() && !tables.iter().any(|table| table.output == input) {
        let message = "`BACKLASH` needs the column of the axis that moves";
        return Err(Error::data(message).in_file(path).setting("existing"));
    }
    for table in &tables {
        Placed { table, lines: [&file.lines, &file.lines] }.check(believed, path, model)?;
    }
    Ok(tables)
}

/// The axis that the first line names: `X` of `BEGIN AXIS-X.COM MM`.
fn named(begin: &str) -> Option<&str> {
    let file = begin.strip_prefix("BEGIN ")?.split_whitespace().next()?;
    let name = file.strip_prefix("AXIS")?.strip_prefix(['-', '_'])?;
    name.strip_suffix(".COM")
}

/// The number after a word of the first line.
fn after(text: &str, word: &str) -> Option<f64> {
    let rest = text.split_once(word)?.1.split_whitespace().next()?;
    rest.parse().ok().filter(|value: &f64| value.is_finite())
}
