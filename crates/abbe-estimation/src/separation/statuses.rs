//! Trials of the recorded rows at other statuses: other positions of an axis, the other direction of approach, another
//! stylus.

use abbe_core::{Axis, AxisKind, Problem, Quantity, Result, StatusColumn, StatusRole};

use super::{Group, Measured, Trial, listed};
use crate::inverse_kinematics::measured_again;

/// Positions that are tried, degrees: of a rotary axis and of one that is indexed.
const ROTARY: [f64; 7] = [90.0, -90.0, 60.0, -60.0, 30.0, -30.0, 0.0];
const INDEXED: [f64; 3] = [90.0, 180.0, 0.0];

/// Shifts of a linear axis that never moves, mm.
const SHIFTS: [f64; 4] = [100.0, -100.0, 20.0, -20.0];

/// Times that are tried beside a single one, s.
const TIMES: [f64; 2] = [0.0, 3600.0];

/// An alternative value of a status, with the sentence that says what to do.
struct Alternative {
    value: f64,
    sentence: String,
}

/// A trial for every other value of every status.
pub fn statuses(problem: &Problem, recorded: &Problem) -> Result<Vec<Trial>> {
    let mut trials = Vec::new();
    for (index, status) in problem.model.info().status.iter().enumerate() {
        let axis = problem.model.info().axes.iter().find(|axis| axis.status == index);
        let values = values(problem, index, status);
        let group = if values.len() > 1 { Group::Further(index) } else { Group::Constant(index) };
        for Alternative { value, sentence } in alternatives(status, &problem.model.info().axes, axis, &values) {
            let other = measured_again(recorded, recorded.clone(), Some(index), |status| status[index] = value);
            if other.as_ref().is_err_and(|error| error.fatal) {
                other?;
            } else if let Ok(Some(rows)) = other {
                trials.push(Trial { group, sentence, measured: Measured::Rows(Box::new(rows)) });
            }
        }
    }
    Ok(trials)
}

/// The values that a status has in the rows, ascending; none where it is not known.
fn values(problem: &Problem, index: usize, status: &StatusColumn) -> Vec<f64> {
    let poses = problem.sets.iter().flat_map(|set| set.poses_of(&set.rows).map(|pose| set.poses().row(pose)[index]));
    let unknown = |value: &f64| value.is_nan() || (is_direction(status) && *value == 0.0);
    let mut values: Vec<f64> = poses.filter(|value| !unknown(value)).collect();
    values.sort_by(f64::total_cmp);
    values.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
    values
}

fn is_direction(status: &StatusColumn) -> bool {
    matches!(status.role, StatusRole::Direction(_))
}

fn alternatives(status: &StatusColumn, axes: &[Axis], axis: Option<&Axis>, values: &[f64]) -> Vec<Alternative> {
    if let StatusRole::Direction(of) = status.role {
        return approach(&status.name, &axes[of].name, values);
    }
    match axis {
        Some(axis) if axis.kind == AxisKind::Rotary => rotary(axis, values),
        Some(axis) => linear(axis, values),
        None if status.quantity == Quantity::Label => levels(status, values),
        None => other(status, values),
    }
}

fn rotary(axis: &Axis, values: &[f64]) -> Vec<Alternative> {
    let grid = if axis.indexed { INDEXED.as_slice() } else { ROTARY.as_slice() };
    let in_range = |value: f64| axis.range.is_none_or(|[from, to]| value >= from - 1e-9 && value <= to + 1e-9);
    let is_new = |value: f64| values.iter().all(|known| (value - known).abs() > 1f64.to_radians());
    let name = if axis.indexed { format!("the spindle {}", axis.name) } else { axis.name.clone() };
    let known: Vec<String> = values.iter().map(|value| degrees(*value)).collect();
    let tried = grid.iter().map(|degrees| degrees.to_radians()).filter(|value| in_range(*value) && is_new(*value));
    tried
        .map(|value| Alternative {
            value,
            sentence: match known.as_slice() {
                [] => format!("measure with {name} at several positions"),
                [one] => format!("measure with {name} at other positions: it stands at {one} in all rows"),
                _ => format!(
                    "measure with {name} at further positions, for instance {}: the rows have {}",
                    degrees(value),
                    listed(&known)
                ),
            },
        })
        .collect()
}

fn degrees(value: f64) -> String {
    // Adding zero takes the sign from a negative zero.
    format!("{}°", (value.to_degrees() * 1e3).round() / 1e3 + 0.0)
}

/// Linear axes usually move with every touch. An alternative is tried only for a linear axis that never moves.
fn linear(axis: &Axis, values: &[f64]) -> Vec<Alternative> {
    let &[value] = values else { return Vec::new() };
    let sentence =
        format!("measure with {} at other positions: it stands at {:.3} mm in all rows", axis.name, value + 0.0);
    let tried = SHIFTS.iter().map(|shift| value + shift);
    let in_range = |value: &f64| axis.range.is_none_or(|[from, to]| (from..=to).contains(value));
    tried.filter(in_range).map(|value| Alternative { value, sentence: sentence.clone() }).collect()
}

/// `name` is the status with the direction of approach of the axis.
fn approach(name: &str, axis: &str, values: &[f64]) -> Vec<Alternative> {
    match values {
        [] => [1.0, -1.0]
            .map(|value| Alternative {
                value,
                sentence: format!("approach in both directions of {axis} and record `{name}`: no row has it"),
            })
            .into(),
        [value] => vec![Alternative {
            value: -value,
            sentence: format!("approach in both directions of {axis}: all rows have {name} = {value:+}"),
        }],
        _ => Vec::new(),
    }
}

fn levels(status: &StatusColumn, values: &[f64]) -> Vec<Alternative> {
    let name = &status.name;
    let label = |value: f64| status.levels.get(value as usize).cloned().unwrap_or_default();
    let known = listed(&values.iter().map(|value| label(*value)).collect::<Vec<_>>());
    let new = (0..status.levels.len()).map(|level| level as f64).filter(|level| !values.contains(level));
    new.map(|value| Alternative {
        value,
        sentence: match values {
            [] => format!("record `{name}`: no row has it"),
            _ => format!("measure with {name} {} as well: the rows have {known}", label(value)),
        },
    })
    .collect()
}

/// Alternatives for time and other statuses.
fn other(status: &StatusColumn, values: &[f64]) -> Vec<Alternative> {
    let name = &status.name;
    let sentence = match values {
        [] => format!("record `{name}`: no row has it"),
        [_] => format!("spread the measurement over other values of {name}: all rows have the same"),
        _ => return Vec::new(),
    };
    let first = values.first().copied().unwrap_or(0.0);
    TIMES.map(|shift| Alternative { value: first + shift, sentence: sentence.clone() }).into()
}
