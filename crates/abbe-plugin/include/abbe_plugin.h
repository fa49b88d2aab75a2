/* The plugin interface of Abbe, for plugins in C and C++.
 *
 * Made of crates/abbe-plugin/src/abi.rs by `cargo xtask header`; not to be edited. All text is UTF-8; questions and answers
 * are JSON.
 *
 * Rules: new fields are only added at the end of a structure, and every structure has its size. Arguments of a call are lent
 * until the call returns. Every function may be called from several threads at once. No exception may leave a function. */
#ifndef ABBE_PLUGIN_H
#define ABBE_PLUGIN_H

#include <stdint.h>

struct AbbeReply;

// The major number. A library with another major number is refused.
#define ABBE_ABI_MAJOR 2

// The minor number. A higher minor number means more functions.
#define ABBE_ABI_MINOR 0

// Success.
#define ABBE_OK 0

// An error; the text of the reply is one sentence.
#define ABBE_FAILED 1

// An error; the text of the reply is JSON with a `message`. These are optional: `help`, `class` ("use" or "data"),
// `setting` (of a stage) or `path` (in settings), `place`, `pose` (its index among the poses that are evaluated together,
// from 0) and `fault`. If `fault` is missing or false, an evaluation failed only for the given numbers, and an estimator
// tries others. If it is true, the code itself failed, and the run ends.
#define ABBE_FAILED_WITH_DETAILS 2

// The code panicked; the text is the message of the panic.
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

// Machines and observations: their description. Answer: JSON.
//
// A machine has `axes`, `status` (the columns of the status of poses), `parameters` and `settings`. These are optional:
// `stylus_radius`, `nominal` and `nominal_uncertainties` (one value for each parameter, zero if they are missing),
// `error_functions` and `periods`. Every column of the status has a `role`: `{ "command": axis }` for the command of an
// axis, `{ "direction": axis }`, `"time"`, `"stylus"`, `"series"`, `"temperature"`, `"load"`, `"feed"`, `{ "velocity":
// axis }`, `{ "sensor": name }`, `{ "thermal-state": name }`, `"probe"` or `"other"`. Every parameter has a `role`, too:
// `{ "motion": { "axis", "component" } }` (component 0 to 5), `{ "location": { "axis", "component" } }`, `"set-up"`,
// `"shape"`, `"factor"`, `"feature"` or `"other"`. A missing role is `"other"`.
//
// Observations have `layout` and `contact`. These are optional: `unknowns` (parameters), `start`, `inputs`, `features`,
// `orientation` (`"unused"`, `"exact"`, `"first-order"`), `angles` (indices in the layout of the equations that are
// angles, rad; all other equations are lengths, mm), `rank_point`, `approaches` and `data`. `rank_point` is
// `"as-recorded"`, `"in-contact"` (for the contact `"linear-axes"` only, where it is the default) or `{ "nominal-reading":
// { row: { "residuals", "axes" } } }` (for a contact with a reading only).
#define ABBE_DESCRIBE 1

// Stages: the files that they read. Answer: `[ { "setting", "path" } ]`.
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

// Machine: a motion error. Question: `{ "function", "values", "status" }`, with one value for each parameter. Answer:
// `{ "value", "derivatives": [ [parameter, derivative] ] }`.
#define ABBE_MOTION_ERROR 9

// Observations: the tip in nominal contact. Question: `{ "row", "tip", "own", "inputs" }`. Answer: `[x, y, z]` or `null`.
#define ABBE_CONTACT_TIP 10

// Estimate: solve. Question: a problem. Answer: a calibration.
#define ABBE_SOLVE 11

// Estimate: solve and explain the result. Question: a problem. Answer: a calibration with uncertainty budgets.
#define ABBE_EXPLAIN 12

// Estimate: only the values of the unknowns. Question: a problem. Answer: a list of numbers.
#define ABBE_VALUES 13

// Estimate: analyse a fit. Question: a fit. Answer: a calibration.
#define ABBE_ANALYSE 14

// Estimate: what the data can determine, without solving. Question: a problem. Answer: an identifiability.
#define ABBE_IDENTIFY 15

// Estimate: whether it would solve a problem with this identifiability. Question: an identifiability. Answer: `true` or
// `false`.
#define ABBE_ACCEPTS 16

// Validate: the observations that its settings name. Answer: `[ [setting, stage] ]`.
#define ABBE_OBSERVATIONS 17

// Validate: judge fits and data. Question: `{ "fits", "data" }`. Answer: `{ "figures", "remarks" }`.
#define ABBE_JUDGE 18

// Export: the files. Question: a calibration and a machine. Answer: `[ { "name", "text" } ]`, or `bytes` instead of
// `text`.
#define ABBE_WRITE 19

// A text: UTF-8, without a zero at the end. In an empty text `data` may be null.
typedef struct AbbeText {
    // First byte.
    const char *data;
    // Number of bytes.
    uint64_t length;
} AbbeText;

// The question to a method: a text, and the objects to which the text refers by their index.
typedef struct AbbeQuestion {
    // Size of this structure, bytes.
    uint64_t size;
    // The text.
    struct AbbeText text;
    // The objects.
    const struct AbbeObject *objects;
    // Number of objects.
    uint64_t object_count;
} AbbeQuestion;

// The variable of a derivative.
typedef struct AbbeVariable {
    // 0: a parameter; 1: the command of an axis.
    uint32_t kind;
    // Index of the parameter or of the axis.
    uint32_t index;
} AbbeVariable;

// A batch of poses: the inputs, and lists for the results, which contain zeros before the call.
typedef struct AbbePoses {
    // Size of this structure, bytes.
    uint64_t size;
    // The status of every pose: poses x columns of the status.
    const double *statuses;
    // Number of values in `statuses`.
    uint64_t status_count;
    // Values of all parameters.
    const double *values;
    // Number of parameters.
    uint64_t value_count;
    // The variables that derivatives are wanted for.
    const struct AbbeVariable *wanted;
    // Number of these variables.
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
    // Number of rows.
    uint64_t row_count;
    // poses x 3, in the order of the rows.
    const double *positions;
    // poses x 4; null unless the observations ask for orientations.
    const double *orientations;
    // Number of poses.
    uint64_t pose_count;
    // Values of the own unknowns.
    const double *own;
    // Number of own unknowns.
    uint64_t own_count;
    // Values of the known inputs.
    const double *inputs;
    // Number of known inputs.
    uint64_t input_count;
} AbbeRows;

// The functions that take residuals and derivatives, equation by equation.
typedef struct AbbeEquations {
    // Size of this structure, bytes.
    uint64_t size;
    // The first argument of these functions.
    void *context;
    // Starts the next equation and takes its residual, mm or rad.
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

// The functions of an object. Functions that it does not need may be null.
typedef struct AbbeTable {
    // Size of this table, bytes.
    uint64_t size;
    // Keeps the object. Every `retain` needs one `release`.
    void (*retain)(void *handle);
    // Releases the object.
    void (*release)(void *handle);
    // Carries out a method.
    uint32_t (*call)(void *handle, uint32_t method, const struct AbbeQuestion *question, const struct AbbeReply *reply);
    // Machines only: poses and derivatives of a batch.
    uint32_t (*poses)(void *handle, const struct AbbePoses *batch, const struct AbbeReply *reply);
    // Observations only: residuals and derivatives of some rows.
    uint32_t (*equations)(void *handle,
                          const struct AbbeRows *rows,
                          const struct AbbeEquations *equations,
                          const struct AbbeReply *reply);
} AbbeTable;

// An object of the other side.
typedef struct AbbeObject {
    // Its functions.
    const struct AbbeTable *table;
    // The first argument of its functions.
    void *handle;
} AbbeObject;

// The functions that take the answer to a question.
typedef struct AbbeReply {
    // Size of this structure, bytes.
    uint64_t size;
    // The first argument of these functions.
    void *context;
    // Takes the text of the answer or of the error. A second text replaces the first one.
    void (*text)(void *context, struct AbbeText text);
    // Takes an object of the answer.
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
    // Builds a stage. Arguments: this record, the settings as JSON, and the folder to which relative paths refer. The
    // reply gets one object, the stage.
    uint32_t (*create)(const struct AbbePlugin *plugin,
                       struct AbbeText settings,
                       struct AbbeText base,
                       const struct AbbeReply *reply);
    // The text of its reference page without the settings, as Markdown with headings of level 2: when to use it, equation,
    // source. May be empty.
    struct AbbeText reference;
} AbbePlugin;

// The description of a library.
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
    // Number of plugins.
    uint64_t plugin_count;
} AbbeLibrary;

// The functions that the program offers to every library.
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

// The exported function. It is called once, before all other functions. The table that it returns stays valid until the
// process ends. Null means that the library cannot work with this program.
typedef const struct AbbeLibrary *(*AbbeEntry)(const struct AbbeHost *host);


/* The function that a library exports. Its table stays valid until the process ends; null refuses to work with this program. */
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
