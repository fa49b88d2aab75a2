//! Objects of the other side, for us.
#![allow(unsafe_code, reason = "the C ABI; every block says why it is sound")]

use std::any::Any;
use std::ffi::c_void;
use std::ptr::NonNull;
use std::sync::Arc;

use abbe_core::{Equations, Poses, RowBatch, Variable};

use super::ours::TABLE;
use crate::abi::*;
use crate::float_control;
use crate::peer::{Answer, Failure, Peer, Received};
use crate::served::Served;

/// An object of the other side, used by its table of functions.
pub(crate) struct Foreign {
    object: AbbeObject,
    table: Functions,
    who: String,
}

/// The functions of a table that the other side provides.
#[derive(Clone, Copy)]
struct Functions {
    retain: Option<unsafe extern "C" fn(*mut c_void)>,
    release: Option<unsafe extern "C" fn(*mut c_void)>,
    call: Option<unsafe extern "C" fn(*mut c_void, u32, *const AbbeQuestion, *const AbbeReply) -> u32>,
    poses: Option<unsafe extern "C" fn(*mut c_void, *const AbbePoses, *const AbbeReply) -> u32>,
    equations:
        Option<unsafe extern "C" fn(*mut c_void, *const AbbeRows, *const AbbeEquations, *const AbbeReply) -> u32>,
}

// SAFETY: by the ABI every function of an object may be called from several threads at once, and released on any.
unsafe impl Send for Foreign {}
// SAFETY: as above.
unsafe impl Sync for Foreign {}

/// Reads a field of a table of the other side, if the table is long enough to have it and it is not null.
macro_rules! field {
    ($table:expr, $size:expr, $type:ty, $field:ident) => {
        if std::mem::offset_of!($type, $field) + size_of::<usize>() <= $size as usize { (*$table).$field } else { None }
    };
}

/// An object that was received. An object that is only lent is retained.
///
/// # Safety
/// `object` is as the ABI promises: a table that is valid for ever with a handle that is held.
pub(super) unsafe fn take(object: AbbeObject, who: &str, lent: bool) -> Result<Received, Failure> {
    if std::ptr::eq(object.table, &TABLE) {
        let handle = object.handle.cast_const().cast::<Served>();
        // SAFETY: the object is one of ours: its handle comes from `give`; a lent one gets a reference of its own.
        return Ok(Received::Local(unsafe {
            if lent {
                Arc::increment_strong_count(handle);
            }
            Arc::from_raw(handle)
        }));
    }
    if object.table.is_null() || !object.table.is_aligned() {
        return Err(Failure::of(who, "gave an object without a table"));
    }
    // SAFETY: the table is valid by the contract; fields behind its end are not read.
    let (table, retain) = unsafe {
        let (table, size) = (object.table, (*object.table).size);
        let functions = Functions {
            retain: field!(table, size, AbbeTable, retain),
            release: field!(table, size, AbbeTable, release),
            call: field!(table, size, AbbeTable, call),
            poses: field!(table, size, AbbeTable, poses),
            equations: field!(table, size, AbbeTable, equations),
        };
        (functions, functions.retain)
    };
    match retain {
        // SAFETY: the handle is held during the call that lent it.
        Some(retain) if lent => unsafe { retain(object.handle) },
        None if lent => return Err(Failure::of(who, "lends an object that cannot be kept")),
        _ => {}
    }
    Ok(Received::Remote(Arc::new(Foreign { object, table, who: who.to_owned() })))
}

impl Drop for Foreign {
    fn drop(&mut self) {
        if let Some(release) = self.table.release {
            // SAFETY: the one reference that `take` made ours.
            unsafe { release(self.object.handle) };
        }
    }
}

/// The content of a reply.
struct Collected {
    text: Result<String, String>,
    objects: Vec<AbbeObject>,
}

unsafe extern "C" fn collect_text(context: *mut c_void, text: AbbeText) {
    // SAFETY: the context is the one that `with_reply` gave, during its call; the text is readable by the ABI.
    unsafe { (*context.cast::<Collected>()).text = text.read() }
}

unsafe extern "C" fn collect_object(context: *mut c_void, object: AbbeObject) {
    // SAFETY: as above.
    unsafe { (*context.cast::<Collected>()).objects.push(object) }
}

/// Calls the other side with a reply to write to. Restores the floating-point state afterwards.
pub(super) fn with_reply(who: &str, work: impl FnOnce(*const AbbeReply) -> u32) -> Result<Answer, Failure> {
    let mut collected = Collected { text: Ok(String::new()), objects: Vec::new() };
    let reply = AbbeReply {
        size: size_of::<AbbeReply>() as u64,
        context: (&raw mut collected).cast(),
        text: Some(collect_text),
        object: Some(collect_object),
    };
    let status = float_control::kept(|| work(&reply));
    // Taken first, so that every object is released also when the call failed.
    let objects: Vec<Result<Received, Failure>> =
        // SAFETY: the other side gives objects as the ABI promises.
        collected.objects.into_iter().map(|object| unsafe { take(object, who, false) }).collect();
    let text = collected.text.map_err(|what| Failure::of(who, what))?;
    match status {
        ABBE_OK => Ok(Answer { text, objects: objects.into_iter().collect::<Result<_, _>>()? }),
        status => Err(Failure { status, text }),
    }
}

/// Number of marker entries behind the end of a list that the other side fills. They show whether it wrote beyond the end.
const FENCE: usize = 8;
const FENCE_BITS: u64 = 0x7ff8_abbe_abbe_abbe;

/// Writes marker entries behind the end of a list.
fn fence<const N: usize>(list: &mut Vec<[f64; N]>) {
    list.reserve(FENCE);
    for place in list.spare_capacity_mut().iter_mut().take(FENCE) {
        place.write([f64::from_bits(FENCE_BITS); N]);
    }
}

/// Whether the marker entries behind a list are unchanged.
fn stands<const N: usize>(list: &mut Vec<[f64; N]>) -> bool {
    // SAFETY: `fence` has written these places, and the list has not been touched in between.
    let whole = |place: &std::mem::MaybeUninit<[f64; N]>| unsafe { place.assume_init() };
    let mut places = list.spare_capacity_mut().iter().take(FENCE);
    places.all(|place| whole(place).iter().all(|number| number.to_bits() == FENCE_BITS))
}

impl Peer for Foreign {
    fn who(&self) -> &str {
        &self.who
    }

    fn call(&self, method: u32, text: &str, objects: &[Arc<Served>]) -> Result<Answer, Failure> {
        let lacks = || Failure { status: ABBE_UNKNOWN_METHOD, text: "it has no `call`".to_owned() };
        let call = self.table.call.ok_or_else(lacks)?;
        // A proxy for an object of the other side is sent as that object. The proxies outlive the call, so the objects are
        // held.
        let peers: Vec<Option<Arc<dyn Peer>>> = objects.iter().map(|object| object.peer()).collect();
        let lent: Vec<AbbeObject> = (objects.iter().zip(&peers))
            .map(|(object, peer)| {
                match peer.as_ref().and_then(|peer| peer.as_any().downcast_ref::<Self>()) {
                    // An object that the other side cannot retain is sent as its proxy, which can be retained.
                    Some(foreign) if foreign.table.retain.is_some() => foreign.object,
                    _ => AbbeObject { table: &TABLE, handle: Arc::as_ptr(object).cast_mut().cast() },
                }
            })
            .collect();
        let question = AbbeQuestion {
            size: size_of::<AbbeQuestion>() as u64,
            text: AbbeText::of(text),
            objects: lent.as_ptr(),
            object_count: lent.len() as u64,
        };
        // SAFETY: the handle is held by this object, question, objects and reply live through the call.
        with_reply(&self.who, |reply| unsafe { call(self.object.handle, method, &question, reply) })
    }

    fn poses(&self, statuses: &[f64], values: &[f64], wanted: &[Variable], out: &mut Poses) -> Result<(), Failure> {
        let lacks = || Failure { status: ABBE_UNKNOWN_METHOD, text: "it has no `poses`".to_owned() };
        let poses = self.table.poses.ok_or_else(lacks)?;
        let wanted: Vec<AbbeVariable> = wanted
            .iter()
            .map(|variable| match *variable {
                Variable::Parameter(index) => AbbeVariable { kind: 0, index: index as u32 },
                Variable::Command(index) => AbbeVariable { kind: 1, index: index as u32 },
            })
            .collect();
        fence(&mut out.positions);
        fence(&mut out.orientations);
        fence(&mut out.position_derivatives);
        fence(&mut out.rotation_derivatives);
        let turned = !out.orientations.is_empty();
        let room = |list: *mut f64| if turned { list } else { std::ptr::null_mut() };
        let batch = AbbePoses {
            size: size_of::<AbbePoses>() as u64,
            statuses: statuses.as_ptr(),
            status_count: statuses.len() as u64,
            values: values.as_ptr(),
            value_count: values.len() as u64,
            wanted: wanted.as_ptr(),
            wanted_count: wanted.len() as u64,
            pose_count: out.positions.len() as u64,
            positions: out.positions.as_mut_ptr().cast(),
            orientations: room(out.orientations.as_mut_ptr().cast()),
            position_derivatives: out.position_derivatives.as_mut_ptr().cast(),
            rotation_derivatives: room(out.rotation_derivatives.as_mut_ptr().cast()),
        };
        // SAFETY: the handle is held by this object, all lists live through the call and have the room that the batch says.
        let answer = with_reply(&self.who, |reply| unsafe { poses(self.object.handle, &batch, reply) });
        let whole = stands(&mut out.positions)
            & stands(&mut out.orientations)
            & stands(&mut out.position_derivatives)
            & stands(&mut out.rotation_derivatives);
        match whole {
            true => answer.map(drop),
            false => Err(Failure::of(&self.who, "wrote beyond the end of the room that it was given")),
        }
    }

    fn equations(&self, batch: RowBatch<'_>, out: &mut Equations) -> Result<(), Failure> {
        let lacks = || Failure { status: ABBE_UNKNOWN_METHOD, text: "it has no `equations`".to_owned() };
        let equations = self.table.equations.ok_or_else(lacks)?;
        let indices: Vec<u64> = batch.rows.iter().map(|row| row.0 as u64).collect();
        let orientations = match batch.orientations {
            [] => std::ptr::null(),
            some => some.as_ptr().cast(),
        };
        let rows = AbbeRows {
            size: size_of::<AbbeRows>() as u64,
            rows: indices.as_ptr(),
            row_count: indices.len() as u64,
            positions: batch.positions.as_ptr().cast(),
            orientations,
            pose_count: batch.positions.len() as u64,
            own: batch.own.as_ptr(),
            own_count: batch.own.len() as u64,
            inputs: batch.inputs.as_ptr(),
            input_count: batch.inputs.len() as u64,
        };
        let mut taken = Taken { equations: out, early: false };
        let sink = AbbeEquations {
            size: size_of::<AbbeEquations>() as u64,
            context: (&raw mut taken).cast(),
            equation: Some(take_equation),
            position: Some(take_position),
            rotation: Some(take_rotation),
            own: Some(take_own),
            input: Some(take_input),
        };
        // SAFETY: the handle is held by this object, everything else lives through the call.
        with_reply(&self.who, |reply| unsafe { equations(self.object.handle, &rows, &sink, reply) })?;
        match taken.early {
            true => Err(Failure::of(&self.who, "gave a derivative before the equation that it is of")),
            false => Ok(()),
        }
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}

/// Takes the equations of the other side.
struct Taken<'a> {
    equations: &'a mut Equations,
    early: bool,
}

/// The place that equations go to; none for a null context.
///
/// # Safety
/// `context` is the one of the sink, during the call that it was given to.
unsafe fn taken<'a>(context: *mut c_void) -> Option<&'a mut Taken<'a>> {
    // SAFETY: by the contract of this function; calls of one sink do not overlap.
    NonNull::new(context.cast::<Taken<'a>>()).map(|taken| unsafe { &mut *taken.as_ptr() })
}

unsafe extern "C" fn take_equation(context: *mut c_void, residual: f64) {
    // SAFETY: called with the context of the sink.
    if let Some(taken) = unsafe { taken(context) } {
        taken.equations.equation(residual);
    }
}

unsafe extern "C" fn take_position(context: *mut c_void, x: f64, y: f64, z: f64) {
    // SAFETY: called with the context of the sink.
    if let Some(taken) = unsafe { taken(context) } {
        taken.equations.position([x, y, z]);
    }
}

unsafe extern "C" fn take_rotation(context: *mut c_void, x: f64, y: f64, z: f64) {
    // SAFETY: called with the context of the sink.
    if let Some(taken) = unsafe { taken(context) } {
        taken.equations.rotation([x, y, z]);
    }
}

unsafe extern "C" fn take_own(context: *mut c_void, unknown: u64, derivative: f64) {
    // SAFETY: called with the context of the sink.
    if let Some(taken) = unsafe { taken(context) } {
        match taken.equations.residuals().is_empty() {
            true => taken.early = true,
            false => taken.equations.own(unknown as usize, derivative),
        }
    }
}

unsafe extern "C" fn take_input(context: *mut c_void, input: u64, derivative: f64) {
    // SAFETY: called with the context of the sink.
    if let Some(taken) = unsafe { taken(context) } {
        match taken.equations.residuals().is_empty() {
            true => taken.early = true,
            false => taken.equations.input(input as usize, derivative),
        }
    }
}
