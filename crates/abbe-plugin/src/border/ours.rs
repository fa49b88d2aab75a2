//! Our objects, for the other side.
#![allow(unsafe_code, reason = "the C ABI; every block says why it is sound")]

use std::ffi::c_void;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

#[cfg(feature = "sdk")]
use abbe_core::{Context, Plugin};
use abbe_core::{Equations, PoseBatch, PosesMut, RowBatch, RowIndex, Variable};

use super::theirs::take;
use super::{slice, slice_mut};
use crate::abi::*;
use crate::peer::Failure;
use crate::questions::{check_poses, check_rows, guarded};
use crate::served::Served;
#[cfg(feature = "sdk")]
use crate::served::create;

pub(super) static TABLE: AbbeTable = AbbeTable {
    size: size_of::<AbbeTable>() as u64,
    retain: Some(retain),
    release: Some(release),
    call: Some(call),
    poses: Some(poses),
    equations: Some(equations),
};

/// An object for the other side. It holds one reference; `release` drops it.
fn give(served: Arc<Served>) -> AbbeObject {
    AbbeObject { table: &TABLE, handle: Arc::into_raw(served).cast_mut().cast() }
}

unsafe extern "C" fn retain(handle: *mut c_void) {
    // SAFETY: a handle of our table comes from `Arc::into_raw` in `give` and is still held.
    unsafe { Arc::increment_strong_count(handle.cast::<Served>()) }
}

unsafe extern "C" fn release(handle: *mut c_void) {
    // SAFETY: as in `retain`; the caller gives up one reference. Dropping a stage can run a vendor's code.
    let _ = catch_unwind(AssertUnwindSafe(|| unsafe { Arc::decrement_strong_count(handle.cast::<Served>()) }));
}

/// Runs `work` for the other side: panics and errors become a status and a text.
///
/// # Safety
/// `reply` is null or points to a reply that is valid during the call.
unsafe fn answer(reply: *const AbbeReply, work: impl FnOnce() -> Result<(String, Vec<Arc<Served>>), Failure>) -> u32 {
    match guarded(work) {
        Ok((text, objects)) => {
            // SAFETY: as this function asks for.
            unsafe {
                say(reply, &text);
                objects.into_iter().for_each(|object| hand_over(reply, give(object)));
            }
            ABBE_OK
        }
        Err(failure) => {
            // SAFETY: as this function asks for.
            unsafe { say(reply, &failure.text) };
            failure.status
        }
    }
}

/// Writes the text of a reply, if it takes one.
///
/// # Safety
/// `reply` is null or valid.
unsafe fn say(reply: *const AbbeReply, text: &str) {
    // SAFETY: null or valid by the contract; its function takes its own context.
    unsafe {
        if let Some(reply) = reply.as_ref()
            && let Some(write) = reply.text
        {
            write(reply.context, AbbeText::of(text));
        }
    }
}

/// Gives an object to a reply. An object that the reply does not take is released.
///
/// # Safety
/// `reply` is null or valid, `object` is ours.
unsafe fn hand_over(reply: *const AbbeReply, object: AbbeObject) {
    // SAFETY: null or valid by the contract; its function takes its own context and the reference that we hold.
    unsafe {
        match reply.as_ref().and_then(|reply| Some((reply.context, reply.object?))) {
            Some((context, take)) => take(context, object),
            None => release(object.handle),
        }
    }
}

unsafe extern "C" fn call(
    handle: *mut c_void,
    method: u32,
    question: *const AbbeQuestion,
    reply: *const AbbeReply,
) -> u32 {
    // SAFETY: by the ABI `handle` is one of ours and held, `question` and `reply` are valid during the call, and the objects
    // of the question are lent: each is retained before it is used.
    unsafe {
        answer(reply, || {
            let served = &*handle.cast::<Served>();
            let question = question.as_ref().ok_or_else(|| Failure::of("the other side", "asked no question"))?;
            let text = question.text.read().map_err(|what| Failure::of("the other side", what))?;
            let objects = slice(question.objects, question.object_count)?;
            let objects = objects.iter().map(|&object| take(object, "the other side", true));
            served.dispatch(method, &text, &objects.collect::<Result<Vec<_>, _>>()?)
        })
    }
}

/// The variables that derivatives are wanted for.
fn variables(wanted: &[AbbeVariable]) -> Result<Vec<Variable>, Failure> {
    let variable = |variable: &AbbeVariable| match (variable.kind, variable.index as usize) {
        (0, index) => Ok(Variable::Parameter(index)),
        (1, index) => Ok(Variable::Command(index)),
        _ => Err(Failure::of("the other side", format!("wants a derivative to {variable:?}, which is not there"))),
    };
    wanted.iter().map(variable).collect()
}

unsafe extern "C" fn poses(handle: *mut c_void, batch: *const AbbePoses, reply: *const AbbeReply) -> u32 {
    // SAFETY: by the ABI `handle` is one of ours and held, `batch` and what it points to are valid during the call, and nobody
    // else uses the room for the results.
    unsafe {
        answer(reply, || {
            let served = &*handle.cast::<Served>();
            let batch = batch.as_ref().ok_or_else(|| Failure::of("the other side", "gave no batch"))?;
            let derivatives = batch.pose_count.saturating_mul(batch.wanted_count);
            let turned = !batch.orientations.is_null();
            served.machine(|machine| {
                let statuses = slice(batch.statuses, batch.status_count)?;
                let values = slice(batch.values, batch.value_count)?;
                let wanted = &variables(slice(batch.wanted, batch.wanted_count)?)?;
                let question = PoseBatch { statuses, values, wanted, orientation: turned };
                if check_poses(machine.info(), &question)? as u64 != batch.pose_count {
                    return Err(Failure::of("the other side", "gave another number of statuses than of poses"));
                }
                let turns = if turned && !batch.rotation_derivatives.is_null() { derivatives } else { 0 };
                let out = PosesMut {
                    positions: slice_mut(batch.positions.cast(), batch.pose_count)?,
                    orientations: slice_mut(batch.orientations.cast(), if turned { batch.pose_count } else { 0 })?,
                    position_derivatives: slice_mut(batch.position_derivatives.cast(), derivatives)?,
                    rotation_derivatives: slice_mut(batch.rotation_derivatives.cast(), turns)?,
                };
                Ok(machine.evaluate(question, out)?)
            })?;
            Ok((String::new(), Vec::new()))
        })
    }
}

unsafe extern "C" fn equations(
    handle: *mut c_void,
    rows: *const AbbeRows,
    sink: *const AbbeEquations,
    reply: *const AbbeReply,
) -> u32 {
    // SAFETY: by the ABI `handle` is one of ours and held, the rest is valid during the call.
    unsafe {
        answer(reply, || {
            let nothing = || Failure::of("the other side", "gave no rows");
            let (rows, sink) = (rows.as_ref().ok_or_else(nothing)?, sink.as_ref().ok_or_else(nothing)?);
            let Served::Observations(observations, _) = &*handle.cast::<Served>() else {
                return Err(Failure { status: ABBE_UNKNOWN_METHOD, text: "this object is no observations".to_owned() });
            };
            let indices: Vec<RowIndex> =
                slice(rows.rows, rows.row_count)?.iter().map(|&row| RowIndex(row as usize)).collect();
            let turned = if rows.orientations.is_null() { 0 } else { rows.pose_count };
            let batch = RowBatch {
                rows: &indices,
                positions: slice(rows.positions.cast(), rows.pose_count)?,
                orientations: slice(rows.orientations.cast(), turned)?,
                own: slice(rows.own, rows.own_count)?,
                inputs: slice(rows.inputs, rows.input_count)?,
            };
            check_rows(observations.info(), &batch)?;
            let mut out = Equations::default();
            observations.evaluate(batch, &mut out)?;
            write_equations(&out, sink)?;
            Ok((String::new(), Vec::new()))
        })
    }
}

/// Hands equations over in the order in which an artefact writes them.
///
/// # Safety
/// The functions of `sink` take its context.
unsafe fn write_equations(out: &Equations, sink: &AbbeEquations) -> Result<(), Failure> {
    let incomplete = || Failure::of("the other side", "takes no equations");
    let (equation, position) = (sink.equation.ok_or_else(incomplete)?, sink.position.ok_or_else(incomplete)?);
    let (rotation, own) = (sink.rotation.ok_or_else(incomplete)?, sink.own.ok_or_else(incomplete)?);
    let input = sink.input.ok_or_else(incomplete)?;
    let (mut by_own, mut by_input) = (out.by_own().iter().peekable(), out.by_input().iter().peekable());
    let context = sink.context;
    // SAFETY: by the contract of this function.
    unsafe {
        for (index, &residual) in out.residuals().iter().enumerate() {
            equation(context, residual);
            while let Some(by) = by_own.next_if(|by| by.0 == index) {
                own(context, by.1 as u64, by.2);
            }
            while let Some(by) = by_input.next_if(|by| by.0 == index) {
                input(context, by.1 as u64, by.2);
            }
        }
        // Poses of a row are identified by their order alone, which runs through all equations.
        out.by_position().iter().for_each(|by| position(context, by[0], by[1], by[2]));
        out.by_rotation().iter().for_each(|by| rotation(context, by[0], by[1], by[2]));
    }
    Ok(())
}

/// Builds a stage of one of our plugins for the other side.
///
/// # Safety
/// The texts and `reply` are valid during the call.
#[cfg(feature = "sdk")]
pub(crate) unsafe fn create_for(plugin: &Plugin, settings: AbbeText, base: AbbeText, reply: *const AbbeReply) -> u32 {
    // SAFETY: as this function asks for.
    unsafe {
        answer(reply, || {
            let wrong = |what: String| Failure::of("the other side", what);
            let (settings, base) = (settings.read().map_err(wrong)?, base.read().map_err(wrong)?);
            let stage = create(plugin, &settings, &Context { base: base.into() })?;
            Ok((String::new(), vec![Arc::new(stage)]))
        })
    }
}
