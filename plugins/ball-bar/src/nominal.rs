//! Nominal contact of a bar's rows, where rank is judged: the effect of errors on the readings is taken out.
//!
//! A machine and its bars may all be too large by the same factor: no reading of a bar of constant length shows that. If
//! readings vary, the length of the bar seems to be determined, because the readings do not have the factor. For a double
//! ball bar that is wrong: readings of 0.1 mm come from a ball that is not at its nominal place. The scale of the machine
//! would then be as wrong as the gain of the transducer. So rank is judged with the bar at one length. A bar that telescopes
//! over many millimetres does determine the scale by its readings; its rows are judged as recorded.

use std::collections::BTreeMap;

use abbe_core::{AxisKind, KinematicModel, LabelText, ListedBy, NominalReading, Poses, Result, RowIndex, Variable};
use nalgebra::Vector3;

use crate::observed::{Bar, Observed};

/// Readings of a bar that differ by more than this, mm, are those of a bar that telescopes: a double ball bar has a stroke of
/// about 2 mm, and errors of machine and set-up stay within it.
const STROKE: f64 = 3.0;

/// At either end, one in this number of readings may be a gross error.
const GROSS: usize = 20;

/// An axis whose positions in a test differ by no more than this, mm, stands still. Recorded positions of such an axis differ
/// by micrometres, compensated positions by the errors.
const STANDS: f64 = 0.1;

/// Smallest part of a bar's length along the axes that move. With a smaller part these axes would have to move by far more
/// than the reading.
const ALONG: f64 = 0.1;

/// A row as the nominal machine has it.
pub struct NominalRow {
    /// From the pivot to the tool ball.
    pub direction: Vector3<f64>,
    /// Distance of tool ball and pivot, mm.
    length: f64,
    /// Derivative of this distance to the position of each linear axis, mm/mm.
    by_axis: Vec<f64>,
    /// Position of each linear axis, mm.
    positions: Vec<f64>,
}

impl ListedBy<RowIndex> for NominalRow {}

/// Nominal readings of the rows, by the index of the row. Rows that are judged as recorded are left out.
pub fn readings(
    observed: &Observed,
    model: &dyn KinematicModel,
    rows: &[NominalRow],
) -> BTreeMap<RowIndex, NominalReading> {
    let axes = linear_axes(model);
    let references: Vec<Option<f64>> = (0..observed.bars.len()).map(|bar| reference(observed, rows, bar)).collect();
    let mut nominal = BTreeMap::new();
    for test in tests(observed) {
        let moving = moving(test.iter().map(|&row| &rows[row]), axes.len());
        let along = |row: &RowIndex| moving.iter().map(|&axis| rows[*row].by_axis[axis].powi(2)).sum::<f64>().sqrt();
        if moving.is_empty() || test.iter().any(|row| along(row) < ALONG) {
            continue;
        }
        for row in test {
            let Some(reference) = references[observed.bar_of_row[row]] else { continue };
            let residuals = vec![reference - observed.readings[row.0]];
            let axes = moving.iter().map(|&axis| axes[axis].0).collect();
            nominal.insert(row, NominalReading { residuals, axes });
        }
    }
    nominal
}

/// The index of every linear axis, and of its command among the statuses.
fn linear_axes(model: &dyn KinematicModel) -> Vec<(usize, usize)> {
    let axes = model.info().axes.iter().enumerate().filter(|(_, axis)| axis.kind == AxisKind::Linear);
    axes.map(|(index, axis)| (index, axis.status)).collect()
}

/// The rows as the nominal machine has them.
///
/// Fails for a row whose nominal tool ball is at the centre of the pivot ball: the bar has no direction there.
pub fn rows(observed: &Observed, model: &dyn KinematicModel) -> Result<Vec<NominalRow>> {
    let axes = linear_axes(model);
    let wanted: Vec<Variable> = axes.iter().map(|(index, _)| Variable::Command(*index)).collect();
    let mut poses = Poses::default();
    let mut rows = Vec::with_capacity(observed.info.layout.rows.len());
    for (index, row) in RowIndex::enumerate(&observed.info.layout.rows) {
        let status = observed.info.layout.poses.row(row.first_pose);
        model.poses(status, &model.info().nominal, &wanted, false, &mut poses)?;
        let ball = &observed.balls[observed.ball_of_row[index]];
        let bar = Vector3::from(poses.positions[0]) - ball.centre;
        let length = bar.norm();
        if length < 1e-3 {
            let data_row = row.data_row.unwrap_or_default();
            return Err(crate::at_the_pivot(&observed.info.layout.data, data_row, &ball.label));
        }
        let by_axis = poses.position_derivatives.iter().map(|by| bar.dot(&Vector3::from(*by)) / length).collect();
        let positions = axes.iter().map(|(_, place)| status[*place]).collect();
        rows.push(NominalRow { direction: bar / length, length, by_axis, positions });
    }
    Ok(rows)
}

/// What a bar reads at nominal contact: the middle of its readings, if they vary by no more than those of a double ball bar.
///
/// In a programme, before anything is measured, all readings are the same: the readings of the nominal machine replace them.
fn reference(observed: &Observed, rows: &[NominalRow], bar: usize) -> Option<f64> {
    let of_bar = || (0..rows.len()).filter(|&row| observed.bar_of_row[row] == bar);
    let length = match observed.bars[bar] {
        Bar::Known { input } => observed.info.inputs[input].value,
        Bar::Unknown { nominal, .. } => nominal,
    };
    let mut readings: Vec<f64> = of_bar().map(|row| observed.readings[row]).collect();
    if readings.iter().all(|reading| *reading == readings[0]) {
        readings = of_bar().map(|row| rows[row].length - length).collect();
    }
    readings.sort_by(f64::total_cmp);
    // A gross error does not show that a bar telescopes: if all readings exceed the stroke, those without the outermost
    // decide.
    let few = readings.len() / GROSS;
    [0, few].into_iter().find_map(|left_out| {
        let kept = &readings[left_out..readings.len() - left_out];
        let (least, most) = (kept.first()?, kept.last()?);
        (most - least <= STROKE).then_some((least + most) / 2.0)
    })
}

/// The rows of every test: those of one file and label in the column `test`, with one bar on one ball.
fn tests(observed: &Observed) -> Vec<Vec<RowIndex>> {
    let data = &observed.info.layout.data;
    let labels = data.labels("test");
    let mut tests: BTreeMap<(usize, Option<&LabelText>, usize, usize), Vec<RowIndex>> = BTreeMap::new();
    for (index, row) in RowIndex::enumerate(&observed.info.layout.rows) {
        let data_row = row.data_row.unwrap_or_default();
        let label = labels.map(|labels| &labels[data_row]);
        let test = (data.origins[data_row].file, label, observed.ball_of_row[index], observed.bar_of_row[index]);
        tests.entry(test).or_default().push(index);
    }
    tests.into_values().collect()
}

/// The linear axes that move in some rows.
fn moving<'a>(rows: impl Iterator<Item = &'a NominalRow> + Clone, axes: usize) -> Vec<usize> {
    let travel = |axis: usize| {
        let (least, most) = range(rows.clone().map(|row| row.positions[axis]));
        most - least
    };
    (0..axes).filter(|&axis| travel(axis) > STANDS).collect()
}

/// The least and the largest of some numbers.
fn range(numbers: impl Iterator<Item = f64>) -> (f64, f64) {
    numbers.fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), number| (least.min(number), most.max(number)))
}
