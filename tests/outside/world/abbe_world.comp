component abbe_world "A machine with hidden errors, what stands on its table, and the touch probe in its spindle";
description """What a control in simulation touches. From where the joints really are it computes the tip of the stylus as it really is,
seen from the table, and the gap to the surfaces there, and closes the probe a delay after the contact. Errors, surfaces and delay stand
in `abbe_world.h` beside this file. The errors are those of ISO 230-1; no code is shared with Abbe.""";
pin in float joint-#[6] "Where the motors are, mm and degrees";
pin out bit trigger "The probe, for motion.probe-input";
pin out float gap = 1000 "From the stylus to the nearest surface, mm";
pin out float deepest = 0 "How far the stylus was behind a surface at most, mm";
pin out s32 contacts = 0 "Contacts so far";
pin out float tip-#[3] "The tip seen from the table, mm";
option singleton yes;
include "abbe_world.h";
function _;
license "GPL";
author "Abbe";
;;
#include "rtapi_math.h"

/* abbe_world.h gives
 *   JOINTS, and for each joint: struct joint JOINT[]
 *   TOOL_SIDE, WORK_SIDE: joints from the bed to the tool and to the workpiece, -1 ends
 *   TOOL[3]: the tip in the frame of the last axis of the tool side, mm
 *   FEATURES, FEATURE[]: plane faces and balls; STYLUS: radius, mm
 *   NOISE: standard deviation of the place of a contact, mm; DELAY: s; SEED */

/* A motion of a rigid body: x -> r x + t. */
struct motion {
    double r[3][3], t[3];
};

static struct motion after(struct motion a, struct motion b)
{
    struct motion c;
    int i, j, k;
    for (i = 0; i < 3; i++) {
        c.t[i] = a.t[i];
        for (j = 0; j < 3; j++) {
            c.t[i] += a.r[i][j] * b.t[j];
            c.r[i][j] = 0.0;
            for (k = 0; k < 3; k++)
                c.r[i][j] += a.r[i][k] * b.r[k][j];
        }
    }
    return c;
}

static struct motion shift(const double by[3], double factor)
{
    struct motion m = {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, {by[0] * factor, by[1] * factor, by[2] * factor}};
    return m;
}

/* A rotation about a coordinate axis: 0 x, 1 y, 2 z. */
static struct motion turn(int about, double angle)
{
    struct motion m = {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, {0, 0, 0}};
    const int i = (about + 1) % 3, j = (about + 2) % 3;
    m.r[i][i] = m.r[j][j] = cos(angle);
    m.r[j][i] = sin(angle);
    m.r[i][j] = -sin(angle);
    return m;
}

/* Deviations of a frame along and about its directions. */
static struct motion deviation(const double e[6])
{
    return after(after(after(shift(e, 1.0), turn(2, e[5])), turn(1, e[4])), turn(0, e[3]));
}

/* The last frame of a side, seen from the bed. */
static struct motion frame(const int *side, const double *position, double sense)
{
    static const double ORIGIN[3] = {0, 0, 0};
    const double *from = ORIGIN;
    struct motion m = shift(ORIGIN, 1.0);
    for (; *side >= 0; side++) {
        const struct joint *own = &JOINT[*side];
        double along[3], by[6];
        int i;
        for (i = 0; i < 3; i++)
            along[i] = own->is_rotary ? own->point[i] - from[i] : 0.0;
        if (own->is_rotary)
            from = own->point;
        for (i = 0; i < 6; i++)
            by[i] = own->motion[i] * position[*side];
        m = after(after(m, shift(along, 1.0)), deviation(own->location));
        for (i = 0; i < 3; i++)
            along[i] = i == own->direction ? 1.0 : 0.0;
        m = after(m, own->is_rotary ? turn(own->direction, sense * position[*side])
                                    : shift(along, sense * position[*side]));
        m = after(m, deviation(by));
    }
    return m;
}

/* From the tip to a surface, mm: less than nothing behind it. Far beside a face and far behind it there is nothing. */
static double distance(const struct feature *own, const double tip[3])
{
    double by[3], along = 0.0, square = 0.0;
    int i;
    for (i = 0; i < 3; i++) {
        by[i] = tip[i] - own->at[i];
        square += by[i] * by[i];
        along += by[i] * own->normal[i];
    }
    if (own->radius > 0.0)
        return sqrt(square) - own->radius - STYLUS;
    if (square - along * along > own->reach * own->reach || along < -own->reach)
        return 1000.0;
    return along - STYLUS;
}

static unsigned long long state = SEED;

static double uniform(void)
{
    unsigned long long x = (state += 0x9E3779B97F4A7C15ULL);
    x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9ULL;
    x = (x ^ (x >> 27)) * 0x94D049BB133111EBULL;
    return ((x ^ (x >> 31)) >> 11) * (1.0 / 9007199254740992.0);
}

/* A number of the normal distribution, near enough: the sum of twelve uniform ones. */
static double normal(void)
{
    double sum = -6.0;
    int i;
    for (i = 0; i < 12; i++)
        sum += uniform();
    return sum;
}

/* The stylus is free again behind so much, mm: then the next contact may come. */
#define FREE 0.02

static int deaf[FEATURES], feature = -1, is_ready = 0;
static double noise, before = 1000.0, since;

FUNCTION(_)
{
    double position[JOINTS], tip[3], nearest = 1000.0, gap_now;
    struct motion tool, work;
    int i, j, which = -1;

    if (!is_ready) {
        for (i = 0; i < FEATURES; i++)
            deaf[i] = FEATURE[i].deaf;
        noise = NOISE * normal();
        is_ready = 1;
    }
    for (i = 0; i < JOINTS; i++)
        position[i] = (joint(i) + JOINT[i].home) * (JOINT[i].is_rotary ? 0.017453292519943295 : 1.0);
    tool = after(frame(TOOL_SIDE, position, 1.0), shift(TOOL, 1.0));
    work = frame(WORK_SIDE, position, -1.0);
    for (i = 0; i < 3; i++) {
        tip[i] = 0.0;
        for (j = 0; j < 3; j++)
            tip[i] += work.r[j][i] * (tool.t[j] - work.t[j]);
        tip(i) = tip[i];
    }
    for (i = 0; i < FEATURES; i++) {
        const double own = distance(&FEATURE[i], tip);
        if (own < nearest) {
            nearest = own;
            which = i;
        }
    }
    gap = nearest;
    gap_now = nearest + noise;
    if (feature < 0 && gap_now <= 0.0) {
        /* When in the cycle: the gap closes evenly. */
        feature = which;
        since = before > gap_now ? -gap_now / (before - gap_now) * fperiod : 0.0;
        contacts++;
    } else if (feature >= 0 && nearest > FREE) {
        if (deaf[feature] > 0)
            deaf[feature]--;
        feature = -1;
        noise = NOISE * normal();
    } else if (feature >= 0) {
        since += fperiod;
    }
    if (feature >= 0 && deaf[feature] == 0 && -nearest > deepest)
        deepest = -nearest;
    trigger = feature >= 0 && deaf[feature] == 0 && since >= DELAY;
    before = gap_now;
}
