//! Tables that are active in a control already: which of them are believed before new values are added.

use std::path::Path;

use abbe_core::{Axis, AxisKind, Error, Result};
use abbe_volumetric::{Ranges, position_unit, range_of};

/// What a table of a control is believed to hold. A misread digit, another unit or another layout of the file would move axes by
/// millimetres and more.
#[derive(Debug, Clone, Copy)]
pub struct Believed<'a> {
    /// Largest value of a length, mm.
    pub largest_mm: f64,
    /// Largest value of an angle, degrees.
    pub largest_deg: f64,
    /// Ranges of axes, where they are not those of the machine.
    pub ranges: &'a Ranges,
    /// The settings with these, as a recipe has them: `largest_mm`, `largest_deg`, `ranges`.
    pub settings: [&'static str; 3],
}

impl<'a> Believed<'a> {
    /// With the settings `largest_mm`, `largest_deg` and `ranges`.
    pub fn new(largest_mm: f64, largest_deg: f64, ranges: &'a Ranges) -> Self {
        Self { largest_mm, largest_deg, ranges, settings: ["largest_mm", "largest_deg", "ranges"] }
    }

    /// The largest value that is believed along an axis, mm or degrees, with its setting.
    pub fn largest(&self, kind: AxisKind) -> (&'static str, f64) {
        match kind {
            AxisKind::Linear => (self.settings[0], self.largest_mm),
            AxisKind::Rotary => (self.settings[1], self.largest_deg),
        }
    }

    /// Refuses a value, mm or degrees, that is not believed. `line` of the file is counted from 1, `help` names what is usual.
    pub fn value(&self, kind: AxisKind, value: f64, path: &Path, line: usize, help: &str) -> Result<()> {
        let (setting, largest) = self.largest(kind);
        if value.abs() <= largest {
            return Ok(());
        }
        let unit = unit(kind);
        let message = format!("a value of {} {unit}, more than {largest} {unit}", rounded(value));
        Err(Error::data(message).at(path, line, None).help(format!("{help} or allow more: `{setting}`")))
    }

    /// Refuses positions, mm or degrees, on less than half of an axis whose range is known. `line` is where they begin.
    pub fn coverage(&self, axis: &Axis, positions: &[f64], path: &Path, line: Option<usize>) -> Result<()> {
        let Ok(range) = range_of(axis, self.ranges, self.settings[2]) else { return Ok(()) };
        covers(axis.kind, positions, range, path, line, self.settings[2])
    }
}

/// Refuses positions, mm or degrees, on less than half of a range that `setting` says.
pub fn covers(
    kind: AxisKind,
    positions: &[f64],
    (from, to): (f64, f64),
    path: &Path,
    line: Option<usize>,
    setting: &str,
) -> Result<()> {
    let ends =
        positions.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), at| (low.min(*at), high.max(*at)));
    let covered = ends.1.min(to) - ends.0.max(from);
    if covered >= 0.5 * (to - from) {
        return Ok(());
    }
    let unit = unit(kind);
    let message = format!("it covers {} {unit} of {} {unit}", rounded(covered.max(0.0)), rounded(to - from));
    let help = format!("positions are in {unit}; `{setting}` says what part of the axis is used");
    let error = match line {
        Some(line) => Error::data(message).at(path, line, None),
        None => Error::data(message).in_file(path),
    };
    Err(error.help(help))
}

/// Refuses a table whose own head names another axis of the machine. `line` is counted from 1.
pub fn is_of_axis(expected: &Axis, named: &str, axes: &[Axis], path: &Path, line: usize) -> Result<()> {
    let is_other = named != expected.name && axes.iter().any(|axis| axis.name == named);
    if !is_other {
        return Ok(());
    }
    let message = format!("this is a table of axis {named}, and it stands under {}", expected.name);
    Err(Error::data(message).at(path, line, None).help("is the file that of the axis?"))
}

fn unit(kind: AxisKind) -> &'static str {
    match kind {
        AxisKind::Linear => "mm",
        AxisKind::Rotary => "deg",
    }
}

fn rounded(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}

/// Positions of memory as those of files, mm or degrees.
pub fn positions_in_file(axis: &Axis, positions: &[f64]) -> Vec<f64> {
    let factor = position_unit(axis).1;
    positions.iter().map(|position| position * factor).collect()
}
