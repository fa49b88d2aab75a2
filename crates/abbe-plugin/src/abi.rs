//! The C ABI: what crosses between Abbe and a plugin library, in either direction.
//!
//! A library exports one symbol, [`ENTRY`]: a function that returns the table of the library ([`AbbeLibrary`]). The plugins of
//! the library create **objects**. An object is a table of functions with a handle. The program gives plugins objects, too: the
//! model of a machine, observations, an estimator. All objects have the same table of functions, so the interface is the same
//! in both directions.
//!
//! - Questions and answers are UTF-8 text: JSON, in which a number that is not finite is `null` and paths are text.
//! - Poses and equations, which are evaluated very often, are plain `f64` slices that the caller owns. They are not copied.
//! - **Growth**: new fields are only added at the end of a structure, and every structure has its size in bytes. A function that
//!   is null, or beyond the end of a table, is not available on the other side. The major number changes when this is not enough.
//! - **Ownership**: arguments of a call are lent until the call returns; `retain` keeps an object for longer. The receiver of a
//!   reply owns the objects in it and releases them. The receiver of a text copies it.
//! - **Threads**: every function may be called from several threads at once.
//! - **Errors** are a status and a text. No exception and no panic may leave a function.
//!
//! `cargo xtask header` makes the header for C from this file.

use std::ffi::{c_char, c_void};

/// The major number. A library with another major number is refused.
pub const ABBE_ABI_MAJOR: u32 = 2;
/// The minor number. A higher minor number means more functions.
pub const ABBE_ABI_MINOR: u32 = 0;

/// The symbol that a plugin library exports, an [`AbbeEntry`].
pub const ENTRY: &str = "abbe_plugin";

/// Success.
pub const ABBE_OK: u32 = 0;
/// An error; the text of the reply is one sentence.
pub const ABBE_FAILED: u32 = 1;
/// An error; the text of the reply is JSON with a `message`. These are optional: `help`, `class` ("use" or "data"),
/// `setting` (of a stage) or `path` (in settings), `place`, `pose` (its index among the poses that are evaluated together,
/// from 0) and `fault`. If `fault` is missing or false, an evaluation failed only for the given numbers, and an estimator
/// tries others. If it is true, the code itself failed, and the run ends.
pub const ABBE_FAILED_WITH_DETAILS: u32 = 2;
/// The code panicked; the text is the message of the panic.
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

/// Machines and observations: their description. Answer: JSON.
///
/// A machine has `axes`, `status` (the columns of the status of poses), `parameters` and `settings`. These are optional:
/// `stylus_radius`, `nominal` and `nominal_uncertainties` (one value for each parameter, zero if they are missing),
/// `error_functions` and `periods`. Every column of the status has a `role`: `{ "command": axis }` for the command of an
/// axis, `{ "direction": axis }`, `"time"`, `"stylus"`, `"series"`, `"temperature"`, `"load"`, `"feed"`, `{ "velocity":
/// axis }`, `{ "sensor": name }`, `{ "thermal-state": name }`, `"probe"` or `"other"`. Every parameter has a `role`, too:
/// `{ "motion": { "axis", "component" } }` (component 0 to 5), `{ "location": { "axis", "component" } }`, `"set-up"`,
/// `"shape"`, `"factor"`, `"feature"` or `"other"`. A missing role is `"other"`.
///
/// Observations have `layout` and `contact`. These are optional: `unknowns` (parameters), `start`, `inputs`, `features`,
/// `orientation` (`"unused"`, `"exact"`, `"first-order"`), `angles` (indices in the layout of the equations that are
/// angles, rad; all other equations are lengths, mm), `rank_point`, `approaches` and `data`. `rank_point` is
/// `"as-recorded"`, `"in-contact"` (for the contact `"linear-axes"` only, where it is the default) or `{ "nominal-reading":
/// { row: { "residuals", "axes" } } }` (for a contact with a reading only).
pub const ABBE_DESCRIBE: u32 = 1;
/// Stages: the files that they read. Answer: `[ { "setting", "path" } ]`.
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
/// Machine: a motion error. Question: `{ "function", "values", "status" }`, with one value for each parameter. Answer:
/// `{ "value", "derivatives": [ [parameter, derivative] ] }`.
pub const ABBE_MOTION_ERROR: u32 = 9;
/// Observations: the tip in nominal contact. Question: `{ "row", "tip", "own", "inputs" }`. Answer: `[x, y, z]` or `null`.
pub const ABBE_CONTACT_TIP: u32 = 10;
/// Estimate: solve. Question: a problem. Answer: a calibration.
pub const ABBE_SOLVE: u32 = 11;
/// Estimate: solve and explain the result. Question: a problem. Answer: a calibration with uncertainty budgets.
pub const ABBE_EXPLAIN: u32 = 12;
/// Estimate: only the values of the unknowns. Question: a problem. Answer: a list of numbers.
pub const ABBE_VALUES: u32 = 13;
/// Estimate: analyse a fit. Question: a fit. Answer: a calibration.
pub const ABBE_ANALYSE: u32 = 14;
/// Estimate: what the data can determine, without solving. Question: a problem. Answer: an identifiability.
pub const ABBE_IDENTIFY: u32 = 15;
/// Estimate: whether it would solve a problem with this identifiability. Question: an identifiability. Answer: `true` or
/// `false`.
pub const ABBE_ACCEPTS: u32 = 16;
/// Validate: the observations that its settings name. Answer: `[ [setting, stage] ]`.
pub const ABBE_OBSERVATIONS: u32 = 17;
/// Validate: judge fits and data. Question: `{ "fits", "data" }`. Answer: `{ "figures", "remarks" }`.
pub const ABBE_JUDGE: u32 = 18;
/// Export: the files. Question: a calibration and a machine. Answer: `[ { "name", "text" } ]`, or `bytes` instead of
/// `text`.
pub const ABBE_WRITE: u32 = 19;

/// A text: UTF-8, without a zero at the end. In an empty text `data` may be null.
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
    /// The first argument of its functions.
    pub handle: *mut c_void,
}

/// The functions of an object. Functions that it does not need may be null.
#[repr(C)]
pub struct AbbeTable {
    /// Size of this table, bytes.
    pub size: u64,
    /// Keeps the object. Every `retain` needs one `release`.
    pub retain: Option<unsafe extern "C" fn(handle: *mut c_void)>,
    /// Releases the object.
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
    /// Machines only: poses and derivatives of a batch.
    pub poses:
        Option<unsafe extern "C" fn(handle: *mut c_void, batch: *const AbbePoses, reply: *const AbbeReply) -> u32>,
    /// Observations only: residuals and derivatives of some rows.
    pub equations: Option<
        unsafe extern "C" fn(
            handle: *mut c_void,
            rows: *const AbbeRows,
            equations: *const AbbeEquations,
            reply: *const AbbeReply,
        ) -> u32,
    >,
}

/// The question to a method: a text, and the objects to which the text refers by their index.
#[repr(C)]
pub struct AbbeQuestion {
    /// Size of this structure, bytes.
    pub size: u64,
    /// The text.
    pub text: AbbeText,
    /// The objects.
    pub objects: *const AbbeObject,
    /// Number of objects.
    pub object_count: u64,
}

/// The functions that take the answer to a question.
#[repr(C)]
pub struct AbbeReply {
    /// Size of this structure, bytes.
    pub size: u64,
    /// The first argument of these functions.
    pub context: *mut c_void,
    /// Takes the text of the answer or of the error. A second text replaces the first one.
    pub text: Option<unsafe extern "C" fn(context: *mut c_void, text: AbbeText)>,
    /// Takes an object of the answer.
    pub object: Option<unsafe extern "C" fn(context: *mut c_void, object: AbbeObject)>,
}

/// The variable of a derivative.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AbbeVariable {
    /// 0: a parameter; 1: the command of an axis.
    pub kind: u32,
    /// Index of the parameter or of the axis.
    pub index: u32,
}

/// A batch of poses: the inputs, and lists for the results, which contain zeros before the call.
#[repr(C)]
pub struct AbbePoses {
    /// Size of this structure, bytes.
    pub size: u64,
    /// The status of every pose: poses x columns of the status.
    pub statuses: *const f64,
    /// Number of values in `statuses`.
    pub status_count: u64,
    /// Values of all parameters.
    pub values: *const f64,
    /// Number of parameters.
    pub value_count: u64,
    /// The variables that derivatives are wanted for.
    pub wanted: *const AbbeVariable,
    /// Number of these variables.
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
    /// Number of rows.
    pub row_count: u64,
    /// poses x 3, in the order of the rows.
    pub positions: *const f64,
    /// poses x 4; null unless the observations ask for orientations.
    pub orientations: *const f64,
    /// Number of poses.
    pub pose_count: u64,
    /// Values of the own unknowns.
    pub own: *const f64,
    /// Number of own unknowns.
    pub own_count: u64,
    /// Values of the known inputs.
    pub inputs: *const f64,
    /// Number of known inputs.
    pub input_count: u64,
}

/// The functions that take residuals and derivatives, equation by equation.
#[repr(C)]
pub struct AbbeEquations {
    /// Size of this structure, bytes.
    pub size: u64,
    /// The first argument of these functions.
    pub context: *mut c_void,
    /// Starts the next equation and takes its residual, mm or rad.
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
    /// Builds a stage. Arguments: this record, the settings as JSON, and the folder to which relative paths refer. The
    /// reply gets one object, the stage.
    pub create: Option<
        unsafe extern "C" fn(
            plugin: *const AbbePlugin,
            settings: AbbeText,
            base: AbbeText,
            reply: *const AbbeReply,
        ) -> u32,
    >,
    /// The text of its reference page without the settings, as Markdown with headings of level 2: when to use it, equation,
    /// source. May be empty.
    pub reference: AbbeText,
}

/// The description of a library.
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
    /// Number of plugins.
    pub plugin_count: u64,
}

/// The functions that the program offers to every library.
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

/// The exported function. It is called once, before all other functions. The table that it returns stays valid until the
/// process ends. Null means that the library cannot work with this program.
pub type AbbeEntry = unsafe extern "C" fn(host: *const AbbeHost) -> *const AbbeLibrary;
