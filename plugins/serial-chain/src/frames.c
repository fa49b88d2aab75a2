/* A frame: the directions of its axes (columns of r) and its origin o, in the frame of the bed, mm. */
typedef struct {
    double r[3][3];
    double o[3];
} abbe_frame;

#define ABBE_BED {{{1.0, 0.0, 0.0}, {0.0, 1.0, 0.0}, {0.0, 0.0, 1.0}}, {0.0, 0.0, 0.0}}

static void abbe_shift(abbe_frame *f, double x, double y, double z)
{
    int i;
    for (i = 0; i < 3; i++)
        f->o[i] += f->r[i][0] * x + f->r[i][1] * y + f->r[i][2] * z;
}

static void abbe_move(abbe_frame *f, double ux, double uy, double uz, double by)
{
    abbe_shift(f, ux * by, uy * by, uz * by);
}

/* Turns about the unit vector u of the frame (Rodrigues). */
static void abbe_turn(abbe_frame *f, double ux, double uy, double uz, double angle)
{
    double s = sin(angle), c = cos(angle), d = 1.0 - c;
    double m[3][3] = {
        {c + ux * ux * d, ux * uy * d - uz * s, ux * uz * d + uy * s},
        {uy * ux * d + uz * s, c + uy * uy * d, uy * uz * d - ux * s},
        {uz * ux * d - uy * s, uz * uy * d + ux * s, c + uz * uz * d}};
    int i, j;
    for (i = 0; i < 3; i++) {
        double row[3] = {f->r[i][0], f->r[i][1], f->r[i][2]};
        for (j = 0; j < 3; j++)
            f->r[i][j] = row[0] * m[0][j] + row[1] * m[1][j] + row[2] * m[2][j];
    }
}

/* Six errors: a shift, then Rz(c) Ry(b) Rx(a). */
static void abbe_errors(abbe_frame *f, double x, double y, double z, double a, double b, double c)
{
    abbe_shift(f, x, y, z);
    if (c != 0.0)
        abbe_turn(f, 0.0, 0.0, 1.0, c);
    if (b != 0.0)
        abbe_turn(f, 0.0, 1.0, 0.0, b);
    if (a != 0.0)
        abbe_turn(f, 1.0, 0.0, 0.0, a);
}

/* Origin and third direction of the tool, seen from the workpiece. */
static void abbe_seen(const abbe_frame *workpiece, const abbe_frame *tool, double *tip, double *axis)
{
    int i, j;
    for (i = 0; i < 3; i++) {
        tip[i] = axis[i] = 0.0;
        for (j = 0; j < 3; j++) {
            tip[i] += workpiece->r[j][i] * (tool->o[j] - workpiece->o[j]);
            axis[i] += workpiece->r[j][i] * tool->r[j][2];
        }
    }
}
