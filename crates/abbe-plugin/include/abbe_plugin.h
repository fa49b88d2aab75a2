/* The plugin interface of Abbe, for plugins in C and C++.
 *
 * A library exports one function, `abbe_plugin`. What each part means is documented in crates/abbe-plugin/src/abi.rs; a test
 * compares every number, size and offset here with it. All text is UTF-8; questions and answers are JSON.
 *
 * Rules: structures are only appended to and begin with their size; what a call gets is lent until it returns; every function
 * may be called from several threads at once; nothing may unwind or jump out of a function. */
#ifndef ABBE_PLUGIN_H
#define ABBE_PLUGIN_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define ABBE_ABI_MAJOR 1
#define ABBE_ABI_MINOR 0

/* Status of a call. */
#define ABBE_OK 0
#define ABBE_FAILED 1              /* the text of the reply is one sentence */
#define ABBE_FAILED_WITH_DETAILS 2 /* JSON: message, and help, class, setting or path, place */
#define ABBE_PANICKED 3
#define ABBE_UNKNOWN_METHOD 4

/* Kinds of plugin. */
#define ABBE_INGEST 0
#define ABBE_ARTEFACT 1
#define ABBE_MODEL 2
#define ABBE_ESTIMATE 3
#define ABBE_VALIDATE 4
#define ABBE_EXPORT 5

/* Methods of objects. */
#define ABBE_DESCRIBE 1
#define ABBE_INPUTS 2
#define ABBE_HEADERS 3
#define ABBE_READ 4
#define ABBE_CHECK 5
#define ABBE_OBSERVE 6
#define ABBE_TARGETS 7
#define ABBE_BUILD 8
#define ABBE_MOTION_ERROR 9
#define ABBE_CONTACT_TIP 10
#define ABBE_SOLVE 11
#define ABBE_EXPLAIN 12
#define ABBE_VALUES 13
#define ABBE_RECONSIDER 14
#define ABBE_IDENTIFY 15
#define ABBE_ACCEPTS 16
#define ABBE_OBSERVATIONS 17
#define ABBE_JUDGE 18
#define ABBE_WRITE 19

typedef struct AbbeText {
    const char *data; /* not terminated */
    uint64_t length;
} AbbeText;

typedef struct AbbeTable AbbeTable;

typedef struct AbbeObject {
    const AbbeTable *table;
    void *handle;
} AbbeObject;

typedef struct AbbeQuestion {
    uint64_t size;
    AbbeText text;
    const AbbeObject *objects; /* lent */
    uint64_t object_count;
} AbbeQuestion;

typedef struct AbbeReply {
    uint64_t size;
    void *context;
    void (*text)(void *context, AbbeText text);
    void (*object)(void *context, AbbeObject object); /* given away */
} AbbeReply;

typedef struct AbbeVariable {
    uint32_t kind; /* 0: a parameter, 1: the command of an axis */
    uint32_t index;
} AbbeVariable;

/* A batch of poses: what is given, and room for what is wanted, zero before the call. mm and rad. */
typedef struct AbbePoses {
    uint64_t size;
    const double *statuses; /* poses x statuses of one pose */
    uint64_t status_count;  /* of the whole batch */
    const double *values;   /* of all parameters */
    uint64_t value_count;
    const AbbeVariable *wanted;
    uint64_t wanted_count;
    uint64_t pose_count;
    double *positions;            /* poses x 3: tip in the table frame */
    double *orientations;         /* poses x 4: unit quaternion w, x, y, z; null unless wanted */
    double *position_derivatives; /* poses x wanted x 3 */
    double *rotation_derivatives; /* poses x wanted x 3, rotation vector in the table frame; null unless wanted */
} AbbePoses;

/* Rows of observations with their poses. */
typedef struct AbbeRows {
    uint64_t size;
    const uint64_t *rows;
    uint64_t row_count;
    const double *positions;
    const double *orientations;
    uint64_t pose_count;
    const double *own;
    uint64_t own_count;
    const double *inputs;
    uint64_t input_count;
} AbbeRows;

/* Where residuals and derivatives go, equation by equation. */
typedef struct AbbeEquations {
    uint64_t size;
    void *context;
    void (*equation)(void *context, double residual);
    void (*position)(void *context, double x, double y, double z);
    void (*rotation)(void *context, double x, double y, double z);
    void (*own)(void *context, uint64_t unknown, double derivative);
    void (*input)(void *context, uint64_t input, double derivative);
} AbbeEquations;

struct AbbeTable {
    uint64_t size;
    void (*retain)(void *handle);
    void (*release)(void *handle);
    uint32_t (*call)(void *handle, uint32_t method, const AbbeQuestion *question, const AbbeReply *reply);
    uint32_t (*poses)(void *handle, const AbbePoses *batch, const AbbeReply *reply);
    uint32_t (*equations)(void *handle, const AbbeRows *rows, const AbbeEquations *equations, const AbbeReply *reply);
};

typedef struct AbbePlugin AbbePlugin;

struct AbbePlugin {
    uint64_t size;
    uint32_t kind;
    AbbeText name;
    AbbeText about;
    AbbeText schema;  /* JSON Schema of the settings */
    AbbeText example; /* settings that it can be built from */
    uint32_t (*create)(const AbbePlugin *plugin, AbbeText settings, AbbeText base, const AbbeReply *reply);
};

typedef struct AbbeLibrary {
    uint32_t abi_major;
    uint32_t abi_minor;
    uint64_t size;
    AbbeText name;
    AbbeText version;
    const AbbePlugin *const *plugins;
    uint64_t plugin_count;
} AbbeLibrary;

typedef struct AbbeHost {
    uint32_t abi_major;
    uint32_t abi_minor;
    uint64_t size;
    void (*log)(uint32_t level, AbbeText text); /* 0 error, 1 warning, 2 information, 3 detail */
} AbbeHost;

/* What a library exports. The table stays valid for ever; null refuses to work with this program. */
#if defined(_WIN32)
__declspec(dllexport)
#elif defined(__GNUC__)
__attribute__((visibility("default")))
#endif
const AbbeLibrary *abbe_plugin(const AbbeHost *host);

/* A text from a string literal or an array of characters that ends with zero. */
#define ABBE_TEXT(literal) { literal, sizeof(literal) - 1 }

#ifdef __cplusplus
}
#endif

#endif
