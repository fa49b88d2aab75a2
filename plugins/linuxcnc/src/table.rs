//! Corrections of the joints on a grid, with linear interpolation along each joint.

use abbe_compensation::Compensator;
use abbe_core::{Absent, Error, KinematicModel, Result, StatusColumn, StatusRole};
use abbe_volumetric::{Ranges, Steps, points_every, range_of};

use crate::joints::{Joint, known};

/// Most numbers of a table.
const MOST: usize = 1_000_000;

/// The digits of the table, mm or degrees.
const DIGIT: f64 = 1e-9;

/// Corrections in mm and degrees.
pub struct Table {
    /// Places along each joint, mm or degrees.
    pub places: Vec<Vec<f64>>,
    /// Nodes x joints; the last joint's place changes fastest.
    pub corrections: Vec<f64>,
}

impl Table {
    /// The exact corrections at the nodes.
    pub fn new(
        model: &dyn KinematicModel,
        compensator: &Compensator<'_>,
        joints: &[Joint],
        (ranges, steps): (&Ranges, Steps),
    ) -> Result<Self> {
        check_known(model)?;
        let mut places = Vec::new();
        for joint in joints {
            let axis = &model.info().axes[joint.axis];
            if axis.endless {
                let message = format!("axis {} turns without an end, and a table has ends", axis.name);
                return Err(Error::usage(message).help("take `form: model`").setting("form"));
            }
            places.push(points_every(axis, range_of(axis, ranges, "ranges")?, steps, MOST)?);
        }
        let count = places.iter().try_fold(joints.len(), |count, places: &Vec<f64>| count.checked_mul(places.len()));
        if count.is_none_or(|count| count > MOST) {
            let lengths: Vec<String> = places.iter().map(|places| places.len().to_string()).collect();
            let message = format!(
                "a grid of {} points with a correction of every joint has more than {MOST} numbers",
                lengths.join(" x ")
            );
            return Err(Error::usage(message)
                .help("take larger steps, smaller `ranges`, or `form: model`")
                .setting("step_mm"));
        }
        let nodes: usize = places.iter().map(Vec::len).product();
        let base = known(model, joints, &vec![0.0; model.info().status.len()]);
        let mut statuses = Vec::with_capacity(nodes * base.len());
        for node in 0..nodes {
            let (mut rest, mut status) = (node, base.clone());
            for (joint, places) in joints.iter().zip(&places).rev() {
                status[joint.status] = places[rest % places.len()] / joint.factor;
                rest /= places.len();
            }
            statuses.extend(status);
        }
        let (corrected, _) = compensator.correct(&statuses)?;
        let pairs = corrected.chunks(base.len()).zip(statuses.chunks(base.len()));
        let of_node = |(to, from): (&[f64], &[f64])| {
            let by = joints.iter().map(|joint| (to[joint.status] - from[joint.status]) * joint.factor);
            by.map(|by| (by / DIGIT).round() * DIGIT).collect::<Vec<_>>()
        };
        Ok(Self { corrections: pairs.flat_map(of_node).collect(), places })
    }

    /// The corrections at commands, mm and degrees; those of the end beyond it.
    pub fn at(&self, commands: &[f64]) -> Vec<f64> {
        let cells: Vec<(usize, f64)> =
            commands.iter().zip(&self.places).map(|(at, places)| cell(places, *at)).collect();
        let mut sum = vec![0.0; commands.len()];
        for corner in 0..1_usize << cells.len() {
            let (mut node, mut weight) = (0, 1.0);
            for (index, ((cell, part), places)) in cells.iter().zip(&self.places).enumerate() {
                let above = corner >> index & 1;
                node = node * places.len() + (cell + above).min(places.len() - 1);
                weight *= if above == 1 { *part } else { 1.0 - part };
            }
            let own = &self.corrections[node * commands.len()..(node + 1) * commands.len()];
            sum.iter_mut().zip(own).for_each(|(sum, correction)| *sum += weight * correction);
        }
        sum
    }
}

/// Refuses errors that depend on what a control does not know: statuses without a value for data that lack them, as times and
/// temperatures.
fn check_known(model: &dyn KinematicModel) -> Result<()> {
    let is_unknown = |column: &&StatusColumn| match (&column.role, column.absent) {
        (StatusRole::Command(_) | StatusRole::Direction(_), _) => false,
        (_, Absent::Required) => true,
        (_, Absent::Default(value)) => value.is_nan(),
    };
    model.info().status.iter().find(is_unknown).map_or(Ok(()), |column| {
        let message = format!("errors depend on `{}`, which the control does not know", column.name);
        Err(Error::usage(message).help("take a calibration whose model has no such errors"))
    })
}

/// The interval of a position, and which part of it lies before the position.
fn cell(places: &[f64], at: f64) -> (usize, f64) {
    let index = places.partition_point(|place| *place <= at).saturating_sub(1).min(places.len().saturating_sub(2));
    match places.get(index + 1) {
        Some(next) => (index, ((at - places[index]) / (next - places[index])).clamp(0.0, 1.0)),
        None => (index, 0.0),
    }
}
