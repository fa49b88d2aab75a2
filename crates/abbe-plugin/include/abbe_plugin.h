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

// The major number: another one is refused.
#define ABBE_ABI_MAJOR 1

// The minor number: a higher one has more functions.
#define ABBE_ABI_MINOR 0

// Success.
#define ABBE_OK 0

// An error; the text of the reply is one sentence.
#define ABBE_FAILED 1

// An error; the text of the reply is JSON: `message`, and whatever of `help`, `class` ("use" or "data"), `setting` (of stages)
// or `path` (of settings), `place` there is.
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

// Of machines and observations: what they are. Answer: JSON; of observations it lists in `angles` the equations (by their
// index in the layout) that are of angles, rad, and all others are of lengths, mm.
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

// Machine: a motion error as a linear combination. Question: `{ "function", "status" }`. Answer: `[ [parameter, factor] ]`.
#define ABBE_ERROR_TERMS 9

// Observations: the tip in nominal contact. Question: `{ "row", "tip", "own", "inputs" }`. Answer: `[x, y, z]` or `null`.
#define ABBE_CONTACT_TIP 10

// Estimate: solve. Question: a problem. Answer: a calibration.
#define ABBE_SOLVE 11

// Estimate: solve and explain.
#define ABBE_EXPLAIN 12

// Estimate: the values of the unknowns alone. Answer: a list of numbers.
#define ABBE_VALUES 13

// Estimate: a new look at a fit. Question: a fit. Answer: a calibration.
#define ABBE_RECONSIDER 14

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

#endif  /* ABBE_PLUGIN_H */


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
