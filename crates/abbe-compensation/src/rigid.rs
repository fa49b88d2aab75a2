//! The nominal machine as a product of rigid motions, and the rigid displacements that its errors make of every axis.
//!
//! All places are in the table frame with every axis at zero. There all frames are parallel, so that the motion of the tool is the
//! product of what each axis does, bed first: `E(location) · E(motion at q) · J(q)`, and the same for the workpiece. An error is a
//! displacement of the body that the axis carries, in the directions of this frame, told at the point of the axis.

use abbe_core::{
    AxisKind, Branch, Calibration, Error, KinematicModel, ParameterRole, Poses, Result, StatusRole, machine_values,
};
use nalgebra::{Isometry3, Matrix3, Point3, Quaternion, Rotation3, Translation3, UnitQuaternion, Vector3};

use abbe_volumetric::standing;

/// Six numbers of an error: x, y, z in mm and a, b, c in rad, applied as Rz(c) Ry(b) Rx(a) after the axes of the frame.
pub type Six = [f64; 6];

/// Angle by which a rotary axis is turned to find its line, rad.
const TURN: f64 = 0.5;

/// The product of motions has to place the nominal tip as the model does, to this distance, mm.
const SAME: f64 = 1e-6;

/// Passes of the iteration that looks for corrected commands; errors of machines need three.
const PASSES: usize = 30;

/// Distance, mm, to which the tip is brought.
const SETTLED: f64 = 1e-9;

/// Letters of axes, and of the components of errors.
pub const LETTERS: [&str; 6] = ["X", "Y", "Z", "A", "B", "C"];

/// Directions of axes are those of the frame to this much.
const PARALLEL: f64 = 1e-9;

/// An axis of the nominal machine.
#[derive(Debug, Clone)]
pub struct Joint {
    /// Index into [`ModelInfo::axes`](abbe_core::ModelInfo::axes).
    pub axis: usize,
    /// Its name.
    pub name: String,
    /// Linear or rotary.
    pub kind: AxisKind,
    /// The side of the bed on which it sits.
    pub branch: Branch,
    /// Unit direction in which, or about which, a positive command moves the body that the axis carries.
    pub direction: Vector3<f64>,
    /// A point of the line of a rotary axis, nearest to the origin; the origin for a linear axis.
    pub point: Point3<f64>,
    /// The column of its command.
    pub status: usize,
}

impl Joint {
    /// Its letter among [`LETTERS`]. Fails for an axis that does not move the tool, as seen from the workpiece, along or about its own
    /// letter (ISO 841).
    pub fn letter(&self) -> Result<usize> {
        let name = &self.name;
        let own = if self.kind == AxisKind::Linear { 0..3 } else { 3..6 };
        let letter = own.clone().find(|letter| LETTERS[*letter] == name);
        let letter = letter.ok_or_else(|| {
            Error::usage(format!("the control knows axes X, Y, Z, A, B and C; it has no axis {name}"))
        })?;
        let mut direction = Vector3::zeros();
        direction[letter % 3] = if self.branch == Branch::Tool { 1.0 } else { -1.0 };
        if (self.direction - direction).norm() > PARALLEL {
            let message = format!("axis {name} does not move along or about its own letter as in ISO 841");
            return Err(
                Error::usage(message).help("axes in other directions or senses are not written for this control")
            );
        }
        Ok(letter)
    }

    /// What a command does to the body that the axis carries.
    pub fn motion(&self, command: f64) -> Isometry3<f64> {
        match self.kind {
            AxisKind::Linear => Translation3::from(self.direction * command).into(),
            AxisKind::Rotary => {
                about(&self.point, &Isometry3::from_parts(Translation3::identity(), self.turned(command)))
            }
        }
    }

    fn turned(&self, command: f64) -> UnitQuaternion<f64> {
        UnitQuaternion::new(self.direction * command)
    }

    /// The displacement that an error told at the point of this axis makes.
    pub fn displaced(&self, error: &Six) -> Isometry3<f64> {
        let [x, y, z, a, b, c] = *error;
        let turned = UnitQuaternion::from_euler_angles(a, b, c);
        about(&self.point, &Isometry3::from_parts(Translation3::new(x, y, z), turned))
    }

    /// The error, told at the point of this axis, of a displacement.
    fn error(&self, displacement: &Isometry3<f64>) -> Six {
        let shift = displacement * self.point - self.point;
        let (a, b, c) = displacement.rotation.euler_angles();
        [shift.x, shift.y, shift.z, a, b, c]
    }
}

/// A motion that is told at a point, in the frame of the origin.
fn about(point: &Point3<f64>, motion: &Isometry3<f64>) -> Isometry3<f64> {
    let there = Translation3::from(point.coords);
    there * motion * there.inverse()
}

/// The nominal machine.
pub struct Machine {
    /// Axes from the workpiece to the tool, without indexed ones.
    pub joints: Vec<Joint>,
    /// The tip with every axis at zero.
    pub tip: Point3<f64>,
    /// Direction from the tip to the spindle, with every axis at zero.
    pub tool: Vector3<f64>,
    /// The status with every axis at zero.
    pub standing: Vec<f64>,
}

impl Machine {
    /// Fails if the model is no chain of such axes.
    pub fn new(model: &dyn KinematicModel) -> Result<Self> {
        let standing = standing(model);
        let nominal = &model.info().nominal;
        let tool = pose(model, &standing, nominal)?;
        let mut machine =
            Self { joints: Vec::new(), tip: tool * Point3::origin(), tool: tool * Vector3::z(), standing };
        for (index, axis) in model.info().axes.iter().enumerate().filter(|(_, axis)| !axis.indexed) {
            let mut joint = Joint {
                axis: index,
                name: axis.name.clone(),
                kind: axis.kind,
                branch: axis.branch,
                direction: Vector3::from(axis.direction) * axis.sense,
                point: Point3::origin(),
                status: axis.status,
            };
            if joint.kind == AxisKind::Rotary {
                let mut status = machine.standing.clone();
                status[joint.status] = TURN;
                let reached = pose(model, &status, nominal)? * Point3::origin();
                joint.point = center(&joint, &machine.tip, &reached);
            }
            machine.joints.push(joint);
        }
        machine.check(model)?;
        Ok(machine)
    }

    /// Fails unless the product of motions is the nominal machine of the model.
    fn check(&self, model: &dyn KinematicModel) -> Result<()> {
        for turn in 1..=4_u32 {
            let mut status = self.standing.clone();
            for (place, joint) in self.joints.iter().enumerate() {
                let part = (f64::from(turn) * (1.7 + place as f64)).sin();
                status[joint.status] = if joint.kind == AxisKind::Linear { 100.0 * part } else { part };
            }
            let expected = pose(model, &status, &model.info().nominal)? * Point3::origin();
            let off = (self.tip_at(&status, &|_, _| Isometry3::identity()) - expected).norm();
            if off.is_nan() || off > SAME {
                return Err(Error::usage(format!(
                    "the machine is no chain of its axes: a nominal tip is {off:.6} mm elsewhere"
                )));
            }
        }
        Ok(())
    }

    /// Places of the axes among [`joints`](Self::joints), from the bed on.
    pub fn branch(&self, branch: Branch) -> Vec<usize> {
        let own = (0..self.joints.len()).filter(|&place| self.joints[place].branch == branch);
        match branch {
            Branch::Tool => own.collect(),
            Branch::Workpiece => own.rev().collect(),
        }
    }

    /// The tip in the table frame for the commands of a status, with the displacement of every joint at its command.
    pub fn tip_at(&self, status: &[f64], displacement: &dyn Fn(usize, f64) -> Isometry3<f64>) -> Point3<f64> {
        let body = |branch| {
            self.branch(branch).into_iter().fold(Isometry3::identity(), |body, place| {
                let command = status[self.joints[place].status];
                body * displacement(place, command) * self.joints[place].motion(command)
            })
        };
        body(Branch::Workpiece).inverse() * (body(Branch::Tool) * self.tip)
    }

    /// The status with commands of the linear axes with which the tip, displaced, is where the nominal tip is.
    ///
    /// Fails where linear axes do not span the space.
    pub fn corrected(
        &self,
        programmed: &[f64],
        displacement: &dyn Fn(usize, f64) -> Isometry3<f64>,
    ) -> Result<Vec<f64>> {
        let nominal = |status: &[f64]| self.tip_at(status, &|_, _| Isometry3::identity());
        let goal = nominal(programmed);
        let linear: Vec<&Joint> = self.joints.iter().filter(|joint| joint.kind == AxisKind::Linear).collect();
        let mut columns = Matrix3::zeros();
        for (place, joint) in linear.iter().enumerate().take(3) {
            let mut moved = programmed.to_vec();
            moved[joint.status] += 1.0;
            columns.set_column(place, &(nominal(&moved) - goal));
        }
        let steps = columns.try_inverse().filter(|inverse| linear.len() == 3 && inverse.amax() < 1e6);
        let steps = steps.ok_or_else(|| Error::data("the linear axes do not span the space here"))?;
        let mut status = programmed.to_vec();
        for _ in 0..PASSES {
            let left = self.tip_at(&status, displacement) - goal;
            if left.norm() < SETTLED {
                return Ok(status);
            }
            let step = steps * left;
            linear.iter().zip(step.iter()).for_each(|(joint, step)| status[joint.status] -= step);
        }
        Err(Error::data("no commands are found that correct this point"))
    }
}

/// The point of the line of an axis nearest to the origin, from a point and where a turn by [`TURN`] takes it.
fn center(joint: &Joint, from: &Point3<f64>, to: &Point3<f64>) -> Point3<f64> {
    let turn = if joint.branch == Branch::Tool { TURN } else { -TURN };
    let rotation = joint.turned(turn).to_rotation_matrix();
    let shift = to.coords - rotation * from.coords;
    // (1 - R) c = shift; across the axis 1 - R turns back by half of the angle and stretches by twice its sine.
    let back = Rotation3::new(joint.direction * (std::f64::consts::FRAC_PI_2 - turn / 2.0));
    Point3::from(back * shift / (2.0 * (turn / 2.0).sin()))
}

/// The pose of the tool in the table frame.
fn pose(model: &dyn KinematicModel, status: &[f64], values: &[f64]) -> Result<Isometry3<f64>> {
    let mut poses = Poses::default();
    model.poses(status, values, &[], true, &mut poses)?;
    let ([x, y, z], [w, i, j, k]) = (poses.positions[0], poses.orientations[0]);
    if ![x, y, z, w, i, j, k].iter().all(|value| value.is_finite()) {
        return Err(Error::data("the machine has no finite pose here"));
    }
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k))))
}

/// What is asked of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Its position and orientation errors.
    Location,
    /// Its error motions.
    Motion,
}

/// The errors of a calibrated machine, axis by axis.
pub struct Errors<'a> {
    model: &'a dyn KinematicModel,
    machine: &'a Machine,
    values: Vec<f64>,
}

impl<'a> Errors<'a> {
    /// The errors of a calibration.
    pub fn new(model: &'a dyn KinematicModel, machine: &'a Machine, calibration: &Calibration) -> Self {
        Self { model, machine, values: machine_values(model, calibration) }
    }

    /// An error of an axis at a command, all other axes at zero: the mean of both directions of its approach.
    pub fn of(&self, place: usize, part: Part, command: f64) -> Result<Six> {
        let [forward, backward] = [1.0, -1.0].map(|direction| self.approached(place, part, command, direction));
        let (forward, backward) = (forward?, backward?);
        Ok(std::array::from_fn(|component| 0.5 * (forward[component] + backward[component])))
    }

    fn approached(&self, place: usize, part: Part, command: f64, direction: f64) -> Result<Six> {
        let joint = &self.machine.joints[place];
        let mut status = self.machine.standing.clone();
        status[joint.status] = command;
        if let Some(column) = self.model.info().status_index(&StatusRole::Direction(joint.axis)) {
            status[column] = direction;
        }
        let with = pose(self.model, &status, &self.only(joint.axis, part))?;
        let without = pose(self.model, &status, &self.model.info().nominal)?;
        let relative = with * without.inverse();
        let displacement = match joint.branch {
            Branch::Tool => relative,
            Branch::Workpiece => {
                let motion = joint.motion(command);
                (motion * relative * motion.inverse()).inverse()
            }
        };
        Ok(joint.error(&displacement))
    }

    /// The values of the machine with only one part of the errors of one axis.
    fn only(&self, axis: usize, part: Part) -> Vec<f64> {
        let info = self.model.info();
        let keeps = |role: &ParameterRole| match role {
            ParameterRole::Motion { axis: own, .. } => *own == axis && part == Part::Motion,
            ParameterRole::Location { axis: own, .. } => *own == axis && part == Part::Location,
            ParameterRole::SetUp => false,
            _ => true,
        };
        let parameters = info.parameters.iter().zip(&info.nominal).zip(&self.values);
        parameters.map(|((parameter, nominal), value)| if keeps(&parameter.role) { *value } else { *nominal }).collect()
    }
}
