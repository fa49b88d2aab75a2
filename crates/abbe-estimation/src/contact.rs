//! Contact: commands of the linear axes at which the tip touches the artefact.

use std::cell::LazyCell;

use abbe_core::{
    AxisKind, CHUNK, Contact, EquationIndex, Error, Evaluation, IndexRange, KinematicModel, ObservationSet, PoseTable,
    Problem, RankPoint, Result, Row, RowIndex, SetIndex, Variable, in_parallel,
};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

/// Most steps of the search for a contact. Newton's iteration converges quadratically: it needs three or four.
const STEPS: usize = 20;

/// Tolerance of the equations of a measured row, mm (rad), and relative tolerance by the precision of a double: the larger of
/// the first and of the second times the largest coordinate is used.
const TOLERANCE: (f64, f64) = (1e-11, 1e-14);

/// Most steps to nominal contact.
const CONTACT_STEPS: usize = 12;

/// A step to nominal contact, mm, after which derivatives are those of before.
const NEAR: f64 = 1.0;

/// What is left of the way to nominal contact, mm: nothing.
const ROUNDED: f64 = 1e-13;

/// An effect of commands on the equations of a row below this, mm/mm, counts as zero.
const NO_EFFECT: f64 = 1e-6;

/// Variation of a parameter of the model from row to row while a problem is measured: a drift.
#[derive(Debug, Clone, PartialEq)]
pub struct Variation {
    /// Index of the parameter.
    pub parameter: usize,
    /// What is added to it, in its unit; one value for every row that is used, set by set.
    pub values: Vec<f64>,
}

/// The linear axes of a model.
struct LinearAxes {
    /// Their commands.
    commands: Vec<Variable>,
    /// Where their commands stand in a status.
    statuses: Vec<usize>,
}

impl LinearAxes {
    fn of(model: &dyn KinematicModel) -> Self {
        let axes = model.info().axes.iter().enumerate().filter(|(_, axis)| axis.kind == AxisKind::Linear);
        let (commands, statuses) = axes.map(|(index, axis)| (Variable::Command(index), axis.status)).unzip();
        Self { commands, statuses }
    }

    fn count(&self) -> usize {
        self.commands.len()
    }
}

/// What a row is moved to.
#[derive(Clone, Copy)]
enum Goal<'a> {
    /// Nominal contact: the contact tip of the feature, or residuals of zero, or the nominal reading.
    Contact,
    /// These residuals of its equations, one after another for the rows of the chunk.
    Residuals(&'a [f64]),
}

/// The same problem with every touched row moved to nominal contact by the model at `x`: the linear axes bring the tip to
/// [`Observations::contact_tip`](abbe_core::Observations::contact_tip), or move by as little as possible until the row's
/// equations hold.
///
/// Rank and condition are judged there ([`rank_point`]).
pub fn at_contact(problem: &Problem, x: &[f64]) -> Result<Problem> {
    with_contacts(problem, x, moves_to_contact)
}

/// The same problem at the poses where its rank and condition are judged: at nominal contact, by the model at `x`.
///
/// At recorded positions, residuals and lateral offsets of the contact act as if they were information: they increase
/// singular values that are really zero. Readings that come from errors do the same; their rows move to
/// [`ObservationsInfo::nominal_reading`](abbe_core::ObservationsInfo::nominal_reading). Rows without a contact point, and
/// rows whose readings give information beyond the errors, keep their recorded poses.
pub fn rank_point(problem: &Problem, x: &[f64]) -> Result<Problem> {
    with_contacts(problem, x, moves_to_be_judged)
}

/// Whether the rows are judged where they were recorded.
pub fn is_judged_as_recorded(problem: &Problem) -> bool {
    !problem.sets.iter().any(moves_to_be_judged)
}

/// The same problem at `x`. The rows of the sets for which `moves` is true are at nominal contact.
fn with_contacts(problem: &Problem, x: &[f64], moves: impl Fn(&ObservationSet) -> bool) -> Result<Problem> {
    let mut moved = problem.with_values(x);
    let linear = LinearAxes::of(problem.model.as_ref());
    let threads = problem.threads(linear.count());
    for (index, set) in SetIndex::enumerate(&problem.sets) {
        if !moves(set) || linear.count() == 0 || set.rows.is_empty() {
            continue;
        }
        let shares: Vec<&[RowIndex]> = set.rows.chunks(set.rows.len().div_ceil(threads)).collect();
        let tables = in_parallel(&shares, Some(threads), |rows| contacts(&moved, index, rows, &linear));
        let mut contacts = set.poses().clone();
        for (rows, table) in shares.into_iter().zip(tables) {
            let table = table?;
            set.poses_of(rows).for_each(|pose| contacts.row_mut(pose).copy_from_slice(table.row(pose)));
        }
        moved.sets[index].set_poses(contacts);
    }
    Ok(moved)
}

/// The statuses of a set with some of its rows at contact.
///
/// Derivatives to the commands hardly change on the way: those of the first step serve for the others, while these shrink as they should.
fn contacts(problem: &Problem, set: SetIndex, rows: &[RowIndex], linear: &LinearAxes) -> Result<PoseTable> {
    let (mut moved, mut work) = (problem.clone(), Evaluation::default());
    for chunk in rows.chunks(CHUNK) {
        let (mut last, mut is_near) = (f64::INFINITY, false);
        for _ in 0..CONTACT_STEPS {
            match is_near {
                true => moved.evaluate_again(set, chunk, &mut work)?,
                false => moved.evaluate(set, chunk, &linear.commands, &mut work)?,
            }
            let machine = &moved.machine_values;
            let step = move_by_step(&mut moved.sets[set], machine, chunk, linear, &work, Goal::Contact)?;
            // Newton's iteration converges quadratically: after a step below 1e-5 mm the error is below the rounding of a double. With
            // derivatives of before, steps go on shrinking as the last one did.
            if if is_near { step * step < ROUNDED * last } else { step < 1e-5 } {
                break;
            }
            is_near = step < NEAR.min(0.1 * last);
            last = step;
        }
    }
    Ok(moved.sets[set].poses().clone())
}

/// Simulates the measurement of a problem whose own values are the true ones. In every touched row the linear axes (or the
/// one axis that approaches) move by as little as possible from where they are, until each exact equation equals its error.
/// If a row has a reading, the reading takes up the difference.
///
/// `errors` has one value for every equation, mm or rad; constraints keep their residuals. `variations` change
/// parameters of the model from row to row. Fails for artefacts that are not simulated and, with the place of the row,
/// if the axes cannot make the equations equal their errors to 1e-11 mm.
pub fn simulate_measurement(problem: &Problem, errors: &[f64], variations: &[Variation]) -> Result<Problem> {
    let mut moved = problem.clone();
    let linear = LinearAxes::of(problem.model.as_ref());
    let mut work = Evaluation::default();
    // All rows of a chunk have the same parameters of the model.
    let size = if variations.is_empty() { CHUNK } else { 1 };
    let (mut first_row, mut first_equation) = (0, EquationIndex(0));
    for set in problem.set_indices() {
        for chunk in problem.sets[set].rows.chunks(size) {
            let equations = IndexRange::new(first_equation, moved.sets[set].equations_of(chunk).count());
            first_equation = equations.end();
            let errors = &errors[equations];
            vary(&mut moved, &problem.machine_values, variations, first_row);
            match &moved.sets[set].info().contact {
                Contact::LinearAxes => touch(&mut moved, set, chunk, &linear, errors, &mut work)?,
                Contact::Reading(_) | Contact::Readings(_) | Contact::Pose { .. } => {
                    read(&mut moved, set, chunk, errors, &mut work)?;
                }
                Contact::NotSimulated(why) => {
                    let error = Error::usage(format!("this artefact cannot be simulated yet: {why}"));
                    return Err(error.stage(&problem.sets[set].name));
                }
            }
            first_row += chunk.len();
        }
    }
    moved.machine_values.copy_from_slice(&problem.machine_values);
    Ok(moved)
}

/// Sets the varying parameters to their values on a row; rows are counted over all sets.
fn vary(problem: &mut Problem, machine: &[f64], variations: &[Variation], row: usize) {
    for Variation { parameter, .. } in variations {
        problem.machine_values[*parameter] = machine[*parameter];
    }
    for Variation { parameter, values } in variations {
        problem.machine_values[*parameter] += values[row];
    }
}

/// Moves some rows of a set until their equations equal `errors`.
fn touch(
    problem: &mut Problem,
    set: SetIndex,
    rows: &[RowIndex],
    linear: &LinearAxes,
    errors: &[f64],
    work: &mut Evaluation,
) -> Result<()> {
    for step in 0..=STEPS {
        problem.evaluate(set, rows, &linear.commands, work)?;
        let Some((row, off)) = not_yet(&problem.sets[set], rows, work, errors) else { return Ok(()) };
        if step == STEPS {
            return Err(unreachable(problem, set, row, off));
        }
        let machine = &problem.machine_values;
        move_by_step(&mut problem.sets[set], machine, rows, linear, work, Goal::Residuals(errors))?;
    }
    Ok(())
}

/// Changes the readings of some rows of a set so that their equations equal `errors`.
fn read(problem: &mut Problem, set: SetIndex, rows: &[RowIndex], errors: &[f64], work: &mut Evaluation) -> Result<()> {
    problem.evaluate(set, rows, &[], work)?;
    let set = &mut problem.sets[set];
    let observations = set.observations.clone();
    let (layout, disturbances) = (&observations.info().layout, set.disturbances_mut());
    let rows = rows.iter().map(|&row| layout.rows[row]);
    let equations = rows.flat_map(|row| row.equation_indices().map(move |equation| (equation, row.poses > 0)));
    for (((equation, measured), residual), error) in equations.zip(work.equations.residuals()).zip(errors) {
        if measured {
            disturbances[equation] += error - residual;
        }
    }
    Ok(())
}

fn unreachable(problem: &Problem, set: SetIndex, row: RowIndex, off: f64) -> Error {
    let feature = &problem.sets[set].name;
    let off = if off.is_finite() {
        format!("its equation stays off by {off:.3e} mm")
    } else {
        "it leaves all bounds".to_owned()
    };
    let error = Error::data(format!("the tip cannot reach `{feature}` in this row by its linear axes: {off}"))
        .help("the linear axes have to be able to move along the measured direction; are the values of the truth in mm and rad?");
    problem.error_at_row(set, row, error)
}

fn moves_to_contact(set: &ObservationSet) -> bool {
    set.info().contact == Contact::LinearAxes
}

fn moves_to_be_judged(set: &ObservationSet) -> bool {
    match &set.info().rank_point {
        RankPoint::AsRecorded => false,
        RankPoint::InContact => true,
        RankPoint::NominalReading(rows) => set.rows.iter().any(|row| rows.contains_key(row)),
    }
}

fn row_of(set: &ObservationSet, row: RowIndex) -> Row {
    set.info().layout.rows[row]
}

/// The first row whose equations are not equal to `errors` yet, and by how much they differ.
fn not_yet(set: &ObservationSet, rows: &[RowIndex], work: &Evaluation, errors: &[f64]) -> Option<(RowIndex, f64)> {
    let (mut equation, mut pose) = (0, 0);
    for &index in rows {
        let row = row_of(set, index);
        let tips = &work.poses.positions[pose..pose + row.poses];
        let size = tips.iter().flatten().fold(0.0_f64, |size, coordinate| size.max(coordinate.abs()));
        let equations = equation..equation + row.equations;
        let off = (work.equations.residuals()[equations.clone()].iter().zip(&errors[equations]))
            .map(|(residual, error)| (residual - error).abs())
            .find(|off| off.is_nan() || *off > TOLERANCE.0.max(TOLERANCE.1 * size));
        if let Some(off) = off.filter(|_| row.poses > 0) {
            return Some((index, off));
        }
        equation += row.equations;
        pose += row.poses;
    }
    None
}

/// Moves the linear axes of every row by the smallest step that brings its linearised equations to the goal; returns
/// the largest step in mm. `work` holds the evaluation of these rows with derivatives to the linear axes.
fn move_by_step(
    set: &mut ObservationSet,
    machine_values: &[f64],
    rows: &[RowIndex],
    linear: &LinearAxes,
    work: &Evaluation,
    goal: Goal<'_>,
) -> Result<f64> {
    let touched = moves_to_contact(set);
    if touched && !set.info().angles.is_empty() {
        return Ok(0.0); // Orientations are not touched into place by linear axes.
    }
    let count = linear.count();
    let inputs = set.inputs_with(machine_values);
    // Most artefacts that are touched know their contact tips, and need none.
    let gradients = LazyCell::new(|| {
        let mut gradients = gradients(work, set, rows, count);
        only_moving(set, rows, linear, goal, &mut gradients);
        gradients
    });
    let (mut equation, mut entry, mut pose, mut largest) = (0, 0, 0, 0.0_f64);
    let mut steps: Vec<f64> = Vec::new();
    for &index in rows {
        let row = row_of(set, index);
        let equations = equation..equation + row.equations;
        let to = |wanted: &[f64]| {
            let gradient = &gradients[entry * count..(entry + row.equations * row.poses) * count];
            smallest_step(gradient, &work.equations.residuals()[equations.clone()], wanted)
        };
        let step = match goal {
            Goal::Residuals(errors) => to(&errors[equations.clone()]),
            Goal::Contact if touched => {
                let known = if row.poses == 1 { contact_step(set, &inputs, index, pose, work, count)? } else { None };
                known.or_else(|| to(&vec![0.0; row.equations]))
            }
            Goal::Contact => nominal_residuals(set, index).and_then(|wanted| to(&wanted)),
        };
        match step {
            Some(step) => steps.extend(step),
            None => steps.extend(std::iter::repeat_n(0.0, row.poses * count)),
        }
        equation += row.equations;
        entry += row.equations * row.poses;
        pose += row.poses;
    }
    let mut steps = steps.chunks_exact(count.max(1));
    let observations = set.observations.clone();
    let (layout, table) = (&observations.info().layout, set.poses_mut());
    for row in rows.iter().map(|&row| layout.rows[row]) {
        for pose in row.pose_indices() {
            for (&status, step) in linear.statuses.iter().zip(steps.next().unwrap_or(&[])) {
                table.row_mut(pose)[status] += step;
                largest = largest.max(step.abs());
            }
        }
    }
    Ok(largest)
}

/// Sets the effects of axes that do not move to zero in the gradients of some rows: one axis alone approaches, or axes stand
/// still while a reading is taken.
fn only_moving(set: &ObservationSet, rows: &[RowIndex], linear: &LinearAxes, goal: Goal<'_>, gradients: &mut [f64]) {
    let mut entries = gradients.chunks_exact_mut(linear.count().max(1));
    for &index in rows {
        let row = row_of(set, index);
        let axes: Option<Vec<usize>> = match goal {
            Goal::Residuals(_) => set.info().approach(index).map(|approach| vec![approach.axis]),
            Goal::Contact => set.info().nominal_reading(index).map(|nominal| nominal.axes.clone()),
        };
        for entry in entries.by_ref().take(row.equations * row.poses) {
            let Some(axes) = &axes else { continue };
            for (effect, command) in entry.iter_mut().zip(&linear.commands) {
                if !axes.iter().any(|&axis| *command == Variable::Command(axis)) {
                    *effect = 0.0;
                }
            }
        }
    }
}

/// The residuals of a row at its nominal readings, with the disturbances of the set.
fn nominal_residuals(set: &ObservationSet, index: RowIndex) -> Option<Vec<f64>> {
    let (row, nominal) = (row_of(set, index), set.info().nominal_reading(index)?);
    let mut residuals = nominal.residuals.clone();
    if let Some(disturbances) = set.disturbances() {
        let added = &disturbances[row.equation_indices()];
        residuals.iter_mut().zip(added).for_each(|(residual, added)| *residual += added);
    }
    Some(residuals)
}

/// The step that brings the tip of a row with one pose to nominal contact; none if the artefact gives no contact tip.
fn contact_step(
    set: &ObservationSet,
    inputs: &[f64],
    row: RowIndex,
    pose: usize,
    work: &Evaluation,
    count: usize,
) -> Result<Option<Vec<f64>>> {
    let tip = work.poses.positions[pose];
    let Some(contact) = set.observations.contact_tip(row, tip, &set.own, inputs)? else { return Ok(None) };
    let derivatives = &work.poses.position_derivatives[pose * count..(pose + 1) * count];
    let missing = Vector3::from(contact) - Vector3::from(tip);
    if let Some(step) = smallest_step_of_three(count, |axis, command| derivatives[command][axis], missing) {
        return Ok(Some(step));
    }
    let gradient: Vec<f64> = (0..3).flat_map(|axis| derivatives.iter().map(move |by| by[axis])).collect();
    Ok(smallest_step(&gradient, &tip, &contact))
}

/// The smallest step after which linearised `values` equal `wanted`, or come as close as they can; `gradient` is values x
/// variables, row by row. None if nothing can be solved.
fn smallest_step(gradient: &[f64], values: &[f64], wanted: &[f64]) -> Option<Vec<f64>> {
    if gradient.is_empty() {
        return None;
    }
    if let ([value], [wanted]) = (values, wanted) {
        let square: f64 = gradient.iter().map(|slope| slope * slope).sum();
        let factor = (square > NO_EFFECT * NO_EFFECT).then_some((wanted - value) / square)?;
        return Some(gradient.iter().map(|slope| slope * factor).collect());
    }
    let count = gradient.len() / values.len();
    if let ([a, b, c], [x, y, z]) = (values, wanted) {
        let entry = |value: usize, variable: usize| gradient[value * count + variable];
        if let Some(step) = smallest_step_of_three(count, entry, Vector3::new(x - a, y - b, z - c)) {
            return Some(step);
        }
    }
    let gradient = DMatrix::from_row_slice(values.len(), count, gradient);
    let missing = DVector::from_iterator(values.len(), wanted.iter().zip(values).map(|(wanted, value)| wanted - value));
    // A singular value decomposition of values that are not finite would not end.
    let finite = gradient.iter().chain(&missing).all(|value| value.is_finite());
    let step = finite.then(|| gradient.svd(true, true).solve(&missing, NO_EFFECT))?.ok()?;
    Some(step.as_slice().to_vec())
}

/// [`smallest_step`] by normal equations for three values that miss something, which is enough for most rows; none if they are too
/// close to singular. `gradient` is the derivative of a value to one of `count` variables.
fn smallest_step_of_three(
    count: usize,
    gradient: impl Fn(usize, usize) -> f64,
    missing: Vector3<f64>,
) -> Option<Vec<f64>> {
    let product = |i: usize, j: usize| (0..count).map(|k| gradient(i, k) * gradient(j, k)).sum::<f64>();
    let normal = Matrix3::from_fn(product);
    if normal.determinant() <= 1e-3 * (normal.trace() / 3.0).powi(3) {
        return None;
    }
    let factors = normal.try_inverse()? * missing;
    Some((0..count).map(|k| (0..3).map(|i| factors[i] * gradient(i, k)).sum()).collect())
}

/// Derivatives of every equation to the linear axes of every pose of its row: equations x poses x axes.
pub(crate) fn gradients(work: &Evaluation, set: &ObservationSet, rows: &[RowIndex], count: usize) -> Vec<f64> {
    let mut gradients = vec![0.0; work.equations.by_position().len() * count];
    work.chain(set, rows, count, |_, pair, derivatives, weight| {
        let effects = gradients[pair * count..(pair + 1) * count].iter_mut().zip(derivatives);
        effects.for_each(|(effect, derivative)| {
            *effect += (0..3).map(|axis| derivative[axis] * weight[axis]).sum::<f64>()
        });
    });
    gradients
}
