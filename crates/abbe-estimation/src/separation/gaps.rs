//! Stretches of an axis where nothing was measured: no row shows errors that have an effect only there.

use abbe_core::{AxisKind, Problem};

use super::Measured;
use super::direction::LostDirection;
use super::places::recorded_statuses;

/// Most stretches of an axis that are tried, the longest ones.
const TRIED: usize = 8;

/// A stretch between two neighbouring positions of an axis.
pub struct Gap {
    length: f64,
    sentence: String,
    /// A status in its middle.
    status: Vec<f64>,
}

/// The longest stretches of every axis, ends of its range included.
pub fn gaps(problem: &Problem) -> Vec<Gap> {
    let statuses = recorded_statuses(problem);
    let Some(first) = statuses.first() else { return Vec::new() };
    let mut gaps = Vec::new();
    for axis in &problem.model.info().axes {
        let mut positions: Vec<f64> = statuses.iter().map(|status| status[axis.status]).collect();
        positions.extend(axis.range.into_iter().flatten());
        positions.retain(|position| position.is_finite());
        positions.sort_by(f64::total_cmp);
        let (unit, factor) = if axis.kind == AxisKind::Rotary { ("degrees", 1f64.to_degrees()) } else { ("mm", 1.0) };
        let mut of_axis: Vec<Gap> = Vec::new();
        for pair in positions.windows(2).filter(|pair| pair[1] > pair[0]) {
            let [from, to] = [pair[0], pair[1]].map(|end| (end * factor * 1e3).round() / 1e3);
            let mut status = first.clone();
            status[axis.status] = (pair[0] + pair[1]) / 2.0;
            let sentence = format!("measure with {} between {from} and {to} {unit}: no row has it there", axis.name);
            of_axis.push(Gap { length: pair[1] - pair[0], sentence, status });
        }
        of_axis.sort_by(|a, b| b.length.total_cmp(&a.length));
        gaps.extend(of_axis.into_iter().take(TRIED));
    }
    gaps
}

/// The sentence of the stretch in which a direction moves the tip most, relative to the largest movement by a single unknown
/// there; none if this ratio is above `seen` in no stretch.
pub fn sentence(gaps: &[Gap], direction: &LostDirection<'_>, seen: f64) -> Option<String> {
    let mut best: Option<(f64, &str)> = None;
    for gap in gaps {
        // If the model cannot be evaluated there, nothing can be measured there.
        let Ok(effect) = direction.effect(&Measured::Point(vec![gap.status.clone()])) else { continue };
        let part = if effect.single > 0.0 { effect.moved / effect.single } else { 0.0 };
        if part > seen && best.is_none_or(|(most, _)| part > most) {
            best = Some((part, &gap.sentence));
        }
    }
    best.map(|(_, sentence)| sentence.to_owned())
}
