/* Joints of commands: linear interpolation along each joint; beyond the grid the correction of its end. */
static int abbe_joints(const double *command, double *joint)
{
    int cell[ABBE_JOINTS], i, corner;
    double part[ABBE_JOINTS];
    for (i = 0; i < ABBE_JOINTS; i++) {
        const double *place = abbe_place[i];
        const int last = abbe_count[i] - 2;
        int at = 0;
        while (at < last && place[at + 1] <= command[i])
            at++;
        cell[i] = at;
        part[i] = fmin(fmax((command[i] - place[at]) / (place[at + 1] - place[at]), 0.0), 1.0);
        joint[i] = command[i];
    }
    for (corner = 0; corner < 1 << ABBE_JOINTS; corner++) {
        long node = 0;
        double weight = 1.0;
        for (i = 0; i < ABBE_JOINTS; i++) {
            const int above = corner >> i & 1;
            node = node * abbe_count[i] + cell[i] + above;
            weight *= above ? part[i] : 1.0 - part[i];
        }
        if (weight != 0.0)
            for (i = 0; i < ABBE_JOINTS; i++)
                joint[i] += weight * abbe_table[node][i];
    }
    return 0;
}
