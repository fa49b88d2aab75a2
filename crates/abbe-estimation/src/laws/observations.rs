//! Laws of observations.

use abbe_core::{
    EquationIndex, Equations, Evaluation, ObservationSet, Problem, Quantity, Result, RowBatch, RowIndex, SetIndex,
};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::{agrees, names};

/// Most rows of a set that are looked at, evenly spread.
const ROWS: usize = 24;

/// By how much a derivative may differ from the quotient of differences, relative to the larger of it and 1.
const ALLOWED: f64 = 1e-5;

/// The laws that the observations of a set of a problem break, at the problem's own values; empty if they keep them:
///
/// - derivatives to tip positions, orientations, own unknowns and known inputs agree with difference quotients;
/// - a row gives the same alone as among others, in any order;
/// - every row has as many equations as its layout says, and every name is unique;
/// - some equation depends on something: a position, an orientation, an unknown or an input.
///
/// Fails where the machine has no pose in a row.
pub fn check_observations(problem: &Problem, set: SetIndex) -> Result<Vec<String>> {
    let observations = &problem.sets[set];
    let inputs = observations.info().inputs.iter().map(|input| &input.parameter);
    let mut broken = names(observations.info().unknowns.iter().chain(inputs));
    let inputs = observations.inputs_with(&problem.machine_values);
    let rows = spread(&observations.rows);
    let mut together = Evaluation::default();
    problem.evaluate(set, &rows, &[], &mut together)?;
    let mut found = Vec::new();
    let mut backwards = rows.clone();
    backwards.reverse();
    for row in backwards {
        let mut alone = Evaluation::default();
        problem.evaluate(set, &[row], &[], &mut alone)?;
        let wanted = observations.info().layout.rows[row].equations;
        if alone.equations.residuals().len() != wanted {
            broken.push(format!("row {row} has {} equations, not {wanted}", alone.equations.residuals().len()));
            return Ok(broken);
        }
        broken.extend(Row { set: observations, inputs: &inputs, row, at: &alone }.derivatives()?);
        found.push(alone.equations);
    }
    found.reverse();
    if !found.is_empty() && !found.iter().any(depends) {
        broken.push("no equation depends on a position, an orientation, an unknown or an input".to_owned());
    }
    let alone = found.iter().flat_map(|equations| equations.residuals().iter().copied());
    let together = together.equations.residuals();
    if !alone.zip(together).all(|(one, other)| (one - other).abs() <= 1e-12 * one.abs().max(1.0)) {
        broken.push("a row gives other residuals alone than among others".to_owned());
    }
    Ok(broken)
}

/// Part of the sum of the absolute products by which a sum of products may differ: rounding.
const ROUNDED: f64 = 1e-11;

/// Whether the sums that [`Problem::gradient`] makes without rows are those of the rows, at the problem's own values; empty if they are.
///
/// Fails where the machine has no pose in a row.
pub fn check_gradient(problem: &Problem) -> Result<Vec<String>> {
    let start = problem.start();
    // Any numbers will do; not all rows count alike.
    let counts = |equation: EquationIndex, residual: f64| residual + 0.1 + 0.01 * (equation.0 % 7) as f64;
    let (found, residuals) = problem.gradient(&start, &counts)?;
    let (mut sums, mut sizes, mut of_rows) = (vec![0.0; start.len()], vec![0.0; start.len()], Vec::new());
    problem.linearise(&start, |block| {
        for (equation, residual, line) in block.lines() {
            of_rows.push(residual);
            for ((sum, size), derivative) in sums.iter_mut().zip(&mut sizes).zip(line) {
                let product: f64 = derivative * counts(equation, residual);
                *sum += product;
                *size += product.abs();
            }
        }
    })?;
    let differs = |(_, ((found, sum), size)): &(_, ((&f64, &f64), &f64))| (*found - *sum).abs() > ROUNDED * *size;
    let all = problem.unknowns.iter().zip(found.iter().zip(&sums).zip(&sizes));
    let broken = all.filter(differs).map(|(unknown, ((found, sum), _))| {
        format!("the gradient to `{}` is {found:e}, and {sum:e} by the rows", unknown.name)
    });
    let mut broken: Vec<String> = broken.collect();
    if residuals != of_rows {
        broken.push("the gradient comes with other residuals than the rows have".to_owned());
    }
    Ok(broken)
}

/// Whether a derivative is not zero.
fn depends(equations: &Equations) -> bool {
    let of_poses = equations.by_position().iter().chain(equations.by_rotation()).flatten();
    let others = equations.by_own().iter().chain(equations.by_input()).map(|by| &by.2);
    of_poses.chain(others).any(|derivative| *derivative != 0.0)
}

fn spread(rows: &[RowIndex]) -> Vec<RowIndex> {
    let count = rows.len().min(ROWS);
    (0..count).map(|k| rows[k * rows.len() / count]).collect()
}

/// One row, with its poses and equations.
struct Row<'a> {
    set: &'a ObservationSet,
    inputs: &'a [f64],
    row: RowIndex,
    at: &'a Evaluation,
}

/// The variable of a derivative.
#[derive(Debug, Clone, Copy)]
enum To {
    Position(usize, usize),
    Rotation(usize, usize),
    Own(usize),
    Input(usize),
}

impl Row<'_> {
    /// The derivatives that do not agree with difference quotients.
    fn derivatives(&self) -> Result<Vec<String>> {
        let poses = self.at.poses.positions.len();
        let turned = !self.at.equations.by_rotation().is_empty();
        let axes = || (0..poses).flat_map(|pose| (0..3).map(move |axis| (pose, axis)));
        let mut all: Vec<To> = axes().map(|(pose, axis)| To::Position(pose, axis)).collect();
        all.extend(axes().filter(|_| turned).map(|(pose, axis)| To::Rotation(pose, axis)));
        all.extend((0..self.set.own.len()).map(To::Own));
        all.extend((0..self.set.inputs.len()).map(To::Input));
        let mut broken = Vec::new();
        for to in all {
            let step = self.step(to);
            let (up, down) = (self.residuals(to, step)?, self.residuals(to, -step)?);
            for (equation, (up, down)) in up.iter().zip(&down).enumerate() {
                let (given, found) = (self.given(to, equation), (up - down) / (2.0 * step));
                if !agrees(given, found, ALLOWED) {
                    broken.push(format!(
                        "row {}, equation {equation}: the derivative to {} is {found:.6e} by differences, and given as {given:.6e}",
                        self.row,
                        self.name(to)
                    ));
                }
            }
        }
        Ok(broken)
    }

    fn name(&self, to: To) -> String {
        match to {
            To::Position(pose, axis) => format!("{} of the tip of pose {pose}", ["x", "y", "z"][axis]),
            To::Rotation(pose, axis) => format!("the rotation about {} of pose {pose}", ["x", "y", "z"][axis]),
            To::Own(index) => format!("`{}`", self.set.info().unknowns[index].name),
            To::Input(index) => format!("`{}`", self.set.info().inputs[index].parameter.name),
        }
    }

    /// A step that changes residuals by micrometres or more. Its second-order effect is only nanometres.
    fn step(&self, to: To) -> f64 {
        let parameter = match to {
            To::Position(..) => return 1e-3,
            To::Rotation(..) => return 1e-5,
            To::Own(index) => &self.set.info().unknowns[index],
            To::Input(index) => &self.set.info().inputs[index].parameter,
        };
        match (parameter.unit.of, parameter.unit.per) {
            (Quantity::Length, None) => 1e-3,
            (Quantity::Angle, None) => 1e-5,
            (Quantity::Temperature, None) => 1e-1,
            _ => 1e-6,
        }
    }

    /// The residuals after a step.
    fn residuals(&self, to: To, step: f64) -> Result<Vec<f64>> {
        let (mut positions, mut orientations) = (self.at.poses.positions.clone(), self.at.poses.orientations.clone());
        let (mut own, mut inputs) = (self.set.own.clone(), self.inputs.to_vec());
        match to {
            To::Position(pose, axis) => positions[pose][axis] += step,
            To::Rotation(pose, axis) => {
                let [w, x, y, z] = orientations[pose];
                let turn = UnitQuaternion::from_scaled_axis(Vector3::ith(axis, step));
                let turned = turn * UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
                orientations[pose] = [turned.w, turned.i, turned.j, turned.k];
            }
            To::Own(index) => own[index] += step,
            To::Input(index) => inputs[index] += step,
        }
        let (positions, orientations) = (&positions, &orientations);
        let batch = RowBatch { rows: &[self.row], positions, orientations, own: &own, inputs: &inputs };
        let mut equations = Equations::default();
        self.set.observations.evaluate(batch, &mut equations)?;
        Ok(equations.residuals().to_vec())
    }

    /// The derivative that the artefact gives.
    fn given(&self, to: To, equation: usize) -> f64 {
        let (equations, poses) = (&self.at.equations, self.at.poses.positions.len());
        let of = |list: &[(usize, usize, f64)], index: usize| {
            let same = list.iter().filter(|(of, to, _)| (*of, *to) == (equation, index));
            same.map(|(_, _, derivative)| derivative).sum()
        };
        match to {
            To::Position(pose, axis) => equations.by_position()[equation * poses + pose][axis],
            To::Rotation(pose, axis) => equations.by_rotation()[equation * poses + pose][axis],
            To::Own(index) => of(equations.by_own(), index),
            To::Input(index) => of(equations.by_input(), index),
        }
    }
}
