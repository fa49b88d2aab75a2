/* A vendor's plugin library in plain C: the machine `w b X Y Z t` with the positioning errors EXX[1], EYY[1], EZZ[1], the
 * squarenesses EC0Y, EA0Z, EB0Z and the tool set-up dxt, dyt, dzt, exactly as the conventions of Abbe define them.
 *
 *   cc -std=c11 -shared -fPIC -I crates/abbe-plugin/include three_axis.c -o libthreeaxis.so -lm
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "abbe_json.h"
#include "abbe_plugin.h"

enum { EXX, EYY, EZZ, EC0Y, EA0Z, EB0Z, DXT, DYT, DZT, PARAMETERS };

typedef struct {
    double tool_length;
} Machine;

static void say(const AbbeReply *reply, const char *text)
{
    AbbeText all = { text, strlen(text) };
    reply->text(reply->context, all);
}

/* ---- A product of rotations about fixed axes, each with its derivative ------------------------------------------- */

typedef struct {
    double m[9];
} Matrix;

static Matrix times(Matrix a, Matrix b)
{
    Matrix c;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            c.m[3 * i + j] = a.m[3 * i] * b.m[j] + a.m[3 * i + 1] * b.m[3 + j] + a.m[3 * i + 2] * b.m[6 + j];
    return c;
}

static void apply(Matrix a, const double v[3], double out[3])
{
    for (int i = 0; i < 3; i++)
        out[i] = a.m[3 * i] * v[0] + a.m[3 * i + 1] * v[1] + a.m[3 * i + 2] * v[2];
}

/* Rotation about x, y or z; `d` = 1 gives its derivative to the angle. */
static Matrix about(int axis, double angle, int d)
{
    double c = d ? -sin(angle) : cos(angle), s = d ? cos(angle) : sin(angle), one = d ? 0.0 : 1.0;
    int i = (axis + 1) % 3, j = (axis + 2) % 3;
    Matrix r = { { 0 } };
    r.m[4 * axis] = one;
    r.m[4 * i] = c;
    r.m[4 * j] = c;
    r.m[3 * i + j] = -s;
    r.m[3 * j + i] = s;
    return r;
}

/* The tip: X carries Y carries Z. Location errors turn all that their axis carries: first EC0Y, then EB0Z after EA0Z.
 * `d` is the parameter or (PARAMETERS + axis) the command that the derivative is taken to, or -1. */
static void tip(const Machine *machine, const double q[3], const double *p, int d, double out[3])
{
    Matrix y = about(2, p[EC0Y], d == EC0Y);
    Matrix z = times(about(1, p[EB0Z], d == EB0Z), about(0, p[EA0Z], d == EA0Z));
    double tool[3] = { p[DXT], p[DYT], p[DZT] - machine->tool_length };
    double along_z[3] = { 0, 0, q[2] * (1 + p[EZZ]) }, in_z[3], in_y[3];
    if (d >= DXT && d <= DZT) {
        for (int i = 0; i < 3; i++)
            tool[i] = d == DXT + i;
    } else if (d >= 0 && d != EA0Z && d != EB0Z && d != EC0Y) {
        tool[0] = tool[1] = tool[2] = 0;
    }
    int of_z = d == EZZ || d == PARAMETERS + 2, turns_y = d == EC0Y, turns_z = d == EA0Z || d == EB0Z;
    if (d >= 0 && !turns_y && !turns_z)
        along_z[2] = d == EZZ ? q[2] : of_z ? 1 + p[EZZ] : 0;
    for (int i = 0; i < 3; i++)
        in_z[i] = along_z[i] + tool[i];
    apply(z, in_z, in_y);
    if (d < 0 || turns_y)
        in_y[1] += q[1] * (1 + p[EYY]);
    if (d == EYY || d == PARAMETERS + 1)
        in_y[1] += d == EYY ? q[1] : 1 + p[EYY];
    apply(y, in_y, out);
    if (d < 0)
        out[0] += q[0] * (1 + p[EXX]);
    if (d == EXX || d == PARAMETERS)
        out[0] += d == EXX ? q[0] : 1 + p[EXX];
}

/* ---- The machine as an object -------------------------------------------------------------------------------------- */

static uint32_t poses(void *handle, const AbbePoses *batch, const AbbeReply *reply)
{
    const Machine *machine = handle;
    if (batch->orientations) {
        say(reply, "this machine gives no orientations of its tool");
        return ABBE_FAILED;
    }
    for (uint64_t pose = 0; pose < batch->pose_count; pose++) {
        const double *q = batch->statuses + 3 * pose;
        tip(machine, q, batch->values, -1, batch->positions + 3 * pose);
        for (uint64_t k = 0; k < batch->wanted_count; k++) {
            int d = (int)batch->wanted[k].index + (batch->wanted[k].kind == 1 ? PARAMETERS : 0);
            tip(machine, q, batch->values, d, batch->position_derivatives + 3 * (pose * batch->wanted_count + k));
        }
    }
    return ABBE_OK;
}

/* A parameter of an axis. */
typedef struct {
    const char *name, *unit, *kind;
    int axis, component;
} Described;

static const Described DESCRIBED[PARAMETERS] = {
    { "EXX[1]", "mm/mm", "motion", 0, 0 }, { "EYY[1]", "mm/mm", "motion", 1, 1 }, { "EZZ[1]", "mm/mm", "motion", 2, 2 },
    { "EC0Y", "rad", "location", 1, 5 },   { "EA0Z", "rad", "location", 2, 3 },   { "EB0Z", "rad", "location", 2, 4 },
    { "dxt", "mm", NULL, 0, 0 },           { "dyt", "mm", NULL, 0, 0 },           { "dzt", "mm", NULL, 0, 0 },
};

/* The name of a member with a text, or with a whole number. */
static void member(AbbeJsonWriter *to, const char *key, const char *text)
{
    abbe_json_key(to, key);
    abbe_json_put_text(to, text);
}

static void index_of(AbbeJsonWriter *to, const char *key, int index)
{
    abbe_json_key(to, key);
    abbe_json_put_number(to, index);
}

static void describe_axis(AbbeJsonWriter *to, int axis)
{
    const char name[2] = { (char)('X' + axis), 0 };
    abbe_json_open(to, '{');
    member(to, "name", name);
    member(to, "kind", "linear");
    member(to, "branch", "tool");
    index_of(to, "sense", 1);
    index_of(to, "status", axis);
    abbe_json_key(to, "direction");
    abbe_json_open(to, '[');
    for (int i = 0; i < 3; i++)
        abbe_json_put_number(to, i == axis);
    abbe_json_close(to, ']');
    abbe_json_close(to, '}');
}

static void describe_status(AbbeJsonWriter *to, int axis)
{
    const char name[2] = { (char)('X' + axis), 0 };
    abbe_json_open(to, '{');
    member(to, "name", name);
    member(to, "quantity", "length");
    member(to, "absent", "refused");
    abbe_json_key(to, "role");
    abbe_json_open(to, '{');
    index_of(to, "command", axis);
    abbe_json_close(to, '}');
    abbe_json_close(to, '}');
}

static void describe_parameter(AbbeJsonWriter *to, const Described *it)
{
    abbe_json_open(to, '{');
    member(to, "name", it->name);
    member(to, "unit", it->unit);
    abbe_json_key(to, "role");
    if (it->kind) {
        abbe_json_open(to, '{');
        abbe_json_key(to, it->kind);
        abbe_json_open(to, '{');
        index_of(to, "axis", it->axis);
        index_of(to, "component", it->component);
        abbe_json_close(to, '}');
        abbe_json_close(to, '}');
    } else
        abbe_json_put_text(to, "set-up");
    abbe_json_close(to, '}');
}

static uint32_t describe(const Machine *machine, const AbbeReply *reply)
{
    AbbeJsonWriter to = { 0 };
    abbe_json_open(&to, '{');
    abbe_json_key(&to, "axes");
    abbe_json_open(&to, '[');
    for (int axis = 0; axis < 3; axis++)
        describe_axis(&to, axis);
    abbe_json_close(&to, ']');
    abbe_json_key(&to, "status");
    abbe_json_open(&to, '[');
    for (int axis = 0; axis < 3; axis++)
        describe_status(&to, axis);
    abbe_json_close(&to, ']');
    abbe_json_key(&to, "parameters");
    abbe_json_open(&to, '[');
    for (int parameter = 0; parameter < PARAMETERS; parameter++)
        describe_parameter(&to, &DESCRIBED[parameter]);
    abbe_json_close(&to, ']');
    index_of(&to, "stylus_radius", 0);
    abbe_json_key(&to, "settings");
    abbe_json_open(&to, '{');
    abbe_json_key(&to, "tool_length_mm");
    abbe_json_put_number(&to, machine->tool_length);
    abbe_json_close(&to, '}');
    abbe_json_close(&to, '}');
    return abbe_json_reply(&to, reply, ABBE_OK);
}

static void release(void *handle)
{
    free(handle);
}

static uint32_t call_machine(void *handle, uint32_t method, const AbbeQuestion *question, const AbbeReply *reply)
{
    (void)question;
    if (method == ABBE_DESCRIBE)
        return describe(handle, reply);
    if (method == ABBE_MOTION_ERROR) {
        say(reply, "{\"value\":0,\"derivatives\":[]}");
        return ABBE_OK;
    }
    return ABBE_UNKNOWN_METHOD;
}

/* No `retain`: nobody is lent a machine of ours for longer than a call. */
static const AbbeTable MACHINE = { sizeof(AbbeTable), NULL, release, call_machine, poses, NULL };

/* ---- The stage ------------------------------------------------------------------------------------------------------ */

static uint32_t call_stage(void *handle, uint32_t method, const AbbeQuestion *question, const AbbeReply *reply)
{
    (void)question;
    if (method == ABBE_INPUTS) {
        say(reply, "[]");
        return ABBE_OK;
    }
    if (method == ABBE_BUILD) {
        Machine *machine = malloc(sizeof *machine);
        if (!machine) {
            say(reply, "no memory");
            return ABBE_FAILED;
        }
        *machine = *(const Machine *)handle;
        AbbeObject object = { &MACHINE, machine };
        reply->object(reply->context, object);
        say(reply, "null");
        return ABBE_OK;
    }
    return ABBE_UNKNOWN_METHOD;
}

static const AbbeTable STAGE = { sizeof(AbbeTable), NULL, release, call_stage, NULL, NULL };

/* An error of settings: what is wrong with the setting `path` (that of the map as a whole if it is null); `is_key` if the
 * name of the setting is wrong. */
static uint32_t wrong(const AbbeReply *reply, const char *path, int is_key, const char *message)
{
    AbbeJsonWriter to = { 0 };
    abbe_json_open(&to, '{');
    member(&to, "message", message);
    abbe_json_key(&to, "path");
    abbe_json_open(&to, '[');
    if (path)
        abbe_json_put_text(&to, path);
    abbe_json_close(&to, ']');
    abbe_json_key(&to, "key");
    abbe_json_put(&to, is_key ? "true" : "false");
    abbe_json_close(&to, '}');
    return abbe_json_reply(&to, reply, ABBE_FAILED_WITH_DETAILS);
}

/* The one setting is a number: `{"tool_length_mm": 100}`. */
static uint32_t create(const AbbePlugin *plugin, AbbeText settings, AbbeText base, const AbbeReply *reply)
{
    (void)plugin;
    (void)base;
    AbbeJson given = abbe_json(settings);
    if (!abbe_json_is_map(given))
        return wrong(reply, NULL, 0, "a map of settings was expected");
    for (AbbeJsonItem item = abbe_json_items(given); abbe_json_next(&item);) {
        if (abbe_json_is(item.key, "tool_length_mm"))
            continue;
        char name[64], message[128];
        abbe_json_text(item.key, name, sizeof name);
        snprintf(message, sizeof message, "unknown setting `%s`", name);
        return wrong(reply, name, 1, message);
    }
    AbbeJson stated = abbe_json_member(given, "tool_length_mm");
    if (!stated.at)
        return wrong(reply, NULL, 0, "the setting `tool_length_mm` is missing");
    double length;
    if (!abbe_json_number(stated, &length) || !(length > 0) || length > 1e6)
        return wrong(reply, "tool_length_mm", 0, "a positive number up to 1e6 was expected");
    Machine *stage = malloc(sizeof *stage);
    if (!stage)
        return wrong(reply, NULL, 0, "no memory");
    stage->tool_length = length;
    AbbeObject object = { &STAGE, stage };
    reply->object(reply->context, object);
    return ABBE_OK;
}

static const AbbePlugin THREE_AXIS = {
    sizeof(AbbePlugin), ABBE_MODEL,
    ABBE_TEXT("vendor-three-axis"),
    ABBE_TEXT("three linear axes with positioning and squareness errors, in plain C"),
    ABBE_TEXT("{\"type\":\"object\",\"properties\":{\"tool_length_mm\":{\"type\":\"number\",\"exclusiveMinimum\":0}},"
              "\"required\":[\"tool_length_mm\"],\"additionalProperties\":false}"),
    ABBE_TEXT("{\"tool_length_mm\":100}"),
    create,
    ABBE_TEXT("## When to use it\n"
              "For a machine with three linear axes on the tool side, as an example of a plugin in C.\n"
              "\n## Equation\n"
              "tip = (X (1 + EXX[1]), 0, 0) + Rz(EC0Y) ((0, Y (1 + EYY[1]), 0) +\n"
              "      Ry(EB0Z) Rx(EA0Z) ((0, 0, Z (1 + EZZ[1])) + tool))\n"
              "\n## Source\nThis project.\n"),
};

static const AbbePlugin *const PLUGINS[] = { &THREE_AXIS };

static const AbbeLibrary LIBRARY = {
    ABBE_ABI_MAJOR, ABBE_ABI_MINOR, sizeof(AbbeLibrary),
    ABBE_TEXT("vendor-three-axis-c"), ABBE_TEXT("1.0.0"), PLUGINS, 1,
};

const AbbeLibrary *abbe_plugin(const AbbeHost *host)
{
    return host && host->abi_major == ABBE_ABI_MAJOR ? &LIBRARY : NULL;
}
