//! Reads the CSV files of the exporter `grid` again.

use std::path::Path;

use abbe_compensation::active::{Believed, covers};
use abbe_core::{AxisKind, Error, KinematicModel, Result};
use abbe_files::{LARGEST_TEXT, read_text};
use abbe_volumetric::position_unit;

use crate::lattice::{Corrected, Lattice, Set, Side, When, directions};

/// A line of numbers with its place in the file, counted from 1.
struct Row<'a> {
    line: usize,
    set: &'a str,
    numbers: Vec<f64>,
}

/// The corrections of a file.
pub fn read(path: &Path, model: &dyn KinematicModel, believed: &Believed<'_>) -> Result<Lattice> {
    let text = read_text(path, LARGEST_TEXT)
        .map_err(|error| Error::data(format!("it cannot be read: {error}")).in_file(path).setting("existing"))?;
    let wrong = |line: usize, message: String| Error::data(message).at(path, line, None).setting("existing");
    let mut lines = (1..).zip(text.lines()).filter(|(_, text)| !text.starts_with('#') && !text.trim().is_empty());
    let (at, header) = lines.next().ok_or_else(|| wrong(1, "a line `set,X_mm,..,dX_mm,..` was expected".to_owned()))?;
    let labels: Vec<&str> = match header.split(',').collect::<Vec<_>>().as_slice() {
        ["set", labels @ ..] => labels.to_vec(),
        _ => return Err(wrong(at, "the first column of a file of corrections is `set`".to_owned())),
    };
    let rows = lines.map(|(line, text)| row(line, text, labels.len()).map_err(|message| wrong(line, message)));
    let rows = rows.collect::<Result<Vec<Row<'_>>>>()?;
    let (sides, corrected) = columns(&labels, &rows, model).map_err(|message| wrong(at, message))?;
    let mut lattice = Lattice { width: model.info().status.len(), sides, corrected, sets: Vec::new() };
    let nodes: usize = lattice.sides.iter().map(|side| side.nodes.len()).product();
    for rows in rows.chunk_by(|one, other| one.set == other.set) {
        let Some(first) = rows.first() else { continue };
        if lattice.sets.iter().any(|set| set.name == first.set) {
            return Err(wrong(first.line, format!("the set {} stands in two places", first.set)));
        }
        let when = when(first.set, model).ok_or_else(|| wrong(first.line, format!("`{}` is no set", first.set)))?;
        let mut values = vec![Vec::new(); nodes];
        for row in rows {
            let (place, numbers) = row.numbers.split_at(lattice.sides.len());
            let node = values.get_mut(index(&lattice.sides, place)).filter(|values| values.is_empty());
            *node.ok_or_else(|| wrong(row.line, "this node stands in two lines".to_owned()))? = numbers.to_vec();
        }
        if values.iter().any(Vec::is_empty) {
            let message = format!("the set {} has {} nodes; {nodes} were expected", first.set, rows.len());
            return Err(wrong(first.line, message));
        }
        lattice.sets.push(Set { name: first.set.to_owned(), when, values });
    }
    rows.iter()
        .try_for_each(|row| check_values(row, &lattice, believed, path))
        .map_err(|error| error.setting("existing"))?;
    Ok(lattice)
}

/// Refuses a file with less than half of a grid.
pub fn check_coverage(active: &Lattice, grid: &[Side], path: &Path) -> Result<()> {
    for side in &active.sides {
        let Some(of_grid) = grid.iter().find(|other| other.column == side.column) else { continue };
        let (Some(from), Some(to)) = (of_grid.nodes.first(), of_grid.nodes.last()) else { continue };
        covers(kind(side.factor), &side.nodes, (*from, *to), path, None, "grid")
            .map_err(|error| error.setting("existing"))?;
    }
    Ok(())
}

/// Refuses corrections that are not believed.
fn check_values(row: &Row<'_>, lattice: &Lattice, believed: &Believed<'_>, path: &Path) -> Result<()> {
    let values = row.numbers.iter().skip(lattice.sides.len());
    for (axis, value) in lattice.corrected.iter().zip(values) {
        believed.value(
            kind(axis.factor),
            *value,
            path,
            row.line,
            "is it a file of this exporter, in mm and degrees?",
        )?;
    }
    Ok(())
}

/// Whether an axis is linear or rotary, by the factor of its unit.
fn kind(factor: f64) -> AxisKind {
    match factor == 1.0 {
        true => AxisKind::Linear,
        false => AxisKind::Rotary,
    }
}

fn row(line: usize, text: &str, count: usize) -> Result<Row<'_>, String> {
    let (set, cells) = text.split_once(',').ok_or("a set and numbers, with commas between, were expected")?;
    let number = |cell: &str| {
        let number = cell.trim().parse().ok().filter(|number: &f64| number.is_finite());
        number.ok_or_else(|| "a number was expected in every column but the first".to_owned())
    };
    let numbers = cells.split(',').map(number).collect::<Result<Vec<f64>, String>>()?;
    match numbers.len() == count {
        true => Ok(Row { line, set, numbers }),
        false => Err(format!("{} numbers were expected, as many as columns; here are {}", count, numbers.len())),
    }
}

/// Axes that vary, and those that are corrected.
fn columns(
    labels: &[&str],
    rows: &[Row<'_>],
    model: &dyn KinematicModel,
) -> Result<(Vec<Side>, Vec<Corrected>), String> {
    let axes = &model.info().axes;
    let known = |label: &str| {
        let axis = axes.iter().find(|axis| format!("{}_{}", axis.name, position_unit(axis).0) == label);
        axis.map(|axis| (axis.status, position_unit(axis).1))
            .ok_or_else(|| format!("the machine has no axis for the column {label}"))
    };
    let (mut sides, mut corrected) = (Vec::new(), Vec::new());
    for (place, label) in labels.iter().enumerate() {
        let repeated = labels.iter().take(place).any(|other| other == label);
        if repeated {
            return Err(format!("two columns have the name {label}"));
        }
        if let Some(of) = label.strip_prefix('d') {
            let (column, factor) = known(of)?;
            corrected.push(Corrected { label: (*label).to_owned(), column, factor });
            continue;
        }
        if !corrected.is_empty() {
            return Err(format!("the column {label} stands after corrections"));
        }
        let (column, factor) = known(label)?;
        let mut nodes: Vec<f64> = rows.iter().filter_map(|row| row.numbers.get(place).copied()).collect();
        nodes.sort_by(f64::total_cmp);
        nodes.dedup();
        if nodes.len() < 2 {
            return Err(format!("{label} has fewer than two nodes"));
        }
        sides.push(Side { label: (*label).to_owned(), column, factor, nodes });
    }
    match sides.is_empty() || corrected.is_empty() {
        true => Err("columns of nodes and of corrections were expected: `set,X_mm,..,dX_mm,..`".to_owned()),
        false => Ok((sides, corrected)),
    }
}

fn when(set: &str, model: &dyn KinematicModel) -> Option<When> {
    if set == "forward" {
        return Some(When::Always);
    }
    let axis = set.strip_prefix("reverse_")?;
    let of_axis = directions(model).into_iter().find(|(name, _)| name == axis);
    of_axis.map(|(_, column)| When::Reversed(column))
}

/// The index of a node; the last side changes fastest.
fn index(sides: &[Side], place: &[f64]) -> usize {
    sides
        .iter()
        .zip(place)
        .fold(0, |index, (side, at)| index * side.nodes.len() + side.nodes.partition_point(|node| node < at))
}
