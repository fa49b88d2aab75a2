//! Corrected commands for the statuses of set-points.

use abbe_core::{Axis, AxisKind, Error, KinematicModel, Poses, Result, Variable, in_parallel};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use crate::settings::{Method, Settings, Travel};
use crate::step::{Bounds, Task, linear_steps, rotary_corrections};

/// Points that are evaluated together.
const CHUNK: usize = 128;

/// Most passes of Newton's method. Errors of machines need two or three, more where the bound on rotary corrections is reached.
const PASSES: usize = 20;

/// From this pass on derivatives are computed anew: those of the start do not lead there.
const RENEWED: usize = 4;

/// Steps, mm and rad, below which a pass is the last one.
const SETTLED: f64 = 1e-10;

/// A pass of the rotary axes is worthwhile if it leaves less than this part of the angle.
const WORTHWHILE: f64 = 0.5;

/// Distance of the tip, mm, and angle of the tool axis, rad, below which nothing is left to correct, unless said otherwise.
const THERE: f64 = 1e-11;

/// Distance of the tip, mm, that is not left where linear axes can bring it to its goal.
const NEAR: f64 = 1e-6;

/// How far a tool is from where it should be.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Deviation {
    /// Tip minus goal, table frame, mm.
    pub tip: [f64; 3],
    /// Tool axis minus goal, unit vectors in the table frame; for small errors its size is the angle, rad.
    pub axis: [f64; 3],
}

impl Deviation {
    /// Distance of the tip, mm.
    pub fn distance(&self) -> f64 {
        Vector3::from(self.tip).norm()
    }

    /// Angle between the tool axes, rad.
    pub fn angle(&self) -> f64 {
        2.0 * (Vector3::from(self.axis).norm() / 2.0).min(1.0).asin()
    }
}

/// What was done at a set-point.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Correction {
    /// With the programmed command.
    pub before: Deviation,
    /// With the corrected one.
    pub after: Deviation,
    /// The bound on rotary corrections is reached.
    pub is_bounded: bool,
    /// Axes that stand at an end of their travel: indices into [`ModelInfo::axes`](abbe_core::ModelInfo::axes).
    pub held: Vec<usize>,
    /// Passes of the iteration.
    pub passes: usize,
}

/// How far the iteration of a point is.
#[derive(Debug, Clone, PartialEq)]
enum State {
    /// Rotary axes turn the tool axis: the smallest angle until now, and their commands then.
    Turning { angle: f64, commands: Vec<f64> },
    /// Rotary axes stand; linear axes follow.
    Standing,
    /// Nothing changes any more.
    Settled,
}

impl State {
    fn is_settled(&self) -> bool {
        *self == Self::Settled
    }

    /// Whether nothing is left to correct. Where axes are nearly parallel, or near a pole, steps stay larger than that.
    fn is_there(&self, lacks: &Deviation, there: f64) -> bool {
        lacks.distance() < there && (*self == Self::Standing || lacks.angle() < there)
    }
}

/// Corrects commands of a machine with known errors.
pub struct Compensator<'a> {
    model: &'a dyn KinematicModel,
    values: &'a [f64],
    settings: &'a Settings,
    /// Linear axes, then rotary ones.
    linear: Vec<usize>,
    rotary: Vec<usize>,
    wanted: Vec<Variable>,
    task: Task,
    /// Distance of the tip, mm, and angle of the tool axis, rad, below which nothing is left to correct.
    there: f64,
    /// Whether commands have to be within the travel of their axes.
    within_travel: bool,
}

impl<'a> Compensator<'a> {
    /// For a machine with these values of its parameters.
    ///
    /// Fails for settings that do not fit the machine.
    pub fn new(model: &'a dyn KinematicModel, values: &'a [f64], settings: &'a Settings) -> Result<Self> {
        settings.check().map_err(|wrong| Error { setting: wrong.path.clone(), ..Error::usage(wrong.to_string()) })?;
        let (linear, rotary) = settings.axes(model)?;
        let wanted = linear.iter().chain(&rotary).map(|&axis| Variable::Command(axis)).collect();
        let task = match settings.sensitive_direction {
            Some(direction) => Task::Along(Vector3::from(direction).normalize()),
            None => Task::Components(settings.weights.map_or(Vector3::repeat(1.0), Vector3::from)),
        };
        Ok(Self { model, values, settings, linear, rotary, wanted, task, there: THERE, within_travel: true })
    }

    /// The same for commands of which digits below `there` (mm of the tip, rad of the tool axis) do not matter.
    pub fn no_finer_than(self, there: f64) -> Self {
        Self { there: there.max(THERE), ..self }
    }

    /// The same for commands that no axis drives to: the corrections in a table, at its ends.
    pub(crate) fn beyond_travel_too(self) -> Self {
        Self { within_travel: false, ..self }
    }

    /// The statuses with corrected commands, and what was done at each point. `statuses` are points x columns of the status;
    /// directions of approach stay.
    ///
    /// Fails where the model has no pose, for corrections larger than the settings allow, and where a corrected command leaves the
    /// travel of its axis, unless it is to be held there. Errors name the point ([`Error::pose`]).
    pub fn correct(&self, statuses: &[f64]) -> Result<(Vec<f64>, Vec<Correction>)> {
        let width = self.model.info().status.len().max(1);
        if !statuses.len().is_multiple_of(width) {
            return Err(Error::usage(format!("{} numbers are no set-points of {width} values each", statuses.len())));
        }
        let chunks: Vec<(usize, &[f64])> = statuses.chunks(width * CHUNK).enumerate().collect();
        let found = in_parallel(&chunks, None, |(index, chunk)| {
            self.corrected(chunk).map_err(|mut error| {
                error.pose = error.pose.map(|pose| pose + index * CHUNK);
                error
            })
        });
        let (mut all, mut corrections) = (Vec::with_capacity(statuses.len()), Vec::new());
        for found in found {
            let (statuses, of_points) = found?;
            all.extend(statuses);
            corrections.extend(of_points);
        }
        Ok((all, corrections))
    }

    fn corrected(&self, programmed: &[f64]) -> Result<(Vec<f64>, Vec<Correction>)> {
        let nominal = &self.model.info().without_errors();
        let (mut goal, mut slopes) = (Poses::default(), Poses::default());
        let of_nominal: &[Variable] = if self.settings.method == Method::FirstOrder { &self.wanted } else { &[] };
        self.poses(programmed, nominal, of_nominal, &mut goal)?;
        self.poses(programmed, self.values, &self.wanted, &mut slopes)?;
        let mut now = without_derivatives(&slopes);
        let count = goal.positions.len();
        let mut points: Vec<Correction> = (0..count)
            .map(|point| Correction { before: deviation(&now, &goal, point), ..Correction::default() })
            .collect();
        let width = self.model.info().status.len();
        let all: Vec<usize> = (0..self.model.info().axes.len()).collect();
        for (point, status) in programmed.chunks(width).enumerate() {
            if let Some(beyond) = self.beyond_travel(status, &all) {
                return Err(Error::data(format!("{beyond}; the path cannot be run")).at_pose(point));
            }
        }
        let derivatives = if self.settings.method == Method::FirstOrder { &goal } else { &slopes };
        for (point, correction) in points.iter().enumerate() {
            self.check_size(&correction.before).map_err(|error| error.at_pose(point))?;
            if !self.task.is_moved_by(&self.shifts(derivatives, point)) {
                return Err(self.moves_nothing().at_pose(point));
            }
        }
        let mut statuses = programmed.to_vec();
        let start = match self.rotary.is_empty() {
            true => State::Standing,
            false => State::Turning { angle: f64::INFINITY, commands: Vec::new() },
        };
        let mut states = vec![start; count];
        for pass in 1..=PASSES {
            let derivatives = if self.settings.method == Method::FirstOrder { &goal } else { &slopes };
            let mut has_moved = false;
            for (point, status) in statuses.chunks_mut(width).enumerate() {
                let lacks = match self.rotary.is_empty() {
                    true => deviation_of_tip(&now, &goal, point),
                    false => deviation(&now, &goal, point),
                };
                if states[point].is_settled() || self.rotary.is_empty() && states[point].is_there(&lacks, self.there) {
                    states[point] = State::Settled;
                    continue;
                }
                has_moved = true;
                let place = &programmed[point * width..(point + 1) * width];
                self.step(&lacks, (derivatives, point), (status, place), (&mut states[point], &mut points[point]));
                points[point].passes = pass;
            }
            if !has_moved {
                break;
            }
            let is_last = self.settings.method == Method::FirstOrder || states.iter().all(State::is_settled);
            // Where rotary axes stand, the derivatives of the first pass serve the next ones as well: errors change little over their
            // own size.
            let is_turning = states.iter().any(|state| matches!(state, State::Turning { .. }));
            if is_last || pass < RENEWED && !is_turning {
                self.poses(&statuses, self.values, &[], &mut now)?;
            } else {
                self.poses(&statuses, self.values, &self.wanted, &mut slopes)?;
                now = without_derivatives(&slopes);
            }
            if is_last {
                break;
            }
        }
        let corrected: Vec<usize> = self.linear.iter().chain(&self.rotary).copied().collect();
        for (point, correction) in points.iter_mut().enumerate() {
            correction.after = deviation(&now, &goal, point);
            let own = point * width..(point + 1) * width;
            let is_exact = self.settings.method == Method::Exact;
            if is_exact && !self.rotary.is_empty() && correction.after.distance() > NEAR {
                let (standing, of_standing) =
                    self.with_rotary_axes_standing().corrected(&programmed[own.clone()]).map_err(|mut error| {
                        error.pose = error.pose.map(|_| point);
                        error
                    })?;
                if of_standing[0].after.distance() < correction.after.distance() {
                    statuses[own.clone()].copy_from_slice(&standing);
                    *correction = of_standing[0].clone();
                    states[point] = State::Settled;
                }
            }
            let status = &statuses[own];
            let fails = |error: Error| Err(error.at_pose(point));
            let (off, most) = (correction.after.distance(), self.settings.largest_tip_correction_mm);
            if off > most {
                let message = format!("corrected, the tip is {off:.3} mm off; at most {most} mm are allowed");
                let help = "`weights` far apart move some axes far for small errors of another direction: leave them out, or state \
                            weights that differ less";
                return fails(Error::data(message).help(help).setting("largest_tip_correction_mm"));
            }
            if self.settings.method == Method::Exact && !states[point].is_settled() {
                return fails(Error::data("no commands are found that correct this point"));
            }
            if self.settings.travel != Travel::Allow
                && let Some(beyond) = self.beyond_travel(status, &corrected)
            {
                let help =
                    "`travel: hold` (`--travel hold` of `abbe compensate`) keeps it at its end and tells what remains";
                return fails(Error::data(format!("corrected, {beyond}")).help(help).setting("travel"));
            }
        }
        Ok((statuses, points))
    }

    /// The same without corrections of rotary axes: where linear axes cannot follow them, the tip is nearer then.
    fn with_rotary_axes_standing(&self) -> Self {
        Self {
            model: self.model,
            values: self.values,
            settings: self.settings,
            linear: self.linear.clone(),
            rotary: Vec::new(),
            wanted: self.wanted[..self.linear.len()].to_vec(),
            task: self.task.clone(),
            there: self.there,
            within_travel: self.within_travel,
        }
    }

    /// How the tip of a point moves with each linear axis, mm/mm.
    fn shifts(&self, derivatives: &Poses, point: usize) -> Vec<Vector3<f64>> {
        let start = point * self.wanted.len();
        let own = &derivatives.position_derivatives[start..start + self.linear.len()];
        own.iter().map(|shift| Vector3::from(*shift)).collect()
    }

    /// The error for a point whose sensitive direction no axis moves along.
    fn moves_nothing(&self) -> Error {
        let axes = &self.model.info().axes;
        let names: Vec<&str> = self.linear.iter().map(|&axis| axes[axis].name.as_str()).collect();
        let direction = self.settings.sensitive_direction.unwrap_or_default().map(|part| part.to_string()).join(", ");
        let message = format!(
            "{} {} the tip nowhere along the sensitive direction [{direction}]: nothing would be corrected",
            names.join(" and "),
            if names.len() == 1 { "moves" } else { "move" }
        );
        Error::usage(message).setting("sensitive_direction").help("it is in the table frame; or correct other axes")
    }

    /// Moves the commands of a point.
    fn step(
        &self,
        lacks: &Deviation,
        (derivatives, point): (&Poses, usize),
        (status, programmed): (&mut [f64], &[f64]),
        (state, correction): (&mut State, &mut Correction),
    ) {
        let axes = &self.model.info().axes;
        let start = point * self.wanted.len();
        let column = |list: &[[f64; 3]], index: usize| Vector3::from(list[start + index]);
        let first = self.linear.len();
        let before: Vec<f64> = self.rotary.iter().map(|&axis| status[axes[axis].status]).collect();
        let turned = self.turned(lacks, (derivatives, point), (&before, programmed), (state, correction));
        let (mut largest, mut moved) = (0_f64, Vector3::zeros());
        for (index, (&axis, command)) in self.rotary.iter().zip(turned).enumerate() {
            let by = command - before[index];
            status[axes[axis].status] = command;
            moved += column(&derivatives.position_derivatives, first + index) * by;
            largest = largest.max(by.abs());
        }
        let shifts = self.shifts(derivatives, point);
        let travel: Vec<Bounds> = self.linear.iter().map(|&axis| self.travel_left(axis, status)).collect();
        let (steps, held) = linear_steps(&self.task, &(-Vector3::from(lacks.tip) - moved), &shifts, &travel);
        let rotary = |axis: &usize| self.rotary.contains(axis);
        correction.held.retain(rotary);
        for ((&axis, step), held) in self.linear.iter().zip(steps).zip(held) {
            status[axes[axis].status] += step;
            largest = largest.max(step.abs());
            if held {
                correction.held.push(axis);
            }
        }
        if largest < SETTLED || state.is_there(lacks, self.there) {
            *state = State::Settled;
        }
    }

    /// Commands of the rotary axes that turn the tool axis nearer to its goal.
    ///
    /// Where the bound is reached the derivatives change from pass to pass with what the bound allows. So the nearest commands are kept, and
    /// the axes stand there once a pass brings the tool axis hardly nearer.
    fn turned(
        &self,
        lacks: &Deviation,
        (derivatives, point): (&Poses, usize),
        (before, programmed): (&[f64], &[f64]),
        (state, correction): (&mut State, &mut Correction),
    ) -> Vec<f64> {
        let State::Turning { angle, commands } = state else { return before.to_vec() };
        let now = Vector3::from(lacks.axis).norm();
        if now > WORTHWHILE * *angle {
            let nearest = if now < *angle { before.to_vec() } else { std::mem::take(commands) };
            *state = State::Standing;
            return nearest;
        }
        (*angle, *commands) = (now, before.to_vec());
        let axes = &self.model.info().axes;
        let direction = tool_axis(derivatives, point);
        let start = point * self.wanted.len() + self.linear.len();
        let turns: Vec<Vector3<f64>> = (0..self.rotary.len())
            .map(|index| Vector3::from(derivatives.rotation_derivatives[start + index]).cross(&direction))
            .collect();
        let places: Vec<f64> = self.rotary.iter().map(|&axis| programmed[axes[axis].status]).collect();
        let so_far: Vec<f64> = before.iter().zip(&places).map(|(now, place)| now - place).collect();
        let bound = self.settings.largest_rotary_correction_mrad * 1e-3;
        let (total, is_bounded) = rotary_corrections(&-Vector3::from(lacks.axis), &turns, &so_far, bound);
        correction.is_bounded |= is_bounded;
        correction.held.clear();
        let wanted = self.rotary.iter().zip(places).zip(total);
        let within = |((&axis, place), total): ((&usize, f64), f64)| match self.end_of_travel(axis, place + total) {
            Some(end) => {
                correction.held.push(axis);
                end
            }
            None => place + total,
        };
        wanted.map(within).collect()
    }

    /// The end of travel that a command is beyond, if the axis is to be held there.
    fn end_of_travel(&self, axis: usize, command: f64) -> Option<f64> {
        let axis = &self.model.info().axes[axis];
        let [from, to] = axis.range.filter(|_| !axis.endless && self.settings.travel == Travel::Hold)?;
        (command < from || command > to).then(|| command.clamp(from, to))
    }

    /// The steps that an axis can make within its travel; any if it is not to be held.
    fn travel_left(&self, axis: usize, status: &[f64]) -> Bounds {
        let axis = &self.model.info().axes[axis];
        match axis.range.filter(|_| self.settings.travel == Travel::Hold) {
            Some([from, to]) => Bounds { least: from - status[axis.status], most: to - status[axis.status] },
            None => Bounds { least: f64::NEG_INFINITY, most: f64::INFINITY },
        }
    }

    fn check_size(&self, before: &Deviation) -> Result<()> {
        let (tip, axis) = (self.settings.largest_tip_correction_mm, self.settings.largest_axis_correction_mrad);
        let help = "is the calibration that of this machine and this tool? else allow more";
        if before.distance() > tip {
            let message =
                format!("the tip would be corrected by {:.3} mm; at most {tip} mm are allowed", before.distance());
            return Err(Error::data(message).help(help).setting("largest_tip_correction_mm"));
        }
        if !self.rotary.is_empty() && before.angle() > axis * 1e-3 {
            let angle = before.angle() * 1e3;
            let message =
                format!("the tool axis would be corrected by {angle:.3} mrad; at most {axis} mrad are allowed");
            return Err(Error::data(message).help(help).setting("largest_axis_correction_mrad"));
        }
        Ok(())
    }

    /// Poses, with orientations. Fails unless they and their derivatives are finite.
    fn poses(&self, statuses: &[f64], values: &[f64], wanted: &[Variable], poses: &mut Poses) -> Result<()> {
        self.model.poses(statuses, values, wanted, true, poses)?;
        let of_pose = |list: &[[f64; 3]], pose: usize| {
            let derivatives = list.iter().skip(pose * wanted.len()).take(wanted.len());
            derivatives.flatten().all(|value| value.is_finite())
        };
        let is_finite = |&pose: &usize| {
            let own = poses.positions[pose].iter().chain(&poses.orientations[pose]);
            own.into_iter().all(|value| value.is_finite())
                && of_pose(&poses.position_derivatives, pose)
                && of_pose(&poses.rotation_derivatives, pose)
        };
        match (0..poses.positions.len()).find(|pose| !is_finite(pose)) {
            Some(pose) => Err(Error::data("the machine has no finite pose here").at_pose(pose)),
            None => Ok(()),
        }
    }

    /// What is said of a command beyond the travel of one of some axes, by more than rounding.
    fn beyond_travel(&self, status: &[f64], of: &[usize]) -> Option<String> {
        let axes = of.iter().map(|&axis| &self.model.info().axes[axis]);
        axes.filter(|_| self.within_travel).find_map(|axis| beyond(axis, status))
    }
}

/// What is said of a command beyond the travel of an axis, by more than rounding.
pub(crate) fn beyond(axis: &Axis, status: &[f64]) -> Option<String> {
    let ([from, to], command) = (axis.range.filter(|_| !axis.endless)?, status[axis.status]);
    let more = 1e-9 * (to - from);
    if command >= from - more && command <= to + more {
        return None;
    }
    let (unit, factor) = match axis.kind {
        AxisKind::Linear => ("mm", 1.0),
        AxisKind::Rotary => ("deg", 1_f64.to_degrees()),
    };
    let [command, from, to] = [command, from, to].map(|value| value * factor);
    Some(format!("{} stands at {command:.6} {unit}, beyond its travel of {from} to {to} {unit}", axis.name))
}

/// Poses alone.
fn without_derivatives(poses: &Poses) -> Poses {
    let (positions, orientations) = (poses.positions.clone(), poses.orientations.clone());
    Poses { positions, orientations, ..Poses::default() }
}

/// The tool axis of a pose, table frame.
fn tool_axis(poses: &Poses, point: usize) -> Vector3<f64> {
    let [w, x, y, z] = poses.orientations[point];
    UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z)) * Vector3::z()
}

pub(crate) fn deviation(now: &Poses, goal: &Poses, point: usize) -> Deviation {
    let axis = (tool_axis(now, point) - tool_axis(goal, point)).into();
    Deviation { axis, ..deviation_of_tip(now, goal, point) }
}

fn deviation_of_tip(now: &Poses, goal: &Poses, point: usize) -> Deviation {
    let tip = [0, 1, 2].map(|axis| now.positions[point][axis] - goal.positions[point][axis]);
    Deviation { tip, ..Deviation::default() }
}
