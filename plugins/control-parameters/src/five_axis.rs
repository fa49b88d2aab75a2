//! Axes of rotation of a machine with its location errors, and what a five-axis transformation does that knows them.
//!
//! The frame of the control: its coordinates are the commands of X, Y and Z, and a place has those commands with which the tip,
//! all rotary axes at zero, stands on it. A control computes
//!
//! `x = table(q) p + tip - head(q) tip`
//!
//! from the programmed place `p` of the workpiece, with the turns of its rotary axes about the lines that it knows.

use abbe_compensation::check_confounded;
use abbe_compensation::rigid::{Errors, Joint, Machine, Part};
use abbe_core::{AxisKind, Branch, Calibration, CommandCorrection, Error, KinematicModel, Result};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

use crate::linear::AXES;

/// The nominal transformation has to place the tip as the model does, to this distance, mm.
const SAME: f64 = 1e-6;

/// Axes of the nominal machine are those of the control to this much.
const PARALLEL: f64 = 1e-9;

/// An axis of rotation, all axes at zero, in the frame of the control.
#[derive(Debug, Clone)]
pub struct Line {
    pub name: String,
    /// A point of it. For tables the one next to the origin of the table frame, for heads the one next to the tip.
    pub point: Point3<f64>,
    /// Unit direction about which a positive command turns the body that the axis carries.
    pub direction: Vector3<f64>,
    status: usize,
}

impl Line {
    fn turn(&self, status: &[f64]) -> Isometry3<f64> {
        let turn = UnitQuaternion::new(self.direction * status[self.status]);
        let there = Translation3::from(self.point.coords);
        there * Isometry3::from_parts(Translation3::identity(), turn) * there.inverse()
    }

    fn moved(&self, by: &Isometry3<f64>) -> Self {
        Self { point: by * self.point, direction: by * self.direction, ..self.clone() }
    }
}

/// What a control knows of the rotary axes, those next to the bed first.
#[derive(Debug, Clone)]
pub struct Transformation {
    pub table: Vec<Line>,
    /// Points are told from the tip.
    pub head: Vec<Line>,
}

impl Transformation {
    /// How the tip moves by the turns of the head.
    fn swing(&self, status: &[f64]) -> Vector3<f64> {
        product(&self.head, status).translation.vector
    }

    /// The place on the workpiece where the tip is.
    fn place(&self, status: &[f64], commands: Vector3<f64>) -> Point3<f64> {
        product(&self.table, status).inverse() * Point3::from(commands + self.swing(status))
    }

    /// Commands of X, Y and Z with which the tip is at a place on the workpiece.
    fn commands(&self, status: &[f64], place: &Point3<f64>) -> Vector3<f64> {
        (product(&self.table, status) * place).coords - self.swing(status)
    }
}

fn product(lines: &[Line], status: &[f64]) -> Isometry3<f64> {
    lines.iter().fold(Isometry3::identity(), |body, line| body * line.turn(status))
}

/// A machine with rotary axes outside its linear ones X, Y and Z.
pub struct FiveAxes {
    pub nominal: Transformation,
    /// With location errors of the rotary axes.
    pub actual: Transformation,
    /// How these errors move the workpiece in the frame of the control, all axes at zero: new places from present ones.
    pub workpiece: Isometry3<f64>,
    columns: [usize; 3],
    width: usize,
}

impl FiveAxes {
    /// Fails for other machines.
    pub fn new(calibration: &Calibration, model: &dyn KinematicModel) -> Result<Self> {
        let machine = Machine::new(model)?;
        let columns = columns(&machine)?;
        let places = places(&machine);
        check_confounded(model, calibration, &places.concat())?;
        let errors = Errors::new(model, &machine, calibration);
        let (table, moved) = branch(&machine, &errors, Branch::Workpiece)?;
        let (head, tool) = branch(&machine, &errors, Branch::Tool)?;
        let (tip, actual_tip) = (machine.tip.coords, tool * machine.tip);
        let from = |tip: Vector3<f64>, [table, head]: [&[Line]; 2]| {
            let by = Isometry3::from(Translation3::from(-tip));
            let moved = |lines: &[Line]| lines.iter().map(|line| line.moved(&by)).collect();
            Transformation { table: moved(table), head: moved(head) }
        };
        let nominal = from(tip, [&table.nominal, &head.nominal]);
        let actual = from(actual_tip.coords, [&table.actual, &head.actual]);
        let workpiece = Translation3::from(-actual_tip.coords) * moved * Translation3::from(tip);
        let found = Self { nominal, actual, workpiece, columns, width: model.info().status.len() };
        found.check(&machine, &places)?;
        Ok(found)
    }

    fn linear(&self, status: &[f64]) -> Vector3<f64> {
        Vector3::from(self.columns.map(|column| status[column]))
    }

    /// Fails unless the nominal transformation is the nominal machine.
    fn check(&self, machine: &Machine, places: &[Vec<f64>]) -> Result<()> {
        let is_same = |status: &Vec<f64>| {
            let expected = machine.tip_at(status, &|_, _| Isometry3::identity()) - machine.tip.coords;
            (self.nominal.place(status, self.linear(status)) - expected).norm() <= SAME
        };
        match places.iter().all(is_same) {
            true => Ok(()),
            false => Err(Error::usage("a rotary axis of the machine stands between its linear axes")
                .help("five-axis transformations know rotary axes next to the workpiece and next to the tool")),
        }
    }

    /// What a control does that knows these axes, with this motion of its workpiece frame. Now it knows the nominal ones.
    pub fn predicted(&self, new: Transformation, workpiece: Isometry3<f64>) -> Box<dyn CommandCorrection> {
        Box::new(Predicted {
            nominal: self.nominal.clone(),
            new,
            workpiece,
            columns: self.columns,
            width: self.width.max(1),
        })
    }
}

/// The columns of the commands of X, Y and Z, which move the tool as the coordinates of the control say.
fn columns(machine: &Machine) -> Result<[usize; 3]> {
    let count = machine.joints.iter().filter(|joint| joint.kind == AxisKind::Linear).count();
    if count != 3 {
        return Err(Error::usage(format!("the machine has {count} linear axes; X, Y and Z were expected")));
    }
    let column = |(place, name): (usize, &str)| {
        let found = machine.joints.iter().find(|joint| joint.kind == AxisKind::Linear && joint.name == name);
        let joint = found.ok_or_else(|| Error::usage(format!("the machine has no linear axis {name}")))?;
        let sense = if joint.branch == Branch::Tool { 1.0 } else { -1.0 };
        if (joint.direction * sense - Vector3::ith(place, 1.0)).norm() > PARALLEL {
            return Err(Error::usage(format!("{name} does not move the tool in the direction of +{name}"))
                .help("the directions of the machine description are those of the machine frame of the control"));
        }
        Ok(joint.status)
    };
    Ok([column((0, AXES[0]))?, column((1, AXES[1]))?, column((2, AXES[2]))?])
}

/// Statuses near zero of all axes.
fn places(machine: &Machine) -> Vec<Vec<f64>> {
    let at = |turn: u32| {
        let mut status = machine.standing.clone();
        for (place, joint) in machine.joints.iter().enumerate() {
            let part = (f64::from(turn) * (1.3 + place as f64)).sin();
            status[joint.status] = if joint.kind == AxisKind::Linear { 100.0 * part } else { part };
        }
        status
    };
    (0..=6).map(at).collect()
}

/// The rotary axes of a branch in the table frame.
struct Lines {
    nominal: Vec<Line>,
    actual: Vec<Line>,
}

/// Also the displacement of what the last one of them carries.
fn branch(machine: &Machine, errors: &Errors<'_>, branch: Branch) -> Result<(Lines, Isometry3<f64>)> {
    let mut lines = Lines { nominal: Vec::new(), actual: Vec::new() };
    let mut body = Isometry3::identity();
    let near = if branch == Branch::Tool { machine.tip } else { Point3::origin() };
    for place in machine.branch(branch) {
        let joint = &machine.joints[place];
        if joint.kind == AxisKind::Rotary {
            body *= joint.displaced(&errors.of(place, Part::Location, 0.0)?);
            let line = line(joint, &near);
            lines.actual.push(line.moved(&body));
            lines.nominal.push(line);
        }
    }
    Ok((lines, body))
}

fn line(joint: &Joint, near: &Point3<f64>) -> Line {
    let along = (near - joint.point).dot(&joint.direction);
    Line {
        name: joint.name.clone(),
        point: joint.point + joint.direction * along,
        direction: joint.direction,
        status: joint.status,
    }
}

/// The part of a vector across one or two directions.
pub fn across(vector: Vector3<f64>, directions: &[Vector3<f64>]) -> Vector3<f64> {
    let without = |vector: Vector3<f64>, direction: Vector3<f64>| vector - direction * vector.dot(&direction);
    let (first, second) = match directions {
        [first, second] => (*first, without(*second, *first)),
        [first] => (*first, Vector3::zeros()),
        _ => return vector,
    };
    let rest = without(vector, first);
    if second.norm() > PARALLEL { without(rest, second.normalize()) } else { rest }
}

/// A control that knew the nominal axes and knows others now.
struct Predicted {
    nominal: Transformation,
    new: Transformation,
    workpiece: Isometry3<f64>,
    columns: [usize; 3],
    width: usize,
}

impl CommandCorrection for Predicted {
    fn commands(&self, programmed: &[f64]) -> Result<Vec<f64>> {
        let mut found = programmed.to_vec();
        for status in found.chunks_mut(self.width) {
            let linear = Vector3::from(self.columns.map(|column| status[column]));
            let place = self.workpiece * self.nominal.place(status, linear);
            let commands = self.new.commands(status, &place);
            self.columns.iter().zip(commands.iter()).for_each(|(&column, command)| status[column] = *command);
        }
        Ok(found)
    }
}
