//! How the tip of a machine with three axes follows the commands of a control.

use abbe_core::{AxisKind, StatusRole};

use super::law::{Control, Machine};

const POINTS: usize = 5;

/// Slopes of the tips over the commands of X, Y and Z, mm per mm, mean of both directions: one vector an axis.
pub fn slopes(machine: &Machine, control: Option<&dyn Control>) -> [[f64; 3]; 3] {
    let info = machine.model.info();
    let axes = ["X", "Y", "Z"].map(|name| info.axes.iter().find(|axis| axis.name == name).expect("an axis"));
    assert!(info.axes.iter().all(|axis| axis.kind == AxisKind::Linear));
    let mut statuses = Vec::new();
    for node in 0..POINTS.pow(3) {
        for direction in [1.0, -1.0] {
            let mut status = vec![0.0; info.status.len()];
            for (place, column) in info.status.iter().enumerate() {
                if matches!(column.role, StatusRole::Direction(_)) {
                    status[place] = direction;
                }
            }
            let places = [node % POINTS, node / POINTS % POINTS, node / POINTS / POINTS];
            for (axis, place) in axes.iter().zip(places) {
                let [from, to] = axis.range.expect("a range");
                status[axis.status] = from + (to - from) * place as f64 / (POINTS - 1) as f64;
            }
            statuses.extend(status);
        }
    }
    let driven = control.map_or_else(|| statuses.clone(), |control| machine.driven(control, &statuses));
    let tips = machine.tips(&driven, true);
    axes.map(|axis| {
        let [from, to] = axis.range.expect("a range");
        let away: Vec<f64> =
            statuses.chunks(info.status.len()).map(|status| status[axis.status] - (from + to) / 2.0).collect();
        let squares: f64 = away.iter().map(|away| away * away).sum();
        [0, 1, 2].map(|part| tips.iter().zip(&away).map(|(tip, away)| tip[part] * away).sum::<f64>() / squares)
    })
}

/// How far X and Y, X and Z, Y and Z are from square, rad.
pub fn squareness(slopes: [[f64; 3]; 3]) -> [f64; 3] {
    let dot = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    [(0, 1), (0, 2), (1, 2)].map(|(a, b)| {
        let [a, b] = [slopes[a], slopes[b]];
        dot(a, b) / (dot(a, a) * dot(b, b)).sqrt()
    })
}

/// How much the scales of X, Y and Z are wrong, mm per mm.
pub fn scales(slopes: [[f64; 3]; 3]) -> [f64; 3] {
    [0, 1, 2].map(|axis| slopes[axis][axis] - 1.0)
}

pub fn largest(values: [f64; 3]) -> f64 {
    values.into_iter().map(f64::abs).fold(0.0, f64::max)
}
