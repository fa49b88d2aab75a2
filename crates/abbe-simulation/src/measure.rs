//! Simulates a measurement: from a programme to what a machine with errors records.

use abbe_core::{Contact, ObservationSet, Problem, Result};
use abbe_estimation::{at_contact, contact};

use crate::noise::Noise;
use crate::truth::Truth;

/// The same problem as if it had been measured on the machine `truth`: the statuses of its rows are those at which the
/// erroneous tip meets the erroneous artefact, its readings what is read there.
///
/// The rows of the problem are the programme: it states features, rotary axes, directions and times. The positions of the
/// linear axes are start values only. Nothing else changes: start values, known inputs and uncertainties stay what they are,
/// so that an estimator can solve the result at once. The same `seed` gives the same numbers. Those of a row depend only on
/// the seed, the index of its set and its index in the set's layout.
///
/// Values of the truth for errors and features that the problem does not have are left out, with a warning. Fails for values
/// that are not finite, for wrong names, and for a row in which the linear axes cannot bring the tip to the artefact.
pub fn measure(problem: &Problem, truth: &Truth, seed: u64) -> Result<Problem> {
    truth.check()?;
    truth.left_out(problem)?.warn();
    let machine = truth.of(&at_contact(&nominal(problem), &[])?);
    let errors = truth.noise.errors(&machine, seed)?;
    let mut measured = contact::simulate_measurement(&machine, &errors, &truth.noise.variations(&machine)?)?;
    measured.machine_values.clone_from(&problem.machine_values);
    for (set, of) in measured.sets.iter_mut().zip(&problem.sets) {
        set.own.clone_from(&of.own);
        set.inputs.clone_from(&of.inputs);
    }
    Ok(recorded(measured, &truth.noise))
}

/// The problem with a perfect machine, nominal artefacts and nominal inputs.
fn nominal(problem: &Problem) -> Problem {
    let mut nominal = problem.clone();
    nominal.machine_values = nominal.model.info().nominal.clone();
    for set in &mut nominal.sets {
        set.own = set.info().start.clone();
        set.inputs = set.info().inputs.iter().map(|input| input.value).collect();
    }
    nominal
}

/// The problem with positions and readings rounded as the machine and the instrument round them.
fn recorded(mut problem: Problem, noise: &Noise) -> Problem {
    let resolution = noise.resolution_mm;
    if resolution <= 0.0 {
        return problem;
    }
    let axes = problem.model.info().axes.iter().filter(|axis| axis.kind == abbe_core::AxisKind::Linear);
    let statuses: Vec<usize> = axes.map(|axis| axis.status).collect();
    let mut by_rounding = Vec::new();
    for set in &mut problem.sets {
        match &set.info().contact {
            Contact::LinearAxes => {
                round_positions(set, &statuses, resolution);
                by_rounding.extend(rows_of(set).flat_map(|row| std::iter::repeat_n(0.0, row.equations)));
            }
            Contact::Reading(column) => by_rounding.extend(rounded(set, std::slice::from_ref(column), resolution)),
            Contact::Readings(columns) => by_rounding.extend(rounded(set, columns, resolution)),
            // A pose is not read from a scale. `contact::simulate_measurement` has refused a set that is not simulated.
            Contact::Pose { .. } | Contact::NotSimulated(_) => {
                by_rounding.extend(rows_of(set).flat_map(|row| vec![0.0; row.equations]))
            }
        }
    }
    if by_rounding.iter().all(|change| *change == 0.0) { problem } else { problem.disturbed(&by_rounding) }
}

fn rows_of(set: &ObservationSet) -> impl Iterator<Item = abbe_core::Row> {
    set.rows.iter().map(|&row| set.info().layout.rows[row])
}

fn round_positions(set: &mut ObservationSet, statuses: &[usize], resolution: f64) {
    let mut poses = set.poses().clone();
    for pose in set.poses_of(&set.rows) {
        let status = poses.row_mut(pose);
        statuses.iter().for_each(|&axis| status[axis] = round(status[axis], resolution));
    }
    set.set_poses(poses);
}

/// What rounding of the readings changes in the equations.
fn rounded(set: &ObservationSet, columns: &[String], resolution: f64) -> Vec<f64> {
    let change = |reading: Option<f64>| match reading {
        // The residual has the reading with a minus sign.
        Some(reading) => reading - round(reading, resolution),
        None => 0.0,
    };
    readings(set, columns).into_iter().map(change).collect()
}

/// The readings of a set, one for every equation, mm; none for equations without a reading and for angles. The equations of a row take
/// the columns in turn.
fn readings(set: &ObservationSet, columns: &[String]) -> Vec<Option<f64>> {
    let data = &set.info().layout.data;
    let recorded: Vec<Option<&[f64]>> =
        columns.iter().map(|column| data.numbers(column).filter(|_| is_length(set, column))).collect();
    let disturbances = set.disturbances();
    let mut all = Vec::new();
    for row in rows_of(set) {
        for (place, equation) in row.equation_indices().enumerate() {
            let recorded = recorded.get(place % columns.len().max(1)).copied().flatten();
            let reading = recorded.zip(row.data_row).map(|(recorded, row)| recorded[row]);
            all.push(reading.map(|reading| reading - disturbances.map_or(0.0, |all| all[equation])));
        }
    }
    all
}

/// Whether a column of a set holds lengths.
pub(crate) fn is_length(set: &ObservationSet, column: &str) -> bool {
    let column = set.info().layout.data.column(column);
    column.is_some_and(|column| column.header.quantity == abbe_core::Quantity::Length)
}

fn round(value: f64, resolution: f64) -> f64 {
    (value / resolution).round() * resolution
}
