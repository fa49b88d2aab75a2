//! The C ABI: what crosses between Abbe and a plugin library, in either direction.
//!
//! A library exports one symbol, [`ENTRY`], that gives its table ([`AbbeLibrary`]). Its plugins create **objects**: a table
//! of functions with a handle. What a plugin is given (the model of a machine, observations, an estimator) are objects of the
//! same kind that the program offers, so that there is one table for both directions.
//!
//! - Questions and answers are UTF-8 text: JSON, in which a number that is not finite is `null` and paths are text.
//! - What is asked a million times (poses, equations) crosses as plain `f64` slices that the caller owns, without copies.
//! - **Growth**: tables are only appended to and begin with their size in bytes; a function behind the end of a table, or
//!   null, is one that the other side does not have. The major number changes when that is not enough.
//! - **Ownership**: what a call gets is lent until it returns; `retain` keeps an object. What a reply gives is the receiver's,
//!   who releases it. Texts are copied by whoever receives them.
//! - **Threads**: every function may be called from several threads at once.
//! - **Errors** are a status and a text; nothing ever unwinds across.
//!
//! The header for C is made of this file by `cargo xtask header`.

use std::ffi::{c_char, c_void};

/// The major number: another one is refused.
pub const ABBE_ABI_MAJOR: u32 = 2;
/// The minor number: a higher one has more functions.
pub const ABBE_ABI_MINOR: u32 = 0;

/// The symbol that a plugin library exports, an [`AbbeEntry`].
pub const ENTRY: &str = "abbe_plugin";

/// Success.
pub const ABBE_OK: u32 = 0;
/// An error; the text of the reply is one sentence.
pub const ABBE_FAILED: u32 = 1;
/// An error; the text of the reply is JSON: `message`, and whatever of `help`, `class` ("use" or "data"), `setting` (of stages)
/// or `path` (of settings), `place`, `pose` (of those that were evaluated together, from 0) there is. An evaluation that fails
/// refuses the numbers that it was asked with, and an estimator tries others, unless `fault` is true: the code itself failed.
pub const ABBE_FAILED_WITH_DETAILS: u32 = 2;
/// The code panicked; the text says how.
pub const ABBE_PANICKED: u32 = 3;
/// The object does not know the method.
pub const ABBE_UNKNOWN_METHOD: u32 = 4;

/// Kinds of plugin.
pub const ABBE_INGEST: u32 = 0;
/// A plugin that makes observations.
pub const ABBE_ARTEFACT: u32 = 1;
/// A plugin that describes machines.
pub const ABBE_MODEL: u32 = 2;
/// A plugin that solves problems.
pub const ABBE_ESTIMATE: u32 = 3;
/// A plugin that judges calibrations.
pub const ABBE_VALIDATE: u32 = 4;
/// A plugin that writes files.
pub const ABBE_EXPORT: u32 = 5;

/// Of machines and observations: what they are. Answer: JSON.
///
/// A machine has `axes`, `status`, `parameters`, `settings`, and whatever of `stylus_radius`, `nominal`, `nominal_uncertainties` (one
/// value a parameter; without them all are zero), `error_functions` and `periods` there is. A status has a `role`: `{ "command": axis }`
/// for the status of every axis, else `{ "direction": axis }`, `"time"`, `"stylus"`, `"series"`, `"temperature"`, `"load"`, `"feed"`,
/// `{ "velocity": axis }`, `{ "sensor": name }`, `{ "thermal-state": name }`, `"probe"` or `"other"`. A parameter has one, too:
/// `{ "motion": { "axis", "component" } }` (component 0..6), `{ "location": { "axis", "component" } }`, `"set-up"`, `"shape"`, `"feature"`
/// or `"other"`. Without a role it is `"other"`.
///
/// Observations have `layout`, `contact`, and whatever of `unknowns` (parameters), `start`, `inputs`, `features`, `orientation` (`"unused"`,
/// `"exact"`, `"first-order"`), `angles` (equations, by their index in the layout, that are of angles, rad; all others are of
/// lengths, mm), `rank_point` (`"as-recorded"`; `"in-contact"`, only and by default with the contact `"linear-axes"`;
/// `{ "nominal-reading": { row: { "residuals", "axes" } } }`, only with a reading), `approaches` and `data` there is.
pub const ABBE_DESCRIBE: u32 = 1;
/// Of stages: the files that they read. Answer: `[ { "setting", "path" } ]`.
pub const ABBE_INPUTS: u32 = 2;
/// Ingest: the columns. Answer: `[ { "name", "header", "quantity" } ]`.
pub const ABBE_HEADERS: u32 = 3;
/// Ingest: the data set. Answer: the data set.
pub const ABBE_READ: u32 = 4;
/// Artefact: whether columns can be used. Question: `{ "headers", "file" }` and a machine.
pub const ABBE_CHECK: u32 = 5;
/// Artefact: the observations. Question: a data set and a machine. Answer: observations.
pub const ABBE_OBSERVE: u32 = 6;
/// Artefact: the nominal programme. Question: the stylus radius, mm. Answer: `[ { "feature", "tip", "approach" } ]`.
pub const ABBE_TARGETS: u32 = 7;
/// Model: the machine. Question: a list of data sets, which may be empty. Answer: a machine.
pub const ABBE_BUILD: u32 = 8;
/// Machine: a motion error. Question: `{ "function", "values", "status" }`, with one value a parameter. Answer:
/// `{ "value", "derivatives": [ [parameter, derivative] ] }`.
pub const ABBE_MOTION_ERROR: u32 = 9;
/// Observations: the tip in nominal contact. Question: `{ "row", "tip", "own", "inputs" }`. Answer: `[x, y, z]` or `null`.
pub const ABBE_CONTACT_TIP: u32 = 10;
/// Estimate: solve. Question: a problem. Answer: a calibration.
pub const ABBE_SOLVE: u32 = 11;
/// Estimate: solve and explain.
pub const ABBE_EXPLAIN: u32 = 12;
/// Estimate: the values of the unknowns alone. Answer: a list of numbers.
pub const ABBE_VALUES: u32 = 13;
/// Estimate: analyses a fit. Question: a fit. Answer: a calibration.
pub const ABBE_ANALYSE: u32 = 14;
/// Estimate: what the problem can determine. Question: a problem.
pub const ABBE_IDENTIFY: u32 = 15;
/// Estimate: whether it would solve what can be determined this far. Answer: `true` or `false`.
pub const ABBE_ACCEPTS: u32 = 16;
/// Validate: the observations that its settings name. Answer: `[ [setting, stage] ]`.
pub const ABBE_OBSERVATIONS: u32 = 17;
/// Validate: judge. Question: `{ "fits", "data" }`. Answer: `{ "figures", "remarks" }`.
pub const ABBE_JUDGE: u32 = 18;
/// Export: write. Question: a calibration and a machine. Answer: `[ { "name", "text" } ]`, or `bytes` instead of `text`.
pub const ABBE_WRITE: u32 = 19;

/// A text: UTF-8, not terminated. No bytes may be a null pointer.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct AbbeText {
    /// First byte.
    pub data: *const c_char,
    /// Number of bytes.
    pub length: u64,
}

/// An object of the other side.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct AbbeObject {
    /// Its functions.
    pub table: *const AbbeTable,
    /// What they are called with.
    pub handle: *mut c_void,
}

/// The functions of an object; those that it has nothing to do with may be null.
#[repr(C)]
pub struct AbbeTable {
    /// Size of this table, bytes.
    pub size: u64,
    /// Keeps the object: one more `release` is needed.
    pub retain: Option<unsafe extern "C" fn(handle: *mut c_void)>,
    /// Lets go of the object.
    pub release: Option<unsafe extern "C" fn(handle: *mut c_void)>,
    /// Carries out a method.
    pub call: Option<
        unsafe extern "C" fn(
            handle: *mut c_void,
            method: u32,
            question: *const AbbeQuestion,
            reply: *const AbbeReply,
        ) -> u32,
    >,
    /// Of machines: poses and derivatives of a batch.
    pub poses:
        Option<unsafe extern "C" fn(handle: *mut c_void, batch: *const AbbePoses, reply: *const AbbeReply) -> u32>,
    /// Of observations: residuals and derivatives of some rows.
    pub equations: Option<
        unsafe extern "C" fn(
            handle: *mut c_void,
            rows: *const AbbeRows,
            equations: *const AbbeEquations,
            reply: *const AbbeReply,
        ) -> u32,
    >,
}

/// What a method is asked: a text, with objects that it refers to by their index.
#[repr(C)]
pub struct AbbeQuestion {
    /// Size of this structure, bytes.
    pub size: u64,
    /// The text.
    pub text: AbbeText,
    /// The objects.
    pub objects: *const AbbeObject,
    /// How many.
    pub object_count: u64,
}

/// Where an answer goes.
#[repr(C)]
pub struct AbbeReply {
    /// Size of this structure, bytes.
    pub size: u64,
    /// What the functions are called with.
    pub context: *mut c_void,
    /// Takes the text of the answer or of the error; a second one replaces the first.
    pub text: Option<unsafe extern "C" fn(context: *mut c_void, text: AbbeText)>,
    /// Takes an object that the answer gives.
    pub object: Option<unsafe extern "C" fn(context: *mut c_void, object: AbbeObject)>,
}

/// What a derivative is taken to.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AbbeVariable {
    /// 0: a parameter; 1: the command of an axis.
    pub kind: u32,
    /// Index of the parameter or of the axis.
    pub index: u32,
}

/// A batch of poses: what is given, and room for what is wanted, zero before the call.
#[repr(C)]
pub struct AbbePoses {
    /// Size of this structure, bytes.
    pub size: u64,
    /// poses x statuses of one pose.
    pub statuses: *const f64,
    /// Number of statuses in the whole batch.
    pub status_count: u64,
    /// Values of all parameters.
    pub values: *const f64,
    /// How many.
    pub value_count: u64,
    /// The variables that derivatives are wanted for.
    pub wanted: *const AbbeVariable,
    /// How many.
    pub wanted_count: u64,
    /// Number of poses.
    pub pose_count: u64,
    /// poses x 3: tip in the table frame, mm.
    pub positions: *mut f64,
    /// poses x 4: unit quaternion w, x, y, z; null unless wanted.
    pub orientations: *mut f64,
    /// poses x wanted x 3: d(position)/d(variable).
    pub position_derivatives: *mut f64,
    /// poses x wanted x 3: d(rotation vector, table frame)/d(variable); null unless orientations are wanted.
    pub rotation_derivatives: *mut f64,
}

/// Rows of observations with their poses.
#[repr(C)]
pub struct AbbeRows {
    /// Size of this structure, bytes.
    pub size: u64,
    /// Indices of the rows.
    pub rows: *const u64,
    /// How many.
    pub row_count: u64,
    /// poses x 3, in the order of the rows.
    pub positions: *const f64,
    /// poses x 4; null unless the observations ask for orientations.
    pub orientations: *const f64,
    /// Number of poses.
    pub pose_count: u64,
    /// Values of the own unknowns.
    pub own: *const f64,
    /// How many.
    pub own_count: u64,
    /// Values of the known inputs.
    pub inputs: *const f64,
    /// How many.
    pub input_count: u64,
}

/// Where residuals and derivatives go, equation by equation.
#[repr(C)]
pub struct AbbeEquations {
    /// Size of this structure, bytes.
    pub size: u64,
    /// What the functions are called with.
    pub context: *mut c_void,
    /// Starts the next equation with its residual, mm or rad.
    pub equation: Option<unsafe extern "C" fn(context: *mut c_void, residual: f64)>,
    /// Derivative to the tip position of the next pose of the row.
    pub position: Option<unsafe extern "C" fn(context: *mut c_void, x: f64, y: f64, z: f64)>,
    /// Derivative to the rotation vector of the next pose.
    pub rotation: Option<unsafe extern "C" fn(context: *mut c_void, x: f64, y: f64, z: f64)>,
    /// Derivative to an own unknown.
    pub own: Option<unsafe extern "C" fn(context: *mut c_void, unknown: u64, derivative: f64)>,
    /// Derivative to a known input.
    pub input: Option<unsafe extern "C" fn(context: *mut c_void, input: u64, derivative: f64)>,
}

/// One plugin of a library.
#[repr(C)]
pub struct AbbePlugin {
    /// Size of this structure, bytes.
    pub size: u64,
    /// Its kind.
    pub kind: u32,
    /// The name that recipes use.
    pub name: AbbeText,
    /// One line that says what it does.
    pub about: AbbeText,
    /// JSON Schema of its settings.
    pub schema: AbbeText,
    /// Settings that it can be built from, JSON.
    pub example: AbbeText,
    /// Builds a stage: this record, settings as JSON, and the folder that relative paths start from. The reply gets one object.
    pub create: Option<
        unsafe extern "C" fn(
            plugin: *const AbbePlugin,
            settings: AbbeText,
            base: AbbeText,
            reply: *const AbbeReply,
        ) -> u32,
    >,
    /// What its reference page says beside its settings, as Markdown with headings of level 2: when to use it, equation,
    /// source. May be empty.
    pub reference: AbbeText,
}

/// What a library has.
#[repr(C)]
pub struct AbbeLibrary {
    /// [`ABBE_ABI_MAJOR`] that the library was built with.
    pub abi_major: u32,
    /// [`ABBE_ABI_MINOR`] that the library was built with.
    pub abi_minor: u32,
    /// Size of this structure, bytes.
    pub size: u64,
    /// Name of the library.
    pub name: AbbeText,
    /// Its version.
    pub version: AbbeText,
    /// Its plugins.
    pub plugins: *const *const AbbePlugin,
    /// How many.
    pub plugin_count: u64,
}

/// What the program offers to a library as a whole.
#[repr(C)]
pub struct AbbeHost {
    /// [`ABBE_ABI_MAJOR`] of the program.
    pub abi_major: u32,
    /// [`ABBE_ABI_MINOR`] of the program.
    pub abi_minor: u32,
    /// Size of this structure, bytes.
    pub size: u64,
    /// Writes a line into the log: 0 error, 1 warning, 2 information, 3 detail.
    pub log: Option<unsafe extern "C" fn(level: u32, text: AbbeText)>,
}

/// The exported function: called once, before anything else. The table it gives stays valid for ever; null means that the
/// library cannot work with this program.
pub type AbbeEntry = unsafe extern "C" fn(host: *const AbbeHost) -> *const AbbeLibrary;
