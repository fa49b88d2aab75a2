/* The plugin interface of Abbe, for plugins in C and C++.
 *
 * Made of crates/abbe-plugin/src/abi.rs by `cargo xtask header`; not to be edited. All text is UTF-8; questions and answers
 * are JSON.
 *
 * Rules: structures are only appended to and begin with their size; what a call gets is lent until it returns; every function
 * may be called from several threads at once; nothing may unwind or jump out of a function. */
#ifndef ABBE_PLUGIN_H
#define ABBE_PLUGIN_H

#include <stdint.h>

struct AbbeReply;

// The major number: another one is refused.
#define ABBE_ABI_MAJOR 2

// The minor number: a higher one has more functions.
#define ABBE_ABI_MINOR 0

// Success.
#define ABBE_OK 0

// An error; the text of the reply is one sentence.
#define ABBE_FAILED 1

// An error; the text of the reply is JSON: `message`, and whatever of `help`, `class` ("use" or "data"), `setting` (of stages)
// or `path` (of settings), `place`, `pose` (of those that were evaluated together, from 0) there is. An evaluation that fails
// refuses the numbers that it was asked with, and an estimator tries others, unless `fault` is true: the code itself failed.
#define ABBE_FAILED_WITH_DETAILS 2

// The code panicked; the text says how.
#define ABBE_PANICKED 3

// The object does not know the method.
#define ABBE_UNKNOWN_METHOD 4

// Kinds of plugin.
#define ABBE_INGEST 0

// A plugin that makes observations.
#define ABBE_ARTEFACT 1

// A plugin that describes machines.
#define ABBE_MODEL 2

// A plugin that solves problems.
#define ABBE_ESTIMATE 3

// A plugin that judges calibrations.
#define ABBE_VALIDATE 4

// A plugin that writes files.
#define ABBE_EXPORT 5

// Of machines and observations: what they are. Answer: JSON.
//
// A machine has `axes`, `status`, `parameters`, `settings`, and whatever of `stylus_radius`, `nominal`, `nominal_uncertainties` (one
// value a parameter; without them all are zero), `error_functions` and `periods` there is. A status has a `role`: `{ "command": axis }`
// for the status of every axis, else `{ "direction": axis }`, `"time"`, `"stylus"`, `"series"`, `"temperature"`, `"load"`, `"feed"`,
// `{ "velocity": axis }`, `{ "sensor": name }`, `{ "thermal-state": name }`, `"probe"` or `"other"`. A parameter has one, too:
// `{ "motion": { "axis", "component" } }` (component 0..6), `{ "location": { "axis", "component" } }`, `"set-up"`, `"shape"`, `"feature"`
// or `"other"`. Without a role it is `"other"`.
//
// Observations have `layout`, `contact`, and whatever of `unknowns` (parameters), `start`, `inputs`, `features`, `orientation` (`"unused"`,
// `"exact"`, `"first-order"`), `angles` (equations, by their index in the layout, that are of angles, rad; all others are of
// lengths, mm), `rank_point` (`"as-recorded"`; `"in-contact"`, only and by default with the contact `"linear-axes"`;
// `{ "nominal-reading": { row: { "residuals", "axes" } } }`, only with a reading), `approaches` and `data` there is.
#define ABBE_DESCRIBE 1

// Of stages: the files that they read. Answer: `[ { "setting", "path" } ]`.
#define ABBE_INPUTS 2

// Ingest: the columns. Answer: `[ { "name", "header", "quantity" } ]`.
#define ABBE_HEADERS 3

// Ingest: the data set. Answer: the data set.
#define ABBE_READ 4

// Artefact: whether columns can be used. Question: `{ "headers", "file" }` and a machine.
#define ABBE_CHECK 5

// Artefact: the observations. Question: a data set and a machine. Answer: observations.
#define ABBE_OBSERVE 6

// Artefact: the nominal programme. Question: the stylus radius, mm. Answer: `[ { "feature", "tip", "approach" } ]`.
#define ABBE_TARGETS 7

// Model: the machine. Question: a list of data sets, which may be empty. Answer: a machine.
#define ABBE_BUILD 8

// Machine: a motion error. Question: `{ "function", "values", "status" }`, with one value a parameter. Answer:
// `{ "value", "derivatives": [ [parameter, derivative] ] }`.
#define ABBE_MOTION_ERROR 9

// Observations: the tip in nominal contact. Question: `{ "row", "tip", "own", "inputs" }`. Answer: `[x, y, z]` or `null`.
#define ABBE_CONTACT_TIP 10

// Estimate: solve. Question: a problem. Answer: a calibration.
#define ABBE_SOLVE 11

// Estimate: solve and explain.
#define ABBE_EXPLAIN 12

// Estimate: the values of the unknowns alone. Answer: a list of numbers.
#define ABBE_VALUES 13

// Estimate: analyses a fit. Question: a fit. Answer: a calibration.
#define ABBE_ANALYSE 14

// Estimate: what the problem can determine. Question: a problem.
#define ABBE_IDENTIFY 15

// Estimate: whether it would solve what can be determined this far. Answer: `true` or `false`.
#define ABBE_ACCEPTS 16

// Validate: the observations that its settings name. Answer: `[ [setting, stage] ]`.
#define ABBE_OBSERVATIONS 17

// Validate: judge. Question: `{ "fits", "data" }`. Answer: `{ "figures", "remarks" }`.
#define ABBE_JUDGE 18

// Export: write. Question: a calibration and a machine. Answer: `[ { "name", "text" } ]`, or `bytes` instead of `text`.
#define ABBE_WRITE 19

// A text: UTF-8, not terminated. No bytes may be a null pointer.
typedef struct AbbeText {
    // First byte.
    const char *data;
    // Number of bytes.
    uint64_t length;
} AbbeText;

// What a method is asked: a text, with objects that it refers to by their index.
typedef struct AbbeQuestion {
    // Size of this structure, bytes.
    uint64_t size;
    // The text.
    struct AbbeText text;
    // The objects.
    const struct AbbeObject *objects;
    // How many.
    uint64_t object_count;
} AbbeQuestion;

// What a derivative is taken to.
typedef struct AbbeVariable {
    // 0: a parameter; 1: the command of an axis.
    uint32_t kind;
    // Index of the parameter or of the axis.
    uint32_t index;
} AbbeVariable;

// A batch of poses: what is given, and room for what is wanted, zero before the call.
typedef struct AbbePoses {
    // Size of this structure, bytes.
    uint64_t size;
    // poses x statuses of one pose.
    const double *statuses;
    // Number of statuses in the whole batch.
    uint64_t status_count;
    // Values of all parameters.
    const double *values;
    // How many.
    uint64_t value_count;
    // The variables that derivatives are wanted for.
    const struct AbbeVariable *wanted;
    // How many.
    uint64_t wanted_count;
    // Number of poses.
    uint64_t pose_count;
    // poses x 3: tip in the table frame, mm.
    double *positions;
    // poses x 4: unit quaternion w, x, y, z; null unless wanted.
    double *orientations;
    // poses x wanted x 3: d(position)/d(variable).
    double *position_derivatives;
    // poses x wanted x 3: d(rotation vector, table frame)/d(variable); null unless orientations are wanted.
    double *rotation_derivatives;
} AbbePoses;

// Rows of observations with their poses.
typedef struct AbbeRows {
    // Size of this structure, bytes.
    uint64_t size;
    // Indices of the rows.
    const uint64_t *rows;
    // How many.
    uint64_t row_count;
    // poses x 3, in the order of the rows.
    const double *positions;
    // poses x 4; null unless the observations ask for orientations.
    const double *orientations;
    // Number of poses.
    uint64_t pose_count;
    // Values of the own unknowns.
    const double *own;
    // How many.
    uint64_t own_count;
    // Values of the known inputs.
    const double *inputs;
    // How many.
    uint64_t input_count;
} AbbeRows;

// Where residuals and derivatives go, equation by equation.
typedef struct AbbeEquations {
    // Size of this structure, bytes.
    uint64_t size;
    // What the functions are called with.
    void *context;
    // Starts the next equation with its residual, mm or rad.
    void (*equation)(void *context, double residual);
    // Derivative to the tip position of the next pose of the row.
    void (*position)(void *context, double x, double y, double z);
    // Derivative to the rotation vector of the next pose.
    void (*rotation)(void *context, double x, double y, double z);
    // Derivative to an own unknown.
    void (*own)(void *context, uint64_t unknown, double derivative);
    // Derivative to a known input.
    void (*input)(void *context, uint64_t input, double derivative);
} AbbeEquations;

// The functions of an object; those that it has nothing to do with may be null.
typedef struct AbbeTable {
    // Size of this table, bytes.
    uint64_t size;
    // Keeps the object: one more `release` is needed.
    void (*retain)(void *handle);
    // Lets go of the object.
    void (*release)(void *handle);
    // Carries out a method.
    uint32_t (*call)(void *handle, uint32_t method, const struct AbbeQuestion *question, const struct AbbeReply *reply);
    // Of machines: poses and derivatives of a batch.
    uint32_t (*poses)(void *handle, const struct AbbePoses *batch, const struct AbbeReply *reply);
    // Of observations: residuals and derivatives of some rows.
    uint32_t (*equations)(void *handle,
                          const struct AbbeRows *rows,
                          const struct AbbeEquations *equations,
                          const struct AbbeReply *reply);
} AbbeTable;

// An object of the other side.
typedef struct AbbeObject {
    // Its functions.
    const struct AbbeTable *table;
    // What they are called with.
    void *handle;
} AbbeObject;

// Where an answer goes.
typedef struct AbbeReply {
    // Size of this structure, bytes.
    uint64_t size;
    // What the functions are called with.
    void *context;
    // Takes the text of the answer or of the error; a second one replaces the first.
    void (*text)(void *context, struct AbbeText text);
    // Takes an object that the answer gives.
    void (*object)(void *context, struct AbbeObject object);
} AbbeReply;

// One plugin of a library.
typedef struct AbbePlugin {
    // Size of this structure, bytes.
    uint64_t size;
    // Its kind.
    uint32_t kind;
    // The name that recipes use.
    struct AbbeText name;
    // One line that says what it does.
    struct AbbeText about;
    // JSON Schema of its settings.
    struct AbbeText schema;
    // Settings that it can be built from, JSON.
    struct AbbeText example;
    // Builds a stage: this record, settings as JSON, and the folder that relative paths start from. The reply gets one object.
    uint32_t (*create)(const struct AbbePlugin *plugin,
                       struct AbbeText settings,
                       struct AbbeText base,
                       const struct AbbeReply *reply);
    // What its reference page says beside its settings, as Markdown with headings of level 2: when to use it, equation,
    // source. May be empty.
    struct AbbeText reference;
} AbbePlugin;

// What a library has.
typedef struct AbbeLibrary {
    // `ABBE_ABI_MAJOR` that the library was built with.
    uint32_t abi_major;
    // `ABBE_ABI_MINOR` that the library was built with.
    uint32_t abi_minor;
    // Size of this structure, bytes.
    uint64_t size;
    // Name of the library.
    struct AbbeText name;
    // Its version.
    struct AbbeText version;
    // Its plugins.
    const struct AbbePlugin *const *plugins;
    // How many.
    uint64_t plugin_count;
} AbbeLibrary;

// What the program offers to a library as a whole.
typedef struct AbbeHost {
    // `ABBE_ABI_MAJOR` of the program.
    uint32_t abi_major;
    // `ABBE_ABI_MINOR` of the program.
    uint32_t abi_minor;
    // Size of this structure, bytes.
    uint64_t size;
    // Writes a line into the log: 0 error, 1 warning, 2 information, 3 detail.
    void (*log)(uint32_t level, struct AbbeText text);
} AbbeHost;

// The exported function: called once, before anything else. The table it gives stays valid for ever; null means that the
// library cannot work with this program.
typedef const struct AbbeLibrary *(*AbbeEntry)(const struct AbbeHost *host);


/* What a library exports. The table stays valid for ever; null refuses to work with this program. */
#ifdef __cplusplus
extern "C"
#endif
#if defined(_WIN32)
__declspec(dllexport)
#elif defined(__GNUC__)
__attribute__((visibility("default")))
#endif
const AbbeLibrary *abbe_plugin(const AbbeHost *host);

/* A text from a string literal or an array of characters that ends with zero. */
#define ABBE_TEXT(literal) { literal, sizeof(literal) - 1 }

#endif
