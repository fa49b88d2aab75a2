//! The machine of a calibration as programs see it.

use std::collections::BTreeMap;
use std::sync::Arc as Shared;

use abbe_compensation::{Compensator, Settings};
use abbe_core::{Absent, AxisKind, Error, KinematicModel, Poses, Quantity, Result, StatusColumn, StatusRole, Variable};
use nalgebra::{Matrix3, Vector3};

use crate::geometry::{Coordinates, is_rotary, place};

/// What coordinates of a program are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Space {
    /// Positions of the axes, machine coordinates.
    Joints,
    /// X, Y and Z are those of the tip of the tool on the workpiece, as the machine has them with its rotary axes at zero.
    Workpiece,
}

/// A position of a program, with the directions from which the axes come.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// The position.
    pub at: Coordinates,
    /// The directions.
    pub directions: Coordinates,
}

/// A machine with errors and one tool.
pub struct Machine {
    model: Shared<dyn KinematicModel>,
    values: Vec<f64>,
    nominal: Vec<f64>,
    settings: Settings,
    base: Vec<f64>,
    /// Place in coordinates, column of the status, factor to rad.
    axes: Vec<(usize, usize, f64)>,
    /// Whether there is an axis, by place.
    has: [bool; 9],
    /// Indices of the linear axes X, Y and Z in the model.
    linear: Vec<(usize, usize)>,
    /// Place in coordinates, column of its direction.
    directions: Vec<(usize, usize)>,
    /// The nominal tip in the table frame with the axes at zero, and the length of the tool.
    zero: [f64; 3],
    length: f64,
    /// Shortest wavelength of its errors, mm.
    wavelength: f64,
    /// Travels by place.
    travels: [Option<[f64; 2]>; 9],
    /// Axes that turn without an end.
    endless: [bool; 9],
}

impl Machine {
    /// Of a model and the values of its parameters. `length` is that of the tool, `time` the time on the clock of the model, s.
    ///
    /// Fails for a machine whose errors depend on what no program tells, and for axes that have no letter.
    pub fn new(
        model: Shared<dyn KinematicModel>,
        values: Vec<f64>,
        settings: Settings,
        length: f64,
        time: Option<f64>,
    ) -> Result<Self> {
        Self::with_constants(model, values, settings, length, time, &BTreeMap::new())
    }

    /// The same with statuses that no program tells, by their names, and that stay: a load, a temperature; in the units of memory.
    ///
    /// Fails for a name that is none of them, and for another quantity.
    pub fn with_constants(
        model: Shared<dyn KinematicModel>,
        values: Vec<f64>,
        settings: Settings,
        length: f64,
        time: Option<f64>,
        constants: &BTreeMap<String, (Quantity, f64)>,
    ) -> Result<Self> {
        if settings.sensitive_direction.is_some() || settings.weights.is_some() {
            return Err(Error::usage("programs are corrected in all directions: leave out directions and weights"));
        }
        let info = model.info();
        let (mut axes, mut linear, mut directions) = (Vec::new(), Vec::new(), Vec::new());
        let (mut travels, mut endless) = ([None; 9], [false; 9]);
        let mut base = Vec::new();
        let (mut shortest, periods) = (f64::INFINITY, &info.periods);
        for period in periods {
            if info.axes[period.axis].kind == AxisKind::Linear {
                shortest = shortest.min(period.length);
            }
        }
        for (index, axis) in info.axes.iter().enumerate().filter(|(_, axis)| !axis.indexed) {
            let letter = axis.name.as_bytes();
            let found = (letter.len() == 1).then(|| place(letter[0])).flatten();
            let is_turning = axis.kind == AxisKind::Rotary;
            let Some(found) = found.filter(|place| is_rotary(*place) == is_turning) else {
                return Err(Error::usage(format!("programs have no letter for the axis {}", axis.name)));
            };
            let factor = if is_turning { 1_f64.to_radians() } else { 1.0 };
            axes.push((found, axis.status, factor));
            if found < 3 {
                linear.push((found, index));
            }
            endless[found] = axis.endless;
            travels[found] = axis.range.filter(|_| !axis.endless).map(|ends| ends.map(|end| end / factor));
        }
        let is_told = |role: &StatusRole| matches!(role, StatusRole::Command(_) | StatusRole::Direction(_));
        let open = || info.status.iter().filter(|column| !is_told(&column.role)).map(|column| column.name.as_str());
        if let Some(name) = constants.keys().find(|name| !open().any(|known| known == name.as_str())) {
            let message = format!("errors of this machine depend on no `{name}` that stays while a program runs");
            return Err(Error::usage(message).suggest(name, open()));
        }
        for (index, column) in info.status.iter().enumerate() {
            if let Some((quantity, value)) = constants.get(&column.name) {
                if *quantity != column.quantity {
                    let (name, suffix) = (&column.name, column.quantity.usual_suffix());
                    return Err(Error::usage(format!("`{name}` has the wrong unit: `{name}{suffix}` was expected")));
                }
                base.push(match column.quantity {
                    Quantity::Label => level(column, *value)?,
                    _ => *value,
                });
                continue;
            }
            let value = match (&column.role, column.absent) {
                (StatusRole::Command(_), _) => 0.0,
                (StatusRole::Direction(axis), _) => {
                    let known = axes.iter().find(|(_, status, _)| *status == info.axes[*axis].status);
                    directions.extend(known.map(|(place, ..)| (*place, index)));
                    1.0
                }
                (StatusRole::Time, _) if time.is_some() => time.unwrap_or(f64::NAN),
                // A program works with the tool itself, which is the first stylus.
                (StatusRole::Series | StatusRole::Stylus, Absent::Default(value)) => value,
                _ => {
                    let message = format!("errors of this machine depend on `{}`, which no program tells", column.name);
                    let written = format!("{}{}", column.name, column.quantity.usual_suffix());
                    let help = format!("say what it is while the program runs: `--constant {written}=0`");
                    return Err(Error::usage(message).help(help));
                }
            };
            base.push(value);
        }
        linear.sort_unstable();
        let has = std::array::from_fn(|place| axes.iter().any(|(own, ..)| *own == place));
        let nominal = info.without_errors();
        let mut machine = Self {
            model: model.clone(),
            values,
            nominal,
            settings,
            base,
            axes,
            has,
            linear,
            directions,
            zero: [0.0; 3],
            length,
            wavelength: shortest,
            travels,
            endless,
        };
        let origin = Point { at: [0.0; 9], directions: [1.0; 9] };
        machine.zero = machine.tips(&machine.joint_statuses(&[origin]), false)?[0];
        Ok(machine)
    }

    /// Whether it has no errors at all.
    pub fn is_perfect(&self) -> bool {
        self.values == self.nominal
    }

    /// Whether it has an axis of this place.
    pub fn has(&self, place: usize) -> bool {
        self.has[place]
    }

    /// Places of its axes.
    pub fn places(&self) -> impl Iterator<Item = usize> + '_ {
        self.axes.iter().map(|(place, ..)| *place)
    }

    /// Whether the commands of an axis are corrected.
    pub fn corrects(&self, place: usize) -> bool {
        use abbe_compensation::Correct;
        match &self.settings.correct {
            Correct::Position => !is_rotary(place),
            Correct::FiveAxes => true,
            Correct::Axes(names) => names.iter().any(|name| name.as_bytes() == [crate::geometry::LETTERS[place]]),
        }
    }

    /// Whether errors depend on directions of approach.
    pub fn has_directions(&self) -> bool {
        !self.directions.is_empty()
    }

    /// The travel of an axis.
    pub fn travel(&self, place: usize) -> Option<[f64; 2]> {
        self.travels[place]
    }

    /// Whether an axis turns without an end.
    pub fn is_endless(&self, place: usize) -> bool {
        self.endless[place]
    }

    /// Whether ends of travel are the control's affair alone.
    pub fn ignores_travel(&self) -> bool {
        self.settings.travel == abbe_compensation::Travel::Allow
    }

    /// Longest step, mm, between points at which a path is looked at.
    pub fn step(&self) -> f64 {
        (self.wavelength / 8.0).min(LONGEST_STEP)
    }

    /// Corrected positions, in the same coordinates.
    pub fn corrected(&self, space: Space, points: &[Point]) -> Result<Vec<Coordinates>> {
        let statuses = self.statuses(space, points)?;
        let compensator = Compensator::new(self.model.as_ref(), &self.values, &self.settings)?.no_finer_than(FINEST);
        let (statuses, _) = compensator.correct(&statuses)?;
        let mut found: Vec<Coordinates> = points.iter().map(|point| point.at).collect();
        for (place, column, factor) in &self.axes {
            for (at, status) in found.iter_mut().zip(statuses.chunks(self.base.len())) {
                if self.corrects(*place) {
                    at[*place] = status[*column] / factor;
                }
            }
        }
        if space == Space::Workpiece {
            let tips = self.tips(&statuses, false)?;
            for (at, tip) in found.iter_mut().zip(tips) {
                (0..3).for_each(|axis| at[axis] = tip[axis] - self.workpiece_origin()[axis]);
            }
        }
        Ok(found)
    }

    /// Where the tip really is, table frame.
    pub fn actual(&self, space: Space, points: &[Point]) -> Result<Vec<[f64; 3]>> {
        self.tips(&self.statuses(space, points)?, true)
    }

    /// Where the tip would be without errors.
    pub fn goals(&self, space: Space, points: &[Point]) -> Result<Vec<[f64; 3]>> {
        self.tips(&self.statuses(space, points)?, false)
    }

    /// Positions of the axes.
    pub fn joints(&self, space: Space, points: &[Point]) -> Result<Vec<Coordinates>> {
        let mut found: Vec<Coordinates> = points.iter().map(|point| point.at).collect();
        if space == Space::Joints {
            return Ok(found);
        }
        let statuses = self.statuses(space, points)?;
        for (at, status) in found.iter_mut().zip(statuses.chunks(self.base.len())) {
            self.axes.iter().for_each(|(place, column, factor)| at[*place] = status[*column] / factor);
        }
        Ok(found)
    }

    /// Coordinates on the workpiece of positions of the axes.
    pub fn on_workpiece(&self, joints: &Coordinates) -> Result<Coordinates> {
        let point = Point { at: *joints, directions: [1.0; 9] };
        let tip = self.tips(&self.joint_statuses(&[point]), false)?[0];
        let mut found = *joints;
        (0..3).for_each(|axis| found[axis] = tip[axis] - self.workpiece_origin()[axis]);
        Ok(found)
    }

    /// The table frame at the origin of coordinates on the workpiece: with rotary axes at zero they are those of the axes, less the
    /// length of the tool.
    fn workpiece_origin(&self) -> [f64; 3] {
        [self.zero[0], self.zero[1], self.zero[2] + self.length]
    }

    fn statuses(&self, space: Space, points: &[Point]) -> Result<Vec<f64>> {
        match space {
            Space::Joints => Ok(self.joint_statuses(points)),
            Space::Workpiece => self.solved(points),
        }
    }

    fn joint_statuses(&self, points: &[Point]) -> Vec<f64> {
        let width = self.base.len();
        let mut statuses = Vec::with_capacity(points.len() * width);
        for point in points {
            let start = statuses.len();
            statuses.extend_from_slice(&self.base);
            for (place, column, factor) in &self.axes {
                statuses[start + column] = point.at[*place] * factor;
            }
            for (place, column) in &self.directions {
                statuses[start + column] = point.directions[*place];
            }
        }
        statuses
    }

    /// Positions of the linear axes that bring the nominal tip to points of the workpiece: one step of Newton's method, because the
    /// nominal tip is linear in them.
    fn solved(&self, points: &[Point]) -> Result<Vec<f64>> {
        if self.linear.len() != 3 {
            return Err(Error::usage("tips on the workpiece can be programmed on machines with X, Y and Z"));
        }
        let origin = self.workpiece_origin();
        let standing: Vec<Point> = points
            .iter()
            .map(|point| {
                let mut at = point.at;
                at[..3].fill(0.0);
                Point { at, ..*point }
            })
            .collect();
        let mut statuses = self.joint_statuses(&standing);
        let wanted: Vec<Variable> = self.linear.iter().map(|(_, index)| Variable::Command(*index)).collect();
        let mut poses = Poses::default();
        self.model.poses(&statuses, &self.nominal, &wanted, false, &mut poses)?;
        let width = self.base.len();
        for (index, point) in points.iter().enumerate() {
            let column = |axis: usize| Vector3::from(poses.position_derivatives[3 * index + axis]);
            let matrix = Matrix3::from_columns(&[column(0), column(1), column(2)]);
            let goal = Vector3::from([0, 1, 2].map(|axis| point.at[axis] + origin[axis]));
            let solved = matrix.lu().solve(&(goal - Vector3::from(poses.positions[index])));
            let Some(solved) = solved else {
                return Err(Error::data("no position of X, Y and Z brings the tip there").at_pose(index));
            };
            for (place, column, _) in self.axes.iter().filter(|(place, ..)| *place < 3) {
                statuses[index * width + column] = solved[*place];
            }
        }
        Ok(statuses)
    }

    fn tips(&self, statuses: &[f64], with_errors: bool) -> Result<Vec<[f64; 3]>> {
        let mut poses = Poses::default();
        let values = if with_errors { &self.values } else { &self.nominal };
        self.model.poses(statuses, values, &[], false, &mut poses)?;
        Ok(poses.positions)
    }
}

/// The place of a label, which is a number, among those that a status can have.
fn level(column: &StatusColumn, value: f64) -> Result<f64> {
    let found = column.levels.iter().position(|level| *level == value.to_string());
    let known = column.levels.join(", ");
    let error = || Error::usage(format!("`{}` is {value}; one of {known} was expected", column.name));
    found.map(|index| index as f64).ok_or_else(error)
}

/// Distances of the tip, mm, and angles of the tool axis, rad, that no number of a program shows.
const FINEST: f64 = 1e-8;

/// Longest step, mm, between points at which a path is looked at, where no error repeats.
const LONGEST_STEP: f64 = 2.0;
