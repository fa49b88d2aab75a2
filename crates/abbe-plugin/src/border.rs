//! The border itself: our objects as tables of functions, and tables of functions as objects.
#![allow(unsafe_code, reason = "the C ABI; every block says why it is sound")]

use std::any::Any;
use std::ffi::c_void;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::ptr::NonNull;
use std::sync::Arc;

#[cfg(feature = "sdk")]
use abbe_core::{Context, Plugin};
use abbe_core::{Equations, PoseValues, Poses, PosesMut, Variable};

use crate::abi::*;
use crate::float_control;
use crate::peer::{Answer, Failure, Known, Peer, Transit};
use crate::served::Served;
#[cfg(feature = "sdk")]
use crate::served::create;

/// The longest text that is taken for one, bytes: more is a wild length.
const LONGEST: u64 = 1 << 32;

impl AbbeText {
    /// A text of ours, valid as long as `text` is.
    pub(crate) const fn of(text: &str) -> Self {
        Self { data: text.as_ptr(), length: text.len() as u64 }
    }

    /// The text of the other side.
    ///
    /// # Safety
    /// `data` is null or the first of `length` readable bytes.
    pub(crate) unsafe fn read(self) -> Result<String, String> {
        if self.length == 0 {
            return Ok(String::new());
        }
        if self.data.is_null() {
            return Err("gave a null pointer for a text".to_owned());
        }
        if self.length > LONGEST {
            return Err(format!("gave a text of {} bytes", self.length));
        }
        // SAFETY: not null, and readable by the contract of this function.
        let bytes = unsafe { std::slice::from_raw_parts(self.data, self.length as usize) };
        let text = std::str::from_utf8(bytes).map_err(|error| format!("gave a text that is not UTF-8: {error}"))?;
        Ok(text.to_owned())
    }
}

/// The slice of the other side; no elements may be a null pointer.
///
/// # Safety
/// `data` is null or the first of `count` readable elements, which nobody changes while the slice is used.
unsafe fn slice<'a, T>(data: *const T, count: u64) -> Result<&'a [T], Failure> {
    match (count, data.is_null() || !data.is_aligned()) {
        (0, _) => Ok(&[]),
        (_, true) => Err(Failure::of("the other side", "gave a null or misaligned pointer")),
        // SAFETY: not null, aligned, readable by the contract of this function.
        (_, false) => Ok(unsafe { std::slice::from_raw_parts(data, count as usize) }),
    }
}

/// As [`slice`], to be written.
///
/// # Safety
/// `data` is null or the first of `count` writable elements that nobody else uses meanwhile.
unsafe fn slice_mut<'a, T>(data: *mut T, count: u64) -> Result<&'a mut [T], Failure> {
    match (count, data.is_null() || !data.is_aligned()) {
        (0, _) => Ok(&mut []),
        (_, true) => Err(Failure::of("the other side", "gave a null or misaligned pointer")),
        // SAFETY: not null, aligned, writable and exclusive by the contract of this function.
        (_, false) => Ok(unsafe { std::slice::from_raw_parts_mut(data, count as usize) }),
    }
}

// ---- Our objects, for the other side --------------------------------------------------------------------------------

static TABLE: AbbeTable = AbbeTable {
    size: size_of::<AbbeTable>() as u64,
    retain: Some(retain),
    release: Some(release),
    call: Some(call),
    poses: Some(poses),
    equations: Some(equations),
};

/// An object for the other side; holds one reference, which `release` lets go of.
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
    let failure = match catch_unwind(AssertUnwindSafe(work)) {
        Ok(Ok((text, objects))) => {
            // SAFETY: as this function asks for.
            unsafe {
                say(reply, &text);
                objects.into_iter().for_each(|object| hand_over(reply, give(object)));
            }
            return ABBE_OK;
        }
        Ok(Err(failure)) => failure,
        Err(panic) => {
            let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
            let text = text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_default();
            Failure { status: ABBE_PANICKED, text }
        }
    };
    // SAFETY: as this function asks for.
    unsafe { say(reply, &failure.text) };
    failure.status
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

/// Gives an object to a reply; one that takes none lets go of it.
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

/// The variables that derivatives are wanted for, checked against what the model has.
fn variables(wanted: &[AbbeVariable], parameters: usize, axes: usize) -> Result<Vec<Variable>, Failure> {
    let variable = |variable: &AbbeVariable| match (variable.kind, variable.index as usize) {
        (0, index) if index < parameters => Ok(Variable::Parameter(index)),
        (1, index) if index < axes => Ok(Variable::Command(index)),
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
                let wanted = slice(batch.wanted, batch.wanted_count)?;
                let wanted = variables(wanted, machine.parameters().len(), machine.axes().len())?;
                let width = machine.status().len();
                if statuses.len() as u64 != batch.pose_count.saturating_mul(width as u64)
                    || values.len() != machine.parameters().len()
                {
                    return Err(Failure::of("the other side", "gave statuses or values of another machine"));
                }
                let turns = if turned && !batch.rotation_derivatives.is_null() { derivatives } else { 0 };
                let out = PosesMut {
                    positions: slice_mut(batch.positions.cast(), batch.pose_count)?,
                    orientations: slice_mut(batch.orientations.cast(), if turned { batch.pose_count } else { 0 })?,
                    position_derivatives: slice_mut(batch.position_derivatives.cast(), derivatives)?,
                    rotation_derivatives: slice_mut(batch.rotation_derivatives.cast(), turns)?,
                };
                Ok(machine.evaluate_into(statuses, values, &wanted, turned, out)?)
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
            let all = &observations.layout().rows;
            let indices: Vec<usize> = slice(rows.rows, rows.row_count)?.iter().map(|&row| row as usize).collect();
            let poses: usize = indices.iter().filter_map(|&row| all.get(row)).map(|row| row.poses).sum();
            if indices.iter().any(|&row| row >= all.len()) || poses as u64 != rows.pose_count {
                return Err(Failure::of("the other side", "asked for rows that are not there, or with other poses"));
            }
            let turned = if rows.orientations.is_null() { 0 } else { rows.pose_count };
            let values = PoseValues {
                positions: slice(rows.positions.cast(), rows.pose_count)?,
                orientations: slice(rows.orientations.cast(), turned)?,
            };
            let (own, inputs) = (slice(rows.own, rows.own_count)?, slice(rows.inputs, rows.input_count)?);
            if own.len() != observations.unknowns().len() || inputs.len() != observations.inputs().len() {
                return Err(Failure::of("the other side", "gave values of other unknowns or inputs"));
            }
            let mut out = Equations::default();
            observations.try_evaluate(&indices, values, own, inputs, &mut out)?;
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
        // Poses of a row are told apart by their order alone, which runs through all equations.
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

// ---- Objects of the other side, for us ------------------------------------------------------------------------------

/// An object behind a table of functions.
pub(crate) struct Foreign {
    object: AbbeObject,
    table: Functions,
    who: String,
}

/// A table as far as the other side has it.
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

/// An object that came over. One that is only lent is retained.
///
/// # Safety
/// `object` is as the ABI promises: a table that is valid for ever with a handle that is held.
unsafe fn take(object: AbbeObject, who: &str, lent: bool) -> Result<Transit, Failure> {
    if std::ptr::eq(object.table, &TABLE) {
        let handle = object.handle.cast_const().cast::<Served>();
        // SAFETY: one of our own comes home: the handle is of `give`; a lent one gets a reference of its own.
        return Ok(Transit::Local(unsafe {
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
    Ok(Transit::Remote(Arc::new(Foreign { object, table, who: who.to_owned() })))
}

impl Drop for Foreign {
    fn drop(&mut self) {
        if let Some(release) = self.table.release {
            // SAFETY: the one reference that `take` made ours.
            unsafe { release(self.object.handle) };
        }
    }
}

/// What a reply collects.
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

/// Calls the other side with a reply to write to, with the floating-point state as it was before.
fn with_reply(who: &str, work: impl FnOnce(*const AbbeReply) -> u32) -> Result<Answer, Failure> {
    let mut collected = Collected { text: Ok(String::new()), objects: Vec::new() };
    let reply = AbbeReply {
        size: size_of::<AbbeReply>() as u64,
        context: (&raw mut collected).cast(),
        text: Some(collect_text),
        object: Some(collect_object),
    };
    let status = float_control::kept(|| work(&reply));
    // Taken first, so that objects are let go of whatever follows.
    let objects: Vec<Result<Transit, Failure>> =
        // SAFETY: the other side gives objects as the ABI promises.
        collected.objects.into_iter().map(|object| unsafe { take(object, who, false) }).collect();
    let text = collected.text.map_err(|what| Failure::of(who, what))?;
    match status {
        ABBE_OK => Ok(Answer { text, objects: objects.into_iter().collect::<Result<_, _>>()? }),
        status => Err(Failure { status, text }),
    }
}

/// A plugin of a library, to build stages with.
#[cfg(feature = "host")]
pub(crate) struct Record {
    record: *const AbbePlugin,
    create: unsafe extern "C" fn(*const AbbePlugin, AbbeText, AbbeText, *const AbbeReply) -> u32,
}

// SAFETY: records are constant, and by the ABI `create` may be called from several threads at once.
#[cfg(feature = "host")]
unsafe impl Send for Record {}
// SAFETY: as above.
#[cfg(feature = "host")]
unsafe impl Sync for Record {}

#[cfg(feature = "host")]
impl Record {
    /// Builds a stage; the text after the path of the folder is lent for the call.
    pub fn create(&self, settings: &str, base: &str, who: &str) -> Result<Transit, Failure> {
        let (settings, base) = (AbbeText::of(settings), AbbeText::of(base));
        // SAFETY: record and function belong together and stay valid; texts and reply live through the call.
        let answer = with_reply(who, |reply| unsafe { (self.create)(self.record, settings, base, reply) })?;
        answer.objects.into_iter().next().ok_or_else(|| Failure::of(who, "gave no stage and no error"))
    }
}

/// What the table of a library says.
#[cfg(feature = "host")]
pub(crate) struct LibraryText {
    pub name: String,
    pub version: String,
    pub plugins: Vec<PluginText>,
}

/// What the record of a plugin says.
#[cfg(feature = "host")]
pub(crate) struct PluginText {
    pub kind: u32,
    pub name: String,
    pub about: String,
    pub schema: String,
    pub example: String,
    pub record: Record,
}

/// More plugins than a library has: a wild count.
#[cfg(feature = "host")]
const MOST_PLUGINS: u64 = 1000;

/// Asks a library for its table and reads it.
///
/// # Safety
/// `entry` is the exported function of a plugin library.
#[cfg(feature = "host")]
pub(crate) unsafe fn read_library(entry: AbbeEntry, host: &'static AbbeHost) -> Result<LibraryText, String> {
    // SAFETY: the function is what its name promises; everything that it gives is checked as far as that can be done, and
    // nothing behind the stated size of a structure is read.
    unsafe {
        let library = float_control::kept(|| entry(host));
        if library.is_null() || !library.is_aligned() {
            return Err("gives no table: it refuses to work with this program".to_owned());
        }
        let (major, size) = ((*library).abi_major, (*library).size);
        if major != ABBE_ABI_MAJOR {
            return Err(format!(
                "speaks version {major} of the plugin interface, this program speaks version {ABBE_ABI_MAJOR}"
            ));
        }
        if size < size_of::<AbbeLibrary>() as u64 {
            return Err(format!("gives a table of {size} bytes; at least {} were expected", size_of::<AbbeLibrary>()));
        }
        let library = &*library;
        let (name, version) = (library.name.read()?, library.version.read()?);
        if library.plugin_count == 0 || library.plugin_count > MOST_PLUGINS {
            return Err(format!("says that it has {} plugins", library.plugin_count));
        }
        let records =
            slice(library.plugins, library.plugin_count).map_err(|_| "gives no list of plugins".to_owned())?;
        let plugins = records.iter().map(|&record| read_plugin(record)).collect::<Result<_, _>>()?;
        Ok(LibraryText { name, version, plugins })
    }
}

/// # Safety
/// `record` is null or the record of a plugin, valid for ever.
#[cfg(feature = "host")]
unsafe fn read_plugin(record: *const AbbePlugin) -> Result<PluginText, String> {
    // SAFETY: as this function asks for; the size is checked before anything behind it is read.
    unsafe {
        if record.is_null() || !record.is_aligned() {
            return Err("has a null pointer in its list of plugins".to_owned());
        }
        if (*record).size < size_of::<AbbePlugin>() as u64 {
            return Err(format!("has a plugin whose record is of {} bytes", (*record).size));
        }
        let plugin = &*record;
        let name = plugin.name.read()?;
        let create = plugin.create.ok_or_else(|| format!("has a plugin `{name}` without a function `create`"))?;
        Ok(PluginText {
            kind: plugin.kind,
            about: plugin.about.read()?,
            schema: plugin.schema.read()?,
            example: plugin.example.read()?,
            record: Record { record, create },
            name,
        })
    }
}

/// Numbers behind the end of what the other side may write to, to see whether it keeps to that.
const FENCE: usize = 8;
const FENCE_BITS: u64 = 0x7ff8_abbe_abbe_abbe;

/// Puts a fence behind a list.
fn fence<const N: usize>(list: &mut Vec<[f64; N]>) {
    list.reserve(FENCE);
    for place in list.spare_capacity_mut().iter_mut().take(FENCE) {
        place.write([f64::from_bits(FENCE_BITS); N]);
    }
}

/// Whether the fence behind a list still stands.
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
        // What stands for one of their objects goes home as that; the proxies outlive the call, so they are held.
        let behind: Vec<Option<Arc<dyn Peer>>> = objects.iter().map(|object| object.behind()).collect();
        let lent: Vec<AbbeObject> = (objects.iter().zip(&behind))
            .map(|(object, behind)| {
                match behind.as_ref().and_then(|peer| peer.as_any().downcast_ref::<Self>()) {
                    // What cannot be kept goes as one of ours, which can.
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

    fn equations(
        &self,
        rows: &[usize],
        poses: PoseValues<'_>,
        known: Known<'_>,
        out: &mut Equations,
    ) -> Result<(), Failure> {
        let lacks = || Failure { status: ABBE_UNKNOWN_METHOD, text: "it has no `equations`".to_owned() };
        let equations = self.table.equations.ok_or_else(lacks)?;
        let indices: Vec<u64> = rows.iter().map(|&row| row as u64).collect();
        let orientations = match poses.orientations {
            [] => std::ptr::null(),
            some => some.as_ptr().cast(),
        };
        let rows = AbbeRows {
            size: size_of::<AbbeRows>() as u64,
            rows: indices.as_ptr(),
            row_count: indices.len() as u64,
            positions: poses.positions.as_ptr().cast(),
            orientations,
            pose_count: poses.positions.len() as u64,
            own: known.own.as_ptr(),
            own_count: known.own.len() as u64,
            inputs: known.inputs.as_ptr(),
            input_count: known.inputs.len() as u64,
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

/// Where equations of the other side go.
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
