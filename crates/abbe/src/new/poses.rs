//! Poses in which a target on the table is seen from the tool: positions of the axes all over their travel, and what a perfect machine
//! sees there.

use std::fmt::Write as _;

use abbe_core::{Axis, AxisKind, KinematicModel, Poses, Result};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};

use super::methods::POSES;

/// Part of its travel that an axis goes.
const OF_TRAVEL: f64 = 0.8;

/// Travel to either side of an axis whose range is not known: mm, rad.
const TRAVEL: [f64; 2] = [400.0, 1.0];

/// No axis turns further than this from zero, rad: half a turn.
const FARTHEST: f64 = std::f64::consts::PI;

/// Where the target stands in the frame of the table until it is measured, mm.
const TARGET: [f64; 3] = [100.0, 50.0, 20.0];

/// The data file: a row for every pose.
pub fn seen(model: &dyn KinematicModel) -> Result<String> {
    let info = model.info();
    let moved: Vec<&Axis> = info.axes.iter().filter(|axis| !axis.indexed).collect();
    let mut text = "pose".to_owned();
    for axis in &moved {
        let unit = if axis.kind == AxisKind::Linear { "mm" } else { "deg" };
        let _ = write!(text, ",{}_{unit}", axis.name);
    }
    text.push_str(",x_mm,y_mm,z_mm,qw,qx,qy,qz\n");
    for number in 1..=POSES {
        let mut status = vec![0.0; info.status.len()];
        let _ = write!(text, "{number}");
        for (place, axis) in moved.iter().enumerate() {
            let (cell, command) = command(axis, spread(number, place));
            status[axis.status] = command;
            let _ = write!(text, ",{cell}");
        }
        let mut tool = Poses::default();
        model.poses(&status, &info.nominal, &[], true, &mut tool)?;
        let [w, x, y, z] = tool.orientations[0];
        let turned = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        let tool = Isometry3::from_parts(Translation3::from(tool.positions[0]), turned);
        let target = tool.inverse() * Translation3::from(TARGET);
        let (at, turn) = (target.translation, target.rotation);
        let _ = writeln!(text, ",{},{},{},{},{},{},{}", at.x, at.y, at.z, turn.w, turn.i, turn.j, turn.k);
    }
    Ok(text)
}

/// A command as it stands in the file, and in the unit of memory; `part` is from 0 to 1.
fn command(axis: &Axis, part: f64) -> (f64, f64) {
    let rotary = axis.kind == AxisKind::Rotary;
    let travel = TRAVEL[usize::from(rotary)];
    let [from, to] = axis.range.unwrap_or([-travel, travel]);
    let [from, to] = if rotary { [from.max(-FARTHEST), to.min(FARTHEST)] } else { [from, to] };
    let command = (from + to) / 2.0 + OF_TRAVEL * (to - from) * (part - 0.5);
    match rotary {
        true => {
            let degrees = (command.to_degrees() * 10.0).round() / 10.0 + 0.0;
            (degrees, degrees.to_radians())
        }
        false => {
            let rounded = command.round() + 0.0;
            (rounded, rounded)
        }
    }
}

/// Numbers from 0 to 1 that fill a box of so many axes evenly (Halton 1960): the digits of `number` in the base of the axis, reversed.
fn spread(number: usize, axis: usize) -> f64 {
    const BASES: [usize; 12] = [2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37];
    let base = BASES[axis % BASES.len()];
    let (mut rest, mut digit, mut value) = (number, 1.0, 0.0);
    while rest > 0 {
        digit /= base as f64;
        value += digit * (rest % base) as f64;
        rest /= base;
    }
    value
}
