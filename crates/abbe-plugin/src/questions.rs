//! What the other side may ask our objects: whoever asks for poses, rows or points that are not there is refused, before the code of an
//! object sees the question.

use std::panic::{AssertUnwindSafe, catch_unwind};

use abbe_core::{ModelInfo, ObservationsInfo, Orientation, PoseBatch, RowBatch, Variable};

use crate::abi::ABBE_PANICKED;
use crate::peer::Failure;
use crate::texts::TipText;

fn wrong(what: &str) -> Failure {
    Failure::of("the other side", what)
}

/// Works on a question; a panic becomes a failure.
pub(crate) fn guarded<T>(work: impl FnOnce() -> Result<T, Failure>) -> Result<T, Failure> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
        let text = text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_default();
        Err(Failure { status: ABBE_PANICKED, text })
    })
}

/// How many poses are asked for. Fails if they are those of another machine.
pub(crate) fn check_poses(info: &ModelInfo, batch: &PoseBatch<'_>) -> Result<usize, Failure> {
    let is_there = |variable: &&Variable| match **variable {
        Variable::Parameter(index) => index < info.parameters.len(),
        Variable::Command(index) => index < info.axes.len(),
    };
    if let Some(variable) = batch.wanted.iter().find(|variable| !is_there(variable)) {
        return Err(wrong(&format!("wants a derivative to {variable:?}, which is not there")));
    }
    let width = info.status.len().max(1);
    match batch.statuses.len().is_multiple_of(width) && batch.values.len() == info.parameters.len() {
        true => Ok(batch.statuses.len() / width),
        false => Err(wrong("gave statuses or values of another machine")),
    }
}

/// Fails if rows, poses or values are asked for that observations do not have.
pub(crate) fn check_rows(info: &ObservationsInfo, batch: &RowBatch<'_>) -> Result<(), Failure> {
    let all = &info.layout.rows;
    let poses: Option<usize> = batch.rows.iter().map(|row| all.get(row.0).map(|row| row.poses)).sum();
    let turned = if info.orientation == Orientation::Unused { 0 } else { batch.positions.len() };
    if poses != Some(batch.positions.len()) {
        return Err(wrong("asked for rows that are not there, or with other poses"));
    }
    if batch.orientations.len() < turned {
        return Err(wrong("gave no orientations to observations that need them"));
    }
    match batch.own.len() == info.unknowns.len() && batch.inputs.len() == info.inputs.len() {
        true => Ok(()),
        false => Err(wrong("gave values of other unknowns or inputs")),
    }
}

/// Fails if a point of contact is asked for that observations do not have.
pub(crate) fn check_tip(info: &ObservationsInfo, question: &TipText) -> Result<(), Failure> {
    let is_there = question.row.0 < info.layout.rows.len()
        && question.own.len() == info.unknowns.len()
        && question.inputs.len() == info.inputs.len();
    if is_there { Ok(()) } else { Err(wrong("asked for the contact of a row that is not there, or with other values")) }
}
