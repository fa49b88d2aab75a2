//! Commands beyond the travel of an axis: a wrong column, a wrong unit, or the wrong machine.

use std::f64::consts::TAU;

use abbe_core::{Axis, AxisKind, DataRow, Dataset, Fit, KinematicModel, ObservationSet, Result, StatusRole};

/// Fails on the first row with a command that is no number or outside the range of its axis, unless the axis turns without an end.
pub(crate) fn check_travel(set: &ObservationSet, model: &dyn KinematicModel) -> Result<()> {
    let layout = &set.info().layout;
    let ended = model.info().axes.iter().filter(|axis| !axis.endless);
    let limited: Vec<(&Axis, [f64; 2])> =
        ended.map(|axis| (axis, axis.reach().unwrap_or_else(|| anywhere(axis)))).collect();
    let load = model.info().status_index(&StatusRole::Load);
    for row in &layout.rows {
        let Some(data_row) = row.data_row else { continue };
        for pose in row.pose_indices() {
            let status = layout.poses.row(pose);
            if let Some(load) = load.map(|load| status[load]).filter(|load| *load < 0.0) {
                let message = format!("a load of {load} N; a force of 0 N or more was expected");
                return Err(layout.data.error_at(data_row, message).help("the load is a weight: it has no sign"));
            }
            for (axis, reach) in &limited {
                let command = status[axis.status];
                if let Some((message, help)) = beyond(axis, *reach, command) {
                    let of = if layout.data.averaged { OF_MEAN } else { "" };
                    return Err(layout.data.error_at(data_row, message + of).help(help));
                }
            }
        }
    }
    Ok(())
}

/// What is to be said of a row that is a mean: the one that is to blame may be another one of those.
const OF_MEAN: &str = " in the mean of several rows (`average`), of which this is the first";

/// Fails if data that a validator judges are beyond the travel of a machine that it judges.
pub(crate) fn in_travel(fits: &[&Fit], data: &[&Dataset]) -> Result<()> {
    fits.iter().try_for_each(|fit| data.iter().try_for_each(|data| check_data(data, fit.problem.model.as_ref())))
}

/// Fails on the first row of data that validators judge, as [`check_travel`].
fn check_data(data: &Dataset, model: &dyn KinematicModel) -> Result<()> {
    for axis in model.info().axes.iter().filter(|axis| !axis.endless) {
        let reach = axis.reach().unwrap_or_else(|| anywhere(axis));
        for (row, &command) in DataRow::first(data.rows()).zip(data.numbers(&axis.name).unwrap_or_default()) {
            if let Some((message, help)) = beyond(axis, reach, command) {
                return Err(data.error_at(row, message).help(help));
            }
        }
    }
    Ok(())
}

/// What is wrong with a command, and what to do; none if the axis goes there.
fn beyond(axis: &Axis, reach: [f64; 2], command: f64) -> Option<(String, String)> {
    if command >= reach[0] && command <= reach[1] {
        return None;
    }
    let [from, to] = axis.range.unwrap_or(reach);
    let [command, from, to] = [command, from, to].map(|value| of_people(axis, value));
    let message = format!("{} stands at {command}, beyond its travel of {from} to {to}", axis.name);
    let endless = if axis.kind == AxisKind::Rotary { ", or `endless: true`" } else { "" };
    let help = format!(
        "look for a wrong column or unit; if the machine goes there, widen the range of {} in the model{endless}",
        axis.name
    );
    Some((message, help))
}

/// Where an axis may stand whose travel is not known: beyond that no machine goes.
fn anywhere(axis: &Axis) -> [f64; 2] {
    match axis.kind {
        AxisKind::Linear => [-1e5, 1e5],
        AxisKind::Rotary => [-100.0 * TAU, 100.0 * TAU],
    }
}

/// A position with its unit.
fn of_people(axis: &Axis, value: f64) -> String {
    match axis.kind {
        AxisKind::Linear => format!("{} mm", rounded(value)),
        AxisKind::Rotary => format!("{}°", rounded(value.to_degrees())),
    }
}

fn rounded(value: f64) -> String {
    if value.abs() < 1e12 { format!("{}", (value * 1e6).round() / 1e6) } else { format!("{value:e}") }
}
