/* Largest step, mm or rad, that ends the iteration; tip, mm, and tool axis, rad, that need no step. */
#define ABBE_SETTLED 1e-10
#define ABBE_THERE 1e-11

static double abbe_dot(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* What tip and tool axis do when one axis moves. */
static void abbe_slope(const double *q, int axis, double step, double *tip, double *turn)
{
    double at[ABBE_AXES], ahead[2][3], behind[2][3];
    int i;
    for (i = 0; i < ABBE_AXES; i++)
        at[i] = q[i];
    at[axis] = q[axis] + step;
    abbe_machine(at, ahead[0], ahead[1]);
    at[axis] = q[axis] - step;
    abbe_machine(at, behind[0], behind[1]);
    for (i = 0; i < 3; i++) {
        tip[i] = (ahead[0][i] - behind[0][i]) / (2.0 * step);
        turn[i] = (ahead[1][i] - behind[1][i]) / (2.0 * step);
    }
}

static double abbe_volume(const double *a, const double *b, const double *c)
{
    return a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
         + a[2] * (b[0] * c[1] - b[1] * c[0]);
}

#if ABBE_ROTARY > 0
/* Total corrections of the rotary axes for what the tool axis lacks: least squares, along the directions (vectors of joint space) that
 * turn it most and least, each held at the bound by itself. */
static void abbe_rotate(const double *lacks, double turn[ABBE_ROTARY][3], const double *so_far, double *total)
{
    double direction[2][2] = {{1.0, 0.0}, {0.0, 1.0}}, largest = 0.0;
    int i, k;
#if ABBE_ROTARY == 2
    const double angle = 0.5 * atan2(2.0 * abbe_dot(turn[0], turn[1]),
                                     abbe_dot(turn[0], turn[0]) - abbe_dot(turn[1], turn[1]));
    direction[0][0] = direction[1][1] = cos(angle);
    direction[0][1] = sin(angle);
    direction[1][0] = -sin(angle);
#endif
    for (i = 0; i < ABBE_ROTARY; i++)
        total[i] = 0.0;
    for (k = 0; k < ABBE_ROTARY; k++) {
        double image[3] = {0.0, 0.0, 0.0}, wanted = 0.0, least = -1e300, most = 1e300, size;
        for (i = 0; i < ABBE_ROTARY; i++) {
            int j;
            for (j = 0; j < 3; j++)
                image[j] += turn[i][j] * direction[k][i];
            wanted += direction[k][i] * so_far[i];
            if (fabs(direction[k][i]) > 2.3e-16) {
                const double a = (-ABBE_BOUND - total[i]) / direction[k][i];
                const double b = (ABBE_BOUND - total[i]) / direction[k][i];
                least = fmax(least, fmin(a, b));
                most = fmin(most, fmax(a, b));
            }
        }
        size = sqrt(abbe_dot(image, image));
        if (k == 0)
            largest = size;
        if (largest > 0.0 && size > 1e-6 * fmax(largest, 1e-6))
            wanted -= abbe_dot(image, lacks) / (size * size);
        wanted = fmax(fmin(wanted, fmax(most, least)), least);
        for (i = 0; i < ABBE_ROTARY; i++)
            total[i] += wanted * direction[k][i];
    }
}
#endif

/* Commands with which tip (and tool axis) of the machine are where they are without errors at `program`. */
static int abbe_solve(const double *program, double *q)
{
    double goal[3], goal_axis[3], shift[3][3], unused[3], moved_last = 1.0;
#if ABBE_ROTARY > 0
    double turn[ABBE_ROTARY][3], swing[ABBE_ROTARY][3], best_at[ABBE_ROTARY] = {0.0}, best = 1e300;
    int standing = 0;
#endif
    int i, j, pass;
    abbe_nominal(program, goal, goal_axis);
    for (i = 0; i < ABBE_AXES; i++)
        q[i] = program[i];
    for (pass = 0; pass < 40; pass++) {
        double tip[3], axis[3], lacks[3], lacks_axis[3], step[3], largest = 0.0, volume, angle = 0.0;
        abbe_machine(q, tip, axis);
        for (i = 0; i < 3; i++) {
            lacks[i] = tip[i] - goal[i];
            lacks_axis[i] = axis[i] - goal_axis[i];
        }
        /* Slopes are computed again where rotary axes moved far. */
        if (moved_last > 1e-4) {
            for (i = 0; i < 3; i++)
                abbe_slope(q, abbe_linear[i], 1e-2, shift[i], unused);
#if ABBE_ROTARY > 0
            for (i = 0; i < ABBE_ROTARY; i++)
                abbe_slope(q, abbe_rotary[i], 1e-4, swing[i], turn[i]);
#endif
        }
        moved_last = 0.0;
        (void)lacks_axis;
        for (j = 0; j < 3; j++)
            step[j] = -lacks[j];
#if ABBE_ROTARY > 0
        angle = sqrt(abbe_dot(lacks_axis, lacks_axis));
        if (!standing) {
            double so_far[ABBE_ROTARY], total[ABBE_ROTARY];
            for (i = 0; i < ABBE_ROTARY; i++)
                so_far[i] = total[i] = q[abbe_rotary[i]] - program[abbe_rotary[i]];
            if (angle > 0.5 * best) {
                standing = 1;
                if (angle >= best)
                    for (i = 0; i < ABBE_ROTARY; i++)
                        total[i] = best_at[i];
            } else {
                best = angle;
                for (i = 0; i < ABBE_ROTARY; i++)
                    best_at[i] = so_far[i];
                abbe_rotate(lacks_axis, turn, so_far, total);
            }
            for (i = 0; i < ABBE_ROTARY; i++) {
                const double by = total[i] - so_far[i];
                q[abbe_rotary[i]] = program[abbe_rotary[i]] + total[i];
                for (j = 0; j < 3; j++)
                    step[j] -= swing[i][j] * by;
                moved_last = fmax(moved_last, fabs(by));
            }
            largest = moved_last;
        }
        if (standing)
            angle = 0.0;
#endif
        volume = abbe_volume(shift[0], shift[1], shift[2]);
        {
            const double by[3] = {abbe_volume(step, shift[1], shift[2]) / volume,
                                  abbe_volume(shift[0], step, shift[2]) / volume,
                                  abbe_volume(shift[0], shift[1], step) / volume};
            for (i = 0; i < 3; i++) {
                /* Axes in one plane, or a command that is no number. */
                if (!(fabs(by[i]) < 1e300))
                    return -1;
                q[abbe_linear[i]] += by[i];
                largest = fmax(largest, fabs(by[i]));
            }
        }
        if (largest < ABBE_SETTLED || (sqrt(abbe_dot(lacks, lacks)) < ABBE_THERE && angle < ABBE_THERE))
            return 0;
    }
    return -1;
}

/* Joints of commands. */
static int abbe_joints(const double *command, double *joint)
{
    double program[ABBE_AXES] = {0.0}, q[ABBE_AXES];
    int i;
    for (i = 0; i < ABBE_JOINTS; i++)
        program[abbe_axis[i]] = command[i] / abbe_unit[i];
    if (abbe_solve(program, q) != 0)
        return -1;
    for (i = 0; i < ABBE_JOINTS; i++)
        joint[i] = command[i] + (q[abbe_axis[i]] - program[abbe_axis[i]]) * abbe_unit[i];
    return 0;
}
