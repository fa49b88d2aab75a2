//! Commands beyond the travel of an axis: a wrong column, a wrong unit, or the wrong machine.

use std::f64::consts::TAU;

use abbe_core::{Axis, AxisKind, KinematicModel, ObservationSet, Result};

/// Fails on the first row with a command that is no number or outside the range of its axis, unless the axis turns without an end.
pub(crate) fn check_travel(set: &ObservationSet, model: &dyn KinematicModel) -> Result<()> {
    let layout = &set.info().layout;
    let ended = model.info().axes.iter().filter(|axis| !axis.endless);
    let limited: Vec<(&Axis, [f64; 2])> =
        ended.map(|axis| (axis, axis.reach().unwrap_or_else(|| anywhere(axis)))).collect();
    for row in &layout.rows {
        let Some(data_row) = row.data_row else { continue };
        for pose in row.pose_indices() {
            let status = layout.poses.row(pose);
            for (axis, reach) in &limited {
                let command = status[axis.status];
                if !(command >= reach[0] && command <= reach[1]) {
                    let [from, to] = axis.range.unwrap_or(*reach);
                    let [command, from, to] = [command, from, to].map(|value| of_people(axis, value));
                    let message = format!("{} stands at {command}, beyond its travel of {from} to {to}", axis.name);
                    let endless = if axis.kind == AxisKind::Rotary { ", or `endless: true`" } else { "" };
                    return Err(layout.data.error_at(data_row, message).help(format!(
                        "look for a wrong column or unit; if the machine goes there, widen the range of {} in the model{endless}",
                        axis.name
                    )));
                }
            }
        }
    }
    Ok(())
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

fn rounded(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}
