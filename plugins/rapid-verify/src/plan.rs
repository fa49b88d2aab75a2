//! From nominal points to stops of a program: where each axis goes, from which side, and where probing begins and ends.

use abbe_core::{Axis, AxisKind, DataRow, KinematicModel, Result, SettingsError, StatusRole, not_negative};
use schemars::JsonSchema;
use serde::Deserialize;

use crate::points::{Points, axis_index};
use crate::program::{Programme, Stop, Target};

/// How the machine moves.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Motion {
    /// The linear axis that retracts between points.
    #[serde(default = "z")]
    pub retract_axis: String,
    /// Its machine position when it is retracted. From there every point can be reached, and nothing is above it, at
    /// any angle of the rotary axes.
    pub retract_mm: f64,
    /// Distance from the nominal contact at which probing begins.
    #[serde(default = "five")]
    pub clearance_mm: f64,
    /// Distance beyond the nominal contact at which probing ends if there was no touch.
    #[serde(default = "five")]
    pub overtravel_mm: f64,
    /// Feed of probing.
    #[serde(default = "hundred")]
    pub probing_feed_mm_per_min: f64,
    /// Feed of guarded moves to where probing begins, and back.
    #[serde(default = "thousand")]
    pub positioning_feed_mm_per_min: f64,
    /// Distance from which linear axes come to their position, from the side that the columns `dir_X`, ... state.
    #[serde(default = "two")]
    pub overshoot_mm: f64,
    /// The same for rotary axes.
    #[serde(default = "two")]
    pub overshoot_deg: f64,
}

/// Distances before and beyond contact that are no mistake, mm.
const DISTANCES: [f64; 2] = [0.01, 1000.0];

/// Feeds that are no mistake, mm/min.
const FEEDS: [f64; 2] = [0.1, 100_000.0];

fn z() -> String {
    "Z".to_owned()
}

fn two() -> f64 {
    2.0
}

fn five() -> f64 {
    5.0
}

fn hundred() -> f64 {
    100.0
}

fn thousand() -> f64 {
    1000.0
}

impl Motion {
    /// Refuses what cannot be.
    pub fn check(&self) -> Result<(), SettingsError> {
        if !self.retract_mm.is_finite() {
            return Err(SettingsError::new("retract_mm", "a finite number was expected"));
        }
        let within = |name: &str, value: f64, [least, most]: [f64; 2]| match (least..=most).contains(&value) {
            true => Ok(()),
            false => Err(SettingsError::new(name, format!("{value}: a number from {least} to {most} was expected"))),
        };
        within("clearance_mm", self.clearance_mm, DISTANCES)?;
        within("overtravel_mm", self.overtravel_mm, DISTANCES)?;
        within("probing_feed_mm_per_min", self.probing_feed_mm_per_min, FEEDS)?;
        within("positioning_feed_mm_per_min", self.positioning_feed_mm_per_min, FEEDS)?;
        not_negative("overshoot_mm", self.overshoot_mm)?;
        not_negative("overshoot_deg", self.overshoot_deg)?;
        Ok(())
    }

    /// The programme of these points on a machine without errors.
    pub fn programme(&self, points: &Points, model: &dyn KinematicModel, tolerance: f64) -> Result<Programme> {
        let retract = axis_index(model, &self.retract_axis).map_err(|message| {
            abbe_core::Error::usage(message.replace("the approach is", "`retract_axis` is")).setting("motion")
        })?;
        if !reaches(&model.info().axes[retract], self.retract_mm) {
            let message =
                format!("{} does not reach {} mm: it is out of its range", self.retract_axis, self.retract_mm);
            return Err(abbe_core::Error::usage(message).setting("motion"));
        }
        let statuses = points.in_contact(model)?;
        let mut stops = Vec::new();
        let mut turned: Vec<(f64, Option<f64>)> = Vec::new();
        for ((row, point), pose) in DataRow::enumerate(&points.list).zip(statuses.indices()) {
            let wrong = |message: String| points.data.error_at(row, message);
            let status = statuses.row(pose);
            let direction = |axis: usize| {
                let column = StatusRole::Direction(axis).column_name(&model.info().axes)?;
                points.data.numbers(&column).map(|directions| directions[row])
            };
            let contact = status[model.info().axes[axis_index(model, &point.axis).map_err(wrong)?].status];
            let (start, end) = (contact - point.sense * self.clearance_mm, contact + point.sense * self.overtravel_mm);
            let (mut rotary, mut lateral): (Vec<Turn>, Vec<Turn>) = (Vec::new(), Vec::new());
            let mut lowered = 0.0;
            for (index, axis) in model.info().axes.iter().enumerate() {
                let probes = axis.name == point.axis;
                let at = if probes { start } else { status[axis.status] };
                if [at, if probes { end } else { at }].iter().any(|&place| !reaches(axis, place)) {
                    return Err(wrong(format!("point {} takes {} out of its range", point.label, axis.name)));
                }
                let from = direction(index).filter(|_| !probes);
                match axis.kind {
                    _ if index == retract => {
                        lowered = at;
                        let way = (at - self.retract_mm).signum();
                        if from.is_some_and(|from| from != way) || (probes && point.sense != way) {
                            let message = format!(
                                "point {} is reached by {} from the other side than from where it retracts",
                                point.label, axis.name
                            );
                            return Err(
                                wrong(message).help("`retract_mm` has to lie on the side that points are reached from")
                            );
                        }
                    }
                    AxisKind::Rotary => rotary.push(Turn { axis: axis.name.clone(), at: at.to_degrees(), from }),
                    AxisKind::Linear => lateral.push(Turn { axis: axis.name.clone(), at, from }),
                }
            }
            let turn: Vec<(f64, Option<f64>)> = rotary.iter().map(|turn| (turn.at, turn.from)).collect();
            let mut positioning = Vec::new();
            if !turn.is_empty() && turn != turned {
                positioning.extend(moves(&rotary, self.overshoot_deg));
                turned = turn;
            }
            positioning.extend(moves(&lateral, self.overshoot_mm));
            let beyond = |(name, at): &&(String, f64)| {
                let axis = model.info().axes.iter().find(|axis| axis.name == *name);
                axis.is_some_and(|axis| {
                    let at = if axis.kind == AxisKind::Rotary { at.to_radians() } else { *at };
                    !reaches(axis, at)
                })
            };
            if let Some((axis, _)) = positioning.iter().flatten().find(beyond) {
                let message =
                    format!("on the way to point {} the overshoot takes {axis} out of its range", point.label);
                return Err(wrong(message).help("shorten `overshoot_mm` or `overshoot_deg`"));
            }
            let (label, axis) = (point.label.clone(), point.axis.clone());
            stops.push(Stop { label, axis, start, end, positioning, lowered });
        }
        Ok(Programme { stops, retract: (self.retract_axis.clone(), self.retract_mm), tolerance })
    }
}

/// Whether an axis can stand there, mm or rad; one that turns without an end can stand anywhere.
fn reaches(axis: &Axis, place: f64) -> bool {
    axis.endless || axis.range.is_none_or(|[from, to]| (from - 1e-9..=to + 1e-9).contains(&place))
}

/// Where an axis goes, and in which direction it moves there.
struct Turn {
    axis: String,
    at: f64,
    from: Option<f64>,
}

/// A move to the side where the axes come from, then to their positions.
fn moves(turns: &[Turn], overshoot: f64) -> Vec<Target> {
    let place = |turn: &Turn, back: f64| (turn.axis.clone(), turn.at - turn.from.unwrap_or(0.0) * back);
    let mut moves = Vec::new();
    if overshoot > 0.0 && turns.iter().any(|turn| turn.from.is_some()) {
        moves.push(turns.iter().map(|turn| place(turn, overshoot)).collect());
    }
    if !turns.is_empty() {
        moves.push(turns.iter().map(|turn| place(turn, 0.0)).collect());
    }
    moves
}
