/* A vendor's plugin library in plain C: the machine `w b X Y Z t` with the positioning errors EXX[1], EYY[1], EZZ[1], the
 * squarenesses EC0Y, EA0Z, EB0Z and the tool set-up dxt, dyt, dzt, exactly as the conventions of Abbe define them.
 *
 *   cc -std=c11 -shared -fPIC -I crates/abbe-plugin/include three_axis.c -o libthreeaxis.so -lm
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

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

#define AXIS(name, index, x, y, z) \
    "{\"name\":\"" name "\",\"kind\":\"linear\",\"branch\":\"tool\",\"sense\":1,\"direction\":[" x "," y "," z "],\"status\":" index "}"
#define STATUS(name, axis) "{\"name\":\"" name "\",\"role\":{\"command\":" axis "},\"quantity\":\"length\",\"absent\":\"refused\"}"
#define PARAMETER(name, unit, role) "{\"name\":\"" name "\",\"unit\":\"" unit "\",\"role\":" role "}"
#define OF_AXIS(kind, axis, component) "{\"" kind "\":{\"axis\":" axis ",\"component\":" component "}}"
#define SET_UP "\"set-up\""

static uint32_t describe(const Machine *machine, const AbbeReply *reply)
{
    char text[2048];
    snprintf(text, sizeof text,
             "{\"axes\":[" AXIS("X", "0", "1", "0", "0") "," AXIS("Y", "1", "0", "1", "0") "," AXIS("Z", "2", "0", "0", "1")
             "],\"status\":[" STATUS("X", "0") "," STATUS("Y", "1") "," STATUS("Z", "2") "],\"parameters\":["
             PARAMETER("EXX[1]", "mm/mm", OF_AXIS("motion", "0", "0")) ","
             PARAMETER("EYY[1]", "mm/mm", OF_AXIS("motion", "1", "1")) ","
             PARAMETER("EZZ[1]", "mm/mm", OF_AXIS("motion", "2", "2")) ","
             PARAMETER("EC0Y", "rad", OF_AXIS("location", "1", "5")) ","
             PARAMETER("EA0Z", "rad", OF_AXIS("location", "2", "3")) ","
             PARAMETER("EB0Z", "rad", OF_AXIS("location", "2", "4")) ","
             PARAMETER("dxt", "mm", SET_UP) "," PARAMETER("dyt", "mm", SET_UP) "," PARAMETER("dzt", "mm", SET_UP)
             "],\"stylus_radius\":0,\"settings\":{\"tool_length_mm\":%.17g}}", machine->tool_length);
    say(reply, text);
    return ABBE_OK;
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

static uint32_t wrong(const AbbeReply *reply, const char *path, int key, const char *message)
{
    char text[512];
    snprintf(text, sizeof text, "{\"path\":[%s],\"key\":%s,\"message\":\"%s\"}", path, key ? "true" : "false", message);
    say(reply, text);
    return ABBE_FAILED_WITH_DETAILS;
}

/* The one setting is a number: `{"tool_length_mm": 100}`. Abbe writes JSON without blanks between the parts. */
static uint32_t create(const AbbePlugin *plugin, AbbeText settings, AbbeText base, const AbbeReply *reply)
{
    (void)plugin;
    (void)base;
    static const char KEY[] = "{\"tool_length_mm\":";
    char text[128], *end;
    if (settings.length == 2 && memcmp(settings.data, "{}", 2) == 0)
        return wrong(reply, "", 0, "the setting `tool_length_mm` is missing");
    if (settings.length >= sizeof text || settings.length < sizeof KEY) {
        if (settings.length < 2 || settings.data[0] != '{')
            return wrong(reply, "", 0, "a map of settings was expected");
        return wrong(reply, "", 0, "one setting was expected: `tool_length_mm`, a number");
    }
    memcpy(text, settings.data, settings.length);
    text[settings.length] = 0;
    if (strncmp(text, KEY, sizeof KEY - 1) != 0)
        return wrong(reply, "", 0, "the setting `tool_length_mm` was expected first");
    double length = strtod(text + sizeof KEY - 1, &end);
    if (end == text + sizeof KEY - 1 || !(length > 0) || length > 1e6)
        return wrong(reply, "\"tool_length_mm\"", 0, "a positive number was expected");
    if (strncmp(end, ",\"", 2) == 0) {
        char key[64], message[128];
        size_t count = strcspn(end + 2, "\"\\");
        snprintf(key, sizeof key, "\"%.*s\"", (int)(count < 40 ? count : 40), end + 2);
        snprintf(message, sizeof message, "unknown setting `%.*s`", (int)(count < 40 ? count : 40), end + 2);
        return wrong(reply, key, 1, message);
    }
    if (strcmp(end, "}") != 0)
        return wrong(reply, "", 0, "one setting was expected: `tool_length_mm`, a number");
    Machine *stage = malloc(sizeof *stage);
    if (!stage)
        return wrong(reply, "", 0, "no memory");
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
