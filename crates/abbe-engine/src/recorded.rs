//! What the virtual machine records: the cells of data files that simulated rows change.

use std::collections::BTreeMap;
use std::path::PathBuf;

use abbe_core::{Approach, AxisKind, Contact, DataRow, Error, Layout, ObservationSet, Problem, Quantity, Result, Row};
use abbe_table::Cells;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

/// Most decimals of a length, which are used if the scale has no resolution: the precision of a double for a metre in mm.
const DECIMALS: usize = 12;

/// The simulated cells of every file.
pub(crate) fn recorded(measured: &Problem, resolution: f64) -> Result<BTreeMap<PathBuf, Cells>> {
    let axes = measured.model.info().axes.iter().filter(|axis| axis.kind == AxisKind::Linear);
    let axes: Vec<usize> = axes.map(|axis| axis.status).collect();
    let mut files: BTreeMap<PathBuf, Cells> = BTreeMap::new();
    for set in &measured.sets {
        let layout = &set.info().layout;
        for &index in &set.rows {
            let row = &layout.rows[index];
            let Some(data_row) = row.data_row else { continue };
            let origin = layout.data.origins[data_row];
            let cells = match &set.observations.info().contact {
                Contact::LinearAxes => {
                    let mut cells = positions(set, row, &axes)?;
                    if let Some(Approach { axis, reading }) = set.info().approach(index) {
                        let triggered = set.poses().row(row.first_pose)[measured.model.info().axes[*axis].status];
                        cells.push((header(layout, reading)?, triggered));
                    }
                    cells
                }
                Contact::Reading(column) => readings(set, row, data_row, std::slice::from_ref(column))?,
                Contact::Readings(columns) => readings(set, row, data_row, columns)?,
                Contact::Pose { position, orientation } => pose(set, row, data_row, position, orientation)?,
                Contact::NotSimulated(_) => continue,
            };
            let line = files.entry(layout.data.files[origin.file].clone()).or_default().entry(origin.line).or_default();
            for (header, value) in cells {
                let written = number(&header, value, resolution);
                if line.insert(header.clone(), written.clone()).is_some_and(|other| other != written) {
                    let message = format!("`{header}` is recorded once, but differs between the poses of this row");
                    return Err(layout.data.error_at(data_row, message));
                }
            }
        }
    }
    Ok(files)
}

/// The positions of the linear axes at the poses of a row, by the header of their columns.
fn positions(set: &ObservationSet, row: &Row, axes: &[usize]) -> Result<Vec<(String, f64)>> {
    let layout = &set.observations.info().layout;
    let mut found = Vec::new();
    for (pose, index) in row.pose_indices().enumerate() {
        let (status, before) = (set.poses().row(index), layout.poses.row(index));
        for &axis in axes {
            match layout.recorded(pose, axis) {
                Some(column) => found.push((header(layout, column)?, status[axis])),
                None if status[axis] == before[axis] => {}
                None => {
                    return Err(Error::usage("a linear axis has to move, but the data have no column that records it")
                        .stage(&set.name)
                        .help("give the data a column for every linear axis"));
                }
            }
        }
    }
    Ok(found)
}

/// The readings of a row, one for each of its equations, by the headers of their columns.
fn readings(set: &ObservationSet, row: &Row, data_row: DataRow, columns: &[String]) -> Result<Vec<(String, f64)>> {
    let layout = &set.observations.info().layout;
    let mut found = Vec::new();
    for (column, equation) in columns.iter().zip(row.equation_indices()) {
        let before = layout.data.required_numbers(column)?[data_row];
        // A reading has a minus sign in its equation, so a change of the residual is subtracted from the reading.
        let change = set.disturbances().map_or(0.0, |disturbances| disturbances[equation]);
        found.push((header(layout, column)?, before - change));
    }
    Ok(found)
}

/// The observed pose of a row, by the headers of its columns.
fn pose(
    set: &ObservationSet,
    row: &Row,
    data_row: DataRow,
    position: &[String; 3],
    orientation: &[String; 4],
) -> Result<Vec<(String, f64)>> {
    let layout = &set.observations.info().layout;
    let recorded = |column: &String| Ok(layout.data.required_numbers(column)?[data_row]);
    let changes: Vec<f64> =
        row.equation_indices().map(|equation| set.disturbances().map_or(0.0, |all| all[equation])).collect();
    let turn = Vector3::new(changes[3], changes[4], changes[5]);
    let before = orientation.iter().map(recorded).collect::<Result<Vec<f64>>>()?;
    let before = UnitQuaternion::new_normalize(Quaternion::new(before[0], before[1], before[2], before[3]));
    let turned = UnitQuaternion::from_scaled_axis(turn) * before;
    let mut found = Vec::new();
    for (column, change) in position.iter().zip(&changes) {
        found.push((header(layout, column)?, recorded(column)? + change));
    }
    for (column, value) in orientation.iter().zip([turned.w, turned.i, turned.j, turned.k]) {
        found.push((header(layout, column)?, value));
    }
    Ok(found)
}

/// The header of a column, as its file writes it.
fn header(layout: &Layout, column: &str) -> Result<String> {
    let missing = || Error::usage(format!("there is no column `{column}`"));
    layout.data.column(column).map(|column| column.header.header.clone()).ok_or_else(missing)
}

/// A value in the unit of its column, with the decimals of the resolution (mm).
fn number(header: &str, value: f64, resolution: f64) -> String {
    let (_, quantity, factor) = Quantity::of_column(header);
    if quantity != Quantity::Length {
        return format!("{}", value / factor);
    }
    let step = resolution / factor;
    let is_whole = |decimals: &usize| {
        let steps = step * 10_f64.powi(*decimals as i32);
        steps > 0.5 && (steps - steps.round()).abs() < 1e-6 * steps
    };
    let decimals = (0..=DECIMALS).find(is_whole).unwrap_or(DECIMALS);
    let text = format!("{:.decimals$}", value / factor);
    match text.strip_prefix('-') {
        Some(zero) if zero.bytes().all(|digit| matches!(digit, b'0' | b'.')) => zero.to_owned(),
        _ => text,
    }
}
