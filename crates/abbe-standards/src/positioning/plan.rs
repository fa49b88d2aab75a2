//! What is wrong with a plan of targets and runs, after ISO 230-2:2014, 5.3.
//!
//! The numbers of targets are those in general use: five a metre and at least five in all up to 2 m; beyond, targets every 250 mm in
//! the mean and one run each way; of a rotary axis three up to 90°, five up to 180°, eight beyond.

use super::Target;

/// Up to this travel an axis is tested with five runs, mm.
pub const LONG: f64 = 2000.0;
/// Mean distance of targets beyond it, mm.
pub const LONG_STEP: f64 = 250.0;
/// Runs of axes that are not long.
pub const RUNS: usize = 5;

/// What an axis is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axis {
    /// Positions in mm.
    Linear,
    /// Positions in degrees.
    Rotary,
}

/// Something that a plan lacks.
#[derive(Debug, Clone, PartialEq)]
pub enum Fault {
    /// There are fewer targets than the length asks for.
    TooFewTargets {
        /// How many there are.
        found: usize,
        /// How many are asked for.
        needed: usize,
    },
    /// All targets stand at this distance: errors that repeat with it, or with a part of it, do not show.
    Equidistant(f64),
    /// There are fewer runs in a direction than asked for.
    TooFewRuns {
        /// How many there are in the direction that has fewer.
        found: usize,
        /// How many are asked for.
        needed: usize,
    },
    /// Only one direction was measured.
    OneDirection,
    /// Targets that have fewer readings than others, by their positions.
    MissingRuns(Vec<f64>),
}

/// How many targets an axis of this travel (mm or degrees) needs.
///
/// ```
/// use abbe_standards::positioning::plan::{Axis, targets_needed};
///
/// assert_eq!([300.0, 1000.0, 1500.0, 3000.0].map(|travel| targets_needed(Axis::Linear, travel)), [5, 5, 8, 13]);
/// assert_eq!([90.0, 180.0, 360.0].map(|travel| targets_needed(Axis::Rotary, travel)), [3, 5, 8]);
/// ```
pub fn targets_needed(axis: Axis, travel: f64) -> usize {
    match axis {
        Axis::Linear if travel <= LONG => ((5e-3 * travel * (1.0 - 1e-9)).ceil() as usize).max(5),
        // Intervals of 250 mm in the mean; a travel that is measured a little short does not ask for one less.
        Axis::Linear => (travel / LONG_STEP * (1.0 - 1e-3)).ceil() as usize + 1,
        Axis::Rotary if travel <= 90.0 => 3,
        Axis::Rotary if travel <= 180.0 => 5,
        Axis::Rotary => 8,
    }
}

/// How many runs an axis of this travel needs in each direction.
pub fn runs_needed(axis: Axis, travel: f64) -> usize {
    if axis == Axis::Linear && travel > LONG { 1 } else { RUNS }
}

/// What a plan lacks, most important first.
pub fn faults(axis: Axis, targets: &[Target]) -> Vec<Fault> {
    let mut faults = Vec::new();
    let mut positions: Vec<f64> = targets.iter().map(|target| target.position).collect();
    positions.sort_by(f64::total_cmp);
    let (Some(first), Some(last)) = (positions.first(), positions.last()) else { return faults };
    let travel = last - first;
    let needed = targets_needed(axis, travel);
    if positions.len() < needed {
        faults.push(Fault::TooFewTargets { found: positions.len(), needed });
    }
    let counts = || targets.iter().map(|target| (target.up.len(), target.down.len()));
    let (up, down) = (counts().map(|(up, _)| up).max().unwrap_or(0), counts().map(|(_, down)| down).max().unwrap_or(0));
    if up == 0 || down == 0 {
        faults.push(Fault::OneDirection);
    }
    let lacking = |target: &&Target| target.up.len() < up || target.down.len() < down;
    let missing: Vec<f64> = targets.iter().filter(lacking).map(|target| target.position).collect();
    if !missing.is_empty() {
        faults.push(Fault::MissingRuns(missing));
    }
    let measured = [up, down].into_iter().filter(|count| *count > 0).min().unwrap_or(0);
    let runs = runs_needed(axis, travel);
    if measured < runs {
        faults.push(Fault::TooFewRuns { found: measured, needed: runs });
    }
    let step = travel / (positions.len() as f64 - 1.0);
    if positions.len() > 2 && positions.windows(2).all(|pair| (pair[1] - pair[0] - step).abs() < 1e-3 * step) {
        faults.push(Fault::Equidistant(step));
    }
    faults
}
