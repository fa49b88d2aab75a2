//! A small machine with errors, and its measurements: data for tests without data.

use std::path::PathBuf;
use std::sync::Arc;

use abbe_core::rotation::left_jacobian;
use abbe_core::{
    Absent, Axis, AxisKind, Branch, Column, ColumnHeader, Contact, Dataset, Equations, ErrorFunction, KinematicModel,
    Layout, ModelInfo, MotionError, ObservationSet, Observations, ObservationsInfo, Owner, Parameter, ParameterRole,
    PoseBatch, PosesMut, Problem, Quantity, Result, RowBatch, RowIndex, RowOrigin, StatusColumn, StatusRole, Unit,
    Values, Variable, plain_naming,
};
use nalgebra::{UnitQuaternion, Vector3};

/// Names, units and roles of the parameters: scales, squareness errors, tool offset.
fn parameters() -> Vec<Parameter> {
    let scale = Unit::per(Quantity::Length, Quantity::Length, 1);
    let motion = |axis| ParameterRole::Motion { axis, component: axis };
    let location = |axis, component| ParameterRole::Location { axis, component };
    let all = [
        ("EXX[1]", scale, motion(0)),
        ("EYY[1]", scale, motion(1)),
        ("EZZ[1]", scale, motion(2)),
        ("EC0Y", Unit::RAD, location(1, 5)),
        ("EA0Z", Unit::RAD, location(2, 3)),
        ("EB0Z", Unit::RAD, location(2, 4)),
        ("dxt", Unit::MM, ParameterRole::SetUp),
        ("dyt", Unit::MM, ParameterRole::SetUp),
        ("dzt", Unit::MM, ParameterRole::SetUp),
    ];
    all.map(|(name, unit, role)| Parameter::new(name, unit).with_role(role)).to_vec()
}

/// The errors that the machine has, in the order of its parameters.
const ERRORS: [f64; 9] = [2e-5, -3e-5, 4e-5, 5e-5, -6e-5, 7e-5, 0.02, -0.03, 0.04];

/// How the virtual machine measures.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Measurement {
    /// The rows come in the opposite order.
    pub reversed: bool,
    /// Position of the zero of the axes, mm: commands are counted from there.
    pub origin: [f64; 3],
    /// Position and orientation of the artefact, mm and rad: unknowns of the problem; none if the artefact is at its nominal
    /// position.
    pub placement: Option<[f64; 6]>,
}

/// A problem that every estimator of measurements can solve, with its solution: a machine of three linear axes touches
/// twelve points that are known. Nine unknowns, thirty-six equations that hold exactly at the solution (mm and rad, in the
/// order of the unknowns).
///
/// Fails only if [`Problem::new`] refuses a correct problem.
pub fn virtual_problem() -> Result<(Problem, Vec<f64>)> {
    measured(&Measurement::default())
}

/// The problem of a measurement, with its solution.
pub(super) fn measured(measurement: &Measurement) -> Result<(Problem, Vec<f64>)> {
    let model = Arc::new(Machine::new(measurement.origin));
    let placed = measurement.placement.unwrap_or_default();
    let mut points = points();
    if measurement.reversed {
        points.reverse();
    }
    let commands: Vec<[f64; 3]> = points.iter().map(|point| model.command(place(point, &placed))).collect();
    let data = Arc::new(dataset(&commands));
    let mut layout = Layout::new(&data, model.as_ref(), &[&plain_naming])?;
    for row in data.row_indices() {
        layout.push(model.as_ref(), row, &[1e-3; 3])?;
    }
    let own = ["x", "y", "z", "a", "b", "c"].into_iter().zip([Unit::MM, Unit::RAD].into_iter().flat_map(|u| [u; 3]));
    let own: Vec<Parameter> = match measurement.placement {
        Some(_) => own.map(|(name, unit)| Parameter::new(name, unit).with_role(ParameterRole::Feature)).collect(),
        None => Vec::new(),
    };
    // An unknown position of the artefact absorbs the offset of the tool.
    let known = if own.is_empty() { 9 } else { 6 };
    let info = ObservationsInfo::new(layout, own, Contact::LinearAxes);
    let set = ObservationSet::new("points", Arc::new(Touches { info, points }));
    let names: Vec<String> = model.info.parameters.iter().take(known).map(|parameter| parameter.name.clone()).collect();
    let patterns = [names, measurement.placement.iter().map(|_| "points.*".to_owned()).collect()].concat();
    let mut problem = Problem::new("virtual", "virtual", model.clone(), vec![set], &patterns)?;
    problem.machine_values[known..].copy_from_slice(&ERRORS[known..]);
    let value = |(owner, index): (Owner, usize)| if owner == Owner::Machine { ERRORS[index] } else { placed[index] };
    let solution = problem.unknowns.iter().map(|unknown| value((unknown.owner, unknown.index))).collect();
    Ok((problem, solution))
}

/// The points of the artefact: the corners of a box, and four inside of it.
fn points() -> Vec<[f64; 3]> {
    let corners = (0..8).map(|k| [k & 1, k >> 1 & 1, k >> 2 & 1].map(|side| if side == 1 { 180.0 } else { -140.0 }));
    corners.chain([[30.0, -70.0, 90.0], [-60.0, 80.0, 20.0], [110.0, 40.0, -30.0], [-20.0, -10.0, 120.0]]).collect()
}

/// A point of the artefact, placed by a shift and a rotation vector.
fn place(point: &[f64; 3], placement: &[f64]) -> Vector3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(placement[3], placement[4], placement[5]));
    Vector3::new(placement[0], placement[1], placement[2]) + turn * Vector3::from(*point)
}

fn dataset(commands: &[[f64; 3]]) -> Dataset {
    let column = |axis: usize| Column {
        header: ColumnHeader::parse(["X_mm", "Y_mm", "Z_mm"][axis]),
        values: Values::Numbers(commands.iter().map(|command| command[axis]).collect()),
    };
    Dataset {
        columns: (0..3).map(column).collect(),
        origins: (0..commands.len()).map(|row| RowOrigin { file: 0, line: row + 2, row: row + 1 }).collect(),
        files: vec![PathBuf::from("virtual.csv")],
        averaged: false,
        is_log: false,
        stated_tips: Vec::new(),
    }
}

/// Three linear axes X, Y, Z that carry one another and the tool; the workpiece stands still.
struct Machine {
    info: ModelInfo,
    /// Position of the zero of the axes, mm.
    origin: Vector3<f64>,
}

impl Machine {
    fn new(origin: [f64; 3]) -> Self {
        let names = ["X", "Y", "Z"];
        let axis = |(status, name): (usize, &str)| Axis {
            name: name.to_owned(),
            kind: AxisKind::Linear,
            branch: Branch::Tool,
            sense: 1.0,
            direction: Vector3::ith(status, 1.0).into(),
            range: Some([origin[status] - 200.0, origin[status] + 200.0]),
            indexed: false,
            endless: false,
            status,
        };
        let column = |(axis, name): (usize, &str)| StatusColumn {
            name: name.to_owned(),
            role: StatusRole::Command(axis),
            quantity: Quantity::Length,
            levels: Vec::new(),
            absent: Absent::Required,
        };
        let function = |(axis, name): (usize, &str)| ErrorFunction {
            symbol: format!("E{name}{name}"),
            axis,
            component: axis,
            quantity: Quantity::Length,
        };
        let named = || names.into_iter().enumerate();
        let (axes, status) = (named().map(axis).collect(), named().map(column).collect());
        let error_functions = named().map(function).collect();
        let info = ModelInfo { error_functions, ..ModelInfo::new(axes, status, parameters(), Default::default()) };
        Self { info, origin: origin.into() }
    }

    /// The tip position. Errors grow with the commands, from the zero of the axes. The nominal tip position is the commands
    /// minus the position of the zero.
    fn tip(&self, q: &[f64], p: &[f64]) -> Vector3<f64> {
        let x = q[0] * p[0] - q[1] * p[3] + q[2] * p[5] + p[6];
        let y = q[1] * p[1] - q[2] * p[4] + p[7];
        let z = q[2] * p[2] + p[8];
        Vector3::new(q[0] + x, q[1] + y, q[2] + z) - self.origin
    }

    /// The commands at which the tip with its errors is at a point.
    fn command(&self, point: Vector3<f64>) -> [f64; 3] {
        let (p, wanted) = (&ERRORS, point + self.origin);
        let z = (wanted.z - p[8]) / (1.0 + p[2]);
        let y = (wanted.y - p[7] + z * p[4]) / (1.0 + p[1]);
        let x = (wanted.x - p[6] + y * p[3] - z * p[5]) / (1.0 + p[0]);
        [x, y, z]
    }
}

impl KinematicModel for Machine {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn evaluate(&self, batch: PoseBatch<'_>, out: PosesMut<'_>) -> Result<()> {
        let PoseBatch { statuses, values: p, wanted, .. } = batch;
        out.orientations.fill([1.0, 0.0, 0.0, 0.0]);
        for (pose, q) in statuses.chunks_exact(3).enumerate() {
            out.positions[pose] = self.tip(q, p).into();
            for (k, variable) in wanted.iter().enumerate() {
                out.position_derivatives[pose * wanted.len() + k] = match *variable {
                    Variable::Command(0) => [1.0 + p[0], 0.0, 0.0],
                    Variable::Command(1) => [-p[3], 1.0 + p[1], 0.0],
                    Variable::Command(_) => [p[5], -p[4], 1.0 + p[2]],
                    Variable::Parameter(axis @ 0..3) => Vector3::ith(axis, q[axis]).into(),
                    Variable::Parameter(3) => [-q[1], 0.0, 0.0],
                    Variable::Parameter(4) => [0.0, -q[2], 0.0],
                    Variable::Parameter(5) => [q[2], 0.0, 0.0],
                    Variable::Parameter(offset) => Vector3::ith(offset - 6, 1.0).into(),
                };
            }
        }
        Ok(())
    }

    fn motion_error(&self, function: &ErrorFunction, values: &[f64], status: &[f64]) -> Result<MotionError> {
        let (axis, at) = (function.axis, status[function.axis]);
        Ok(MotionError { value: values[axis] * at, derivatives: vec![(axis, at)] })
    }
}

/// Touches on the points.
struct Touches {
    info: ObservationsInfo,
    points: Vec<[f64; 3]>,
}

impl Observations for Touches {
    fn info(&self) -> &ObservationsInfo {
        &self.info
    }

    fn evaluate(&self, batch: RowBatch<'_>, out: &mut Equations) -> Result<()> {
        for (&RowIndex(row), tip) in batch.rows.iter().zip(batch.positions) {
            let placement = if batch.own.is_empty() { &[0.0; 6][..] } else { batch.own };
            let point = place(&self.points[row], placement);
            let arm = point - Vector3::new(placement[0], placement[1], placement[2]);
            let by_turn = -arm.cross_matrix() * left_jacobian(&Vector3::new(placement[3], placement[4], placement[5]));
            for axis in 0..3 {
                out.equation(tip[axis] - point[axis]);
                out.position(Vector3::ith(axis, 1.0).into());
                if !batch.own.is_empty() {
                    out.own(axis, -1.0);
                    (0..3).for_each(|turn| out.own(3 + turn, -by_turn[(axis, turn)]));
                }
            }
        }
        Ok(())
    }

    fn contact_tip(&self, RowIndex(row): RowIndex, _: [f64; 3], own: &[f64], _: &[f64]) -> Result<Option<[f64; 3]>> {
        let placement = if own.is_empty() { &[0.0; 6][..] } else { own };
        Ok(Some(place(&self.points[row], placement).into()))
    }
}
