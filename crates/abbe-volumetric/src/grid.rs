//! Poses that stand for the workspace: a grid over the ranges of the axes, or a list.

use std::collections::BTreeMap;

use abbe_core::{
    Absent, Axis, AxisKind, Error, KinematicModel, PathItem, Quantity, Result, SettingsError, StatusColumn, StatusRole,
};
use schemars::JsonSchema;
use serde::Deserialize;

use crate::sampling::{
    Ranges, Steps, axis_of, check_axes, check_ranges, check_travel, points_every, position_unit, range_of,
    rounded_position, within,
};

/// Most poses of a grid, both directions counted.
pub const MOST_POSES: usize = 1_000_000;

/// Positions by axis and unit: `X_mm`, `B_deg`.
type Positions = BTreeMap<String, f64>;

/// How many points an axis has.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(
    untagged,
    expecting = "a whole number of points (1 to 1000000), or such a number for each axis by name, was expected"
)]
pub enum Points {
    /// The same number along every axis, indexed spindles excepted.
    Every(usize),
    /// Along the named axes; all others stand still.
    ByAxis(BTreeMap<String, usize>),
}

/// Poses over the workspace: `points`, `step_mm` with `step_deg`, or `poses`.
#[derive(Debug, Clone, PartialEq, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Grid {
    /// Number of points over the range of every axis (`5`) or of the named ones (`{ X: 5, B: 3 }`). A single point is
    /// in the middle of the range.
    #[serde(default)]
    pub points: Option<Points>,
    /// Distance of points along every linear axis. If it is missing, linear axes stand still.
    #[serde(default)]
    pub step_mm: Option<f64>,
    /// Distance of points along every rotary axis. If it is missing, rotary axes stand still.
    #[serde(default)]
    pub step_deg: Option<f64>,
    /// The poses themselves: `{ X_mm: 100, B_deg: 90 }`; axes that are not named stand still.
    #[serde(default)]
    pub poses: Option<Vec<Positions>>,
    /// Ranges by axis, where they are not those of the machine.
    #[serde(default)]
    pub axes: Ranges,
    /// Positions of axes that do not vary, `{ B_deg: 90 }`. Default: zero.
    #[serde(default)]
    pub at: Positions,
    /// Whether every pose is also approached in negative direction.
    #[serde(default)]
    pub both_directions: bool,
}

/// How the points of an axis are found.
enum Spacing {
    Count(usize),
    Step(Steps),
}

impl Grid {
    /// Refuses settings that are wrong for every machine.
    pub fn check(&self) -> Result<(), SettingsError> {
        let steps = self.step_mm.is_some() || self.step_deg.is_some();
        match [self.points.is_some(), steps, self.poses.is_some()].iter().filter(|given| **given).count() {
            1 => {}
            0 => return Err(SettingsError::new("", "`points`, `step_mm` with `step_deg`, or `poses` were expected")),
            _ => {
                let message = "only one of `points`, `step_mm` with `step_deg`, and `poses` was expected";
                return Err(SettingsError::new("", message));
            }
        }
        Steps { mm: self.step_mm.unwrap_or(1.0), deg: self.step_deg.unwrap_or(1.0) }.check()?;
        let few = |axis| SettingsError::new(axis, "at least one point was expected");
        match &self.points {
            Some(Points::Every(0)) => return Err(few("points")),
            Some(Points::ByAxis(axes)) if axes.is_empty() => {
                return Err(SettingsError::new("points", "at least one axis was expected"));
            }
            Some(Points::ByAxis(axes)) => {
                if let Some((axis, _)) = axes.iter().find(|(_, count)| **count == 0) {
                    return Err(few(axis).under([key("points")]));
                }
            }
            _ => {}
        }
        if self.poses.as_ref().is_some_and(Vec::is_empty) {
            return Err(SettingsError::new("poses", "at least one pose was expected"));
        }
        check_ranges(&self.axes, "axes")
    }

    /// The statuses of all poses for [`evaluate`](KinematicModel::evaluate): the last axis changes fastest, poses in
    /// negative direction follow all others.
    ///
    /// Directions of approach (`dir_*`) are +1 for all axes at once, or -1. The time is unknown, so that drifts have no
    /// effect. All other statuses are those for data without a column for them.
    ///
    /// Fails for axes that the machine does not have, axes without a known range, no axis that varies, and more than
    /// [`MOST_POSES`] poses. Errors name settings by their path in the grid.
    pub fn statuses(&self, model: &dyn KinematicModel) -> Result<Vec<f64>> {
        let mut standing = standing(model);
        let held = commands(&self.at, model).map_err(|error| within(error, &["at"]))?;
        held.iter().for_each(|(status, position)| standing[*status] = *position);
        let mut statuses = match &self.poses {
            Some(poses) => self.listed(poses, model, &standing)?,
            None => {
                let held: Vec<usize> = held.iter().map(|(status, _)| *status).collect();
                self.product(model, &standing, &held)?
            }
        };
        if self.both_directions {
            let backward = reversed(model, &statuses);
            statuses.extend(backward);
        }
        Ok(statuses)
    }

    fn listed(&self, poses: &[Positions], model: &dyn KinematicModel, standing: &[f64]) -> Result<Vec<f64>> {
        self.check_number(poses.len() as f64, "poses")?;
        let mut statuses = Vec::with_capacity(poses.len() * standing.len());
        for (index, pose) in poses.iter().enumerate() {
            let positions = commands(pose, model).map_err(|mut error| {
                error.setting.splice(0..0, [key("poses"), PathItem::Index(index)]);
                error
            })?;
            let first = statuses.len();
            statuses.extend_from_slice(standing);
            positions.into_iter().for_each(|(status, position)| statuses[first + status] = position);
        }
        Ok(statuses)
    }

    fn product(&self, model: &dyn KinematicModel, standing: &[f64], held: &[usize]) -> Result<Vec<f64>> {
        check_axes(&self.axes, "axes", model)?;
        if let Some(Points::ByAxis(axes)) = &self.points {
            for name in axes.keys() {
                axis_of(model, name).map_err(|error| within(error, &["points", name]))?;
            }
        }
        let mut varied: Vec<(usize, Vec<f64>)> = Vec::new();
        for axis in &model.info().axes {
            if let Some(spacing) = self.spacing(axis, held.contains(&axis.status))? {
                varied.push((axis.status, self.positions(axis, spacing)?));
            }
        }
        let setting = if self.points.is_some() { "points" } else { "step_mm" };
        if varied.is_empty() {
            return Err(Error::usage("no axis of the machine varies").setting(setting));
        }
        self.check_number(varied.iter().map(|(_, positions)| positions.len() as f64).product(), setting)?;
        let mut statuses = standing.to_vec();
        for (status, positions) in varied {
            let mut finer = Vec::with_capacity(statuses.len() * positions.len());
            for row in statuses.chunks_exact(standing.len()) {
                for position in &positions {
                    let first = finer.len();
                    finer.extend_from_slice(row);
                    finer[first + status] = *position;
                }
            }
            statuses = finer;
        }
        Ok(statuses)
    }

    fn check_number(&self, poses: f64, setting: &str) -> Result<()> {
        let poses = if self.both_directions { 2.0 * poses } else { poses };
        if poses <= MOST_POSES as f64 {
            return Ok(());
        }
        let error = Error::usage(format!("the grid has {poses} poses; at most {MOST_POSES} fit"));
        Err(error.help("take fewer points, or hold axes with `at`").setting(setting))
    }

    /// How an axis varies; None if it stands still.
    fn spacing(&self, axis: &Axis, held: bool) -> Result<Option<Spacing>> {
        let name = &axis.name;
        if let Some(Points::ByAxis(axes)) = &self.points {
            let count = axes.get(name).copied();
            if count.is_some() && held {
                let error = Error::usage(format!("{name} cannot vary and stand still: `at` names it, too"));
                return Err(within(error, &["points", name]));
            }
            return Ok(count.map(Spacing::Count));
        }
        // A spindle varies only if its range is given.
        if held || axis.indexed && !self.axes.contains_key(name) {
            return Ok(None);
        }
        Ok(match (&self.points, axis.kind, self.step_mm, self.step_deg) {
            (Some(Points::Every(count)), ..) => Some(Spacing::Count(*count)),
            (_, AxisKind::Linear, Some(step), _) | (_, AxisKind::Rotary, _, Some(step)) => {
                Some(Spacing::Step(Steps { mm: step, deg: step }))
            }
            _ => None,
        })
    }

    /// The positions of an axis that varies, mm or rad.
    fn positions(&self, axis: &Axis, spacing: Spacing) -> Result<Vec<f64>> {
        let (unit, factor) = position_unit(axis);
        let (from, to) = range_of(axis, &self.axes, "axes").map_err(|mut error| {
            let hold = format!("; or hold the axis: `at: {{ {}_{unit}: 0 }}`", axis.name);
            error.help = error.help.map(|help| help + &hold);
            error
        })?;
        let positions = match spacing {
            Spacing::Step(steps) => points_every(axis, (from, to), steps, MOST_POSES)?,
            Spacing::Count(1) => vec![rounded_position((from + to) / 2.0)],
            Spacing::Count(count) => {
                self.check_number(count as f64, "points")?;
                let part = |index: usize| index as f64 / (count - 1) as f64;
                (0..count).map(|index| rounded_position(from + (to - from) * part(index))).collect()
            }
        };
        Ok(positions.into_iter().map(|position| position / factor).collect())
    }
}

fn key(name: &str) -> PathItem {
    PathItem::Key(name.to_owned())
}

fn is_direction(column: &StatusColumn) -> bool {
    matches!(column.role, StatusRole::Direction(_))
}

/// The status of a pose with all axes at zero, approached in positive direction at an unknown time.
pub fn standing(model: &dyn KinematicModel) -> Vec<f64> {
    let columns = model.info().status.iter().enumerate();
    columns
        .map(|(index, column)| match column.absent {
            _ if model.info().axes.iter().any(|axis| axis.status == index) => 0.0,
            _ if is_direction(column) => 1.0,
            _ if column.role == StatusRole::Time => f64::NAN,
            Absent::Default(value) => value,
            Absent::Required => f64::NAN,
        })
        .collect()
}

/// The same poses approached in negative direction; none if directions do not matter to the machine.
fn reversed(model: &dyn KinematicModel, statuses: &[f64]) -> Vec<f64> {
    let directions: Vec<bool> = model.info().status.iter().map(is_direction).collect();
    if !directions.contains(&true) {
        return Vec::new();
    }
    let directions = directions.iter().cycle();
    statuses.iter().zip(directions).map(|(value, direction)| if *direction { -value } else { *value }).collect()
}

/// Positions as (index of the status, mm or rad).
fn commands(positions: &Positions, model: &dyn KinematicModel) -> Result<Vec<(usize, f64)>> {
    let mut commands = Vec::new();
    for (setting, value) in positions {
        let (name, quantity, factor) = Quantity::of_column(setting);
        let axis = axis_of(model, name).map_err(|error| within(error, &[setting]))?;
        let (kind, expected) = match axis.kind {
            AxisKind::Linear => ("linear", Quantity::Length),
            AxisKind::Rotary => ("rotary", Quantity::Angle),
        };
        if quantity != expected {
            let message = format!("{name} is a {kind} axis: `{name}{}` was expected", expected.usual_suffix());
            return Err(Error::usage(message).setting(setting));
        }
        if !value.is_finite() {
            return Err(Error::usage("a finite number was expected").setting(setting));
        }
        if commands.iter().any(|(status, _)| *status == axis.status) {
            return Err(Error::usage(format!("the position of {name} stands here twice")).setting(setting));
        }
        let (command, (_, per_unit)) = (value * factor, position_unit(axis));
        let position = rounded_position(command * per_unit);
        check_travel(axis, position, position).map_err(|error| within(error, &[setting]))?;
        commands.push((axis.status, command));
    }
    Ok(commands)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{chain, key_error};
    use serde_json::{Value, json};
    use std::sync::Arc;

    fn machine() -> Arc<dyn KinematicModel> {
        let axes = json!({ "X": { "range_mm": [-100, 100] }, "B": { "range_deg": [0, 90] } });
        let errors =
            json!([{ "backlash": ["EXX", "EBB"] }, { "drift": ["dzt"], "degrees": [1], "time_s": { "": [0, 1] } }]);
        chain("w B' b X Y (S) t", axes, errors)
    }

    fn grid(settings: Value) -> Result<Grid, String> {
        let grid: Grid = abbe_core::from_settings(&settings).map_err(|error| error.to_string())?;
        grid.check().map_err(|error| error.to_string())?;
        Ok(grid)
    }

    /// B in degrees, X, Y, S, then the direction of both axes.
    fn poses(settings: Value) -> Vec<[f64; 5]> {
        let model = machine();
        let names: Vec<&str> = model.info().status.iter().map(|column| column.name.as_str()).collect();
        assert_eq!(names, ["B", "X", "Y", "S", "dir_X", "dir_B", "time"]);
        let statuses = grid(settings).unwrap().statuses(model.as_ref()).unwrap();
        let rows = statuses.chunks_exact(7).map(|row| {
            assert!(row[6].is_nan() && row[4] == row[5]);
            [rounded_position(row[0].to_degrees()), row[1], row[2], rounded_position(row[3].to_degrees()), row[4]]
        });
        rows.collect()
    }

    #[test]
    fn grids_and_lists() {
        let y = json!({ "Y": { "from_mm": 0, "to_mm": 50 } });
        let cases = [
            (
                json!({ "points": 2, "axes": y }),
                vec![
                    [0.0, -100.0, 0.0, 0.0, 1.0],
                    [0.0, -100.0, 50.0, 0.0, 1.0],
                    [0.0, 100.0, 0.0, 0.0, 1.0],
                    [0.0, 100.0, 50.0, 0.0, 1.0],
                    [90.0, -100.0, 0.0, 0.0, 1.0],
                    [90.0, -100.0, 50.0, 0.0, 1.0],
                    [90.0, 100.0, 0.0, 0.0, 1.0],
                    [90.0, 100.0, 50.0, 0.0, 1.0],
                ],
            ),
            (
                json!({ "points": { "X": 3 }, "at": { "Y_mm": 7, "B_deg": 45 } }),
                vec![[45.0, -100.0, 7.0, 0.0, 1.0], [45.0, 0.0, 7.0, 0.0, 1.0], [45.0, 100.0, 7.0, 0.0, 1.0]],
            ),
            (
                json!({ "step_deg": 40, "both_directions": true }),
                vec![
                    [0.0, 0.0, 0.0, 0.0, 1.0],
                    [40.0, 0.0, 0.0, 0.0, 1.0],
                    [80.0, 0.0, 0.0, 0.0, 1.0],
                    [90.0, 0.0, 0.0, 0.0, 1.0],
                    [0.0, 0.0, 0.0, 0.0, -1.0],
                    [40.0, 0.0, 0.0, 0.0, -1.0],
                    [80.0, 0.0, 0.0, 0.0, -1.0],
                    [90.0, 0.0, 0.0, 0.0, -1.0],
                ],
            ),
            // A single point stands in the middle; a spindle varies if its range is given.
            (json!({ "points": { "X": 1, "B": 1 } }), vec![[45.0, 0.0, 0.0, 0.0, 1.0]]),
            (
                json!({ "points": 2, "at": { "X_mm": 1, "B_deg": 2, "Y_mm": 3 }, "axes": { "S": { "from_deg": 0, "to_deg": 180 } } }),
                vec![[2.0, 1.0, 3.0, 0.0, 1.0], [2.0, 1.0, 3.0, 180.0, 1.0]],
            ),
            (
                json!({ "poses": [{ "X_mm": 5, "B_deg": 90 }, { "Y_um": 1500 }], "at": { "X_mm": 1 } }),
                vec![[90.0, 5.0, 0.0, 0.0, 1.0], [0.0, 1.0, 1.5, 0.0, 1.0]],
            ),
        ];
        for (settings, expected) in cases {
            assert_eq!(poses(settings.clone()), expected, "{settings}");
        }
    }

    #[test]
    fn without_errors_of_direction_there_is_one() {
        let model = chain("w b X t", json!({ "X": { "range_mm": [0, 1] } }), json!([]));
        let grid = grid(json!({ "points": 2, "both_directions": true })).unwrap();
        assert_eq!(grid.statuses(model.as_ref()).unwrap(), [0.0, 1.0]);
    }

    #[test]
    fn settings_that_no_machine_can_make_right() {
        let cases = [
            (json!({}), "`points`, `step_mm` with `step_deg`, or `poses` were expected"),
            (
                json!({ "points": 2, "step_mm": 1 }),
                "only one of `points`, `step_mm` with `step_deg`, and `poses` was expected",
            ),
            (json!({ "points": 0 }), "points: at least one point was expected"),
            (json!({ "points": {} }), "points: at least one axis was expected"),
            (json!({ "points": { "X": 2, "Y": 0 } }), "points.Y: at least one point was expected"),
            (
                json!({ "points": "many" }),
                "points: a whole number of points (1 to 1000000), or such a number for each axis by name, was expected",
            ),
            (json!({ "poses": [] }), "poses: at least one pose was expected"),
            (json!({ "step_deg": -1 }), "step_deg: a positive number, at most 1000000, was expected"),
            (
                json!({ "points": 2, "axes": { "X": { "from_mm": 2, "to_mm": 1 } } }),
                "axes.X: the range has to end beyond its start",
            ),
            (json!({ "point": 2 }), "point: unknown setting `point` (did you mean `points`?)"),
        ];
        for (settings, expected) in cases {
            assert_eq!(grid(settings).unwrap_err(), expected);
        }
    }

    #[test]
    fn what_the_machine_cannot_do_is_refused() {
        let unknown = "the range of axis Y is not known (write `axes: { Y: { from_mm: .., to_mm: .. } }` here, or \
                       `range_mm` into the machine description; or hold the axis: `at: { Y_mm: 0 }`)";
        let cases = [
            (json!({ "points": 2 }), format!("axes: {unknown}")),
            (json!({ "step_mm": 2 }), format!("axes: {unknown}")),
            (json!({ "points": { "x": 2 } }), "points.x: the machine has no axis x (did you mean `X`?)".into()),
            (json!({ "points": { "X": 2 }, "at": { "V_mm": 1 } }), "at.V_mm: the machine has no axis V".into()),
            (json!({ "points": { "X": 2 }, "at": { "Y": 1 } }), "at.Y: Y is a linear axis: `Y_mm` was expected".into()),
            (json!({ "poses": [{}, { "B_mm": 1 }] }), "poses[1].B_mm: B is a rotary axis: `B_deg` was expected".into()),
            (
                json!({ "points": { "X": 2 }, "axes": { "C": { "from_deg": 1, "to_deg": 2 } } }),
                "axes.C: the machine has no axis C".into(),
            ),
            (
                json!({ "points": { "X": 2 }, "at": { "X_mm": 1 } }),
                "points.X: X cannot vary and stand still: `at` names it, too".into(),
            ),
            (
                json!({ "points": 2, "at": { "X_mm": 1, "B_deg": 2, "Y_mm": 3 } }),
                "points: no axis of the machine varies".into(),
            ),
            (
                json!({ "points": { "X": 1000, "B": 501 }, "both_directions": true }),
                "points: the grid has 1002000 poses; at most 1000000 fit (take fewer points, or hold axes with `at`)"
                    .into(),
            ),
            (
                json!({ "points": { "X": 1_000_000_000_000_usize } }),
                "points: the grid has 1000000000000 poses; at most 1000000 fit (take fewer points, or hold axes with \
                 `at`)"
                    .into(),
            ),
            (
                json!({ "step_deg": 1e-6 }),
                "step_deg: axis B from 0 to 90 deg every 0.000001 deg has 90000001 points; at most 1000000 fit \
                 (0.0000901 deg is the smallest step that fits)"
                    .into(),
            ),
        ];
        for (settings, expected) in cases {
            let grid = grid(settings.clone()).unwrap();
            assert_eq!(key_error(grid.statuses(machine().as_ref())), expected, "{settings}");
        }
    }
}
