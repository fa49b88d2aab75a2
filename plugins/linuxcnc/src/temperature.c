component @NAME@ "Offsets of axes that follow temperatures";
pin in bit enable = 1 "Without it offsets go back to zero.";
@PINS@
pin out bit beyond = 0 "A reading is beyond those of the calibration, or no number: offsets stay at its end.";
param r float scale = @SCALE@ "mm for one count: axis.L.eoffset-scale";
param rw float max_rate = @RATE@ "Fastest change of an offset, mm/s";
variable int begun = 0;
variable double lagged[@STATES@];
variable double last[@AXES@];
option singleton yes;
function _;
license "GPL";
;;
/* @TITLE@
 * Each state lags behind a reading with its time constant, s (0: at once), and begins with the first reading: the machine had rested.
 * The offset of an axis is the sum over states of (offset + slope (position - reference)) (state - what it counts from). */
#include "rtapi_math.h"

static const double abbe_time_constant[@STATES@] = {@TIMES@};
static const double abbe_from[@STATES@] = {@FROM@};
static const double abbe_least[@STATES@] = {@LEAST@};
static const double abbe_most[@STATES@] = {@MOST@};
static const double abbe_reference[@AXES@] = {@REFERENCES@};
static const double abbe_gain[@AXES@][@STATES@][2] = {
@GAINS@
};

FUNCTION(_)
{
    const double reading[@STATES@] = {@READINGS@};
    const double position[@AXES@] = {@POSITIONS@};
    int i, k, out = 0;
    for (k = 0; k < @STATES@; k++) {
        double now = reading[k];
        if (!(now >= abbe_least[k] && now <= abbe_most[k])) {
            out = 1;
            if (now > abbe_most[k])
                now = abbe_most[k];
            else if (now < abbe_least[k])
                now = abbe_least[k];
            else
                now = begun ? lagged[k] : abbe_from[k];
        }
        if (!begun || abbe_time_constant[k] <= 0.0)
            lagged[k] = now;
        else
            lagged[k] -= (now - lagged[k]) * expm1(-fperiod / abbe_time_constant[k]);
    }
    beyond = out;
    for (i = 0; i < @AXES@; i++) {
        double wanted = 0.0, step = max_rate * fperiod;
        for (k = 0; k < @STATES@ && enable; k++)
            wanted += (abbe_gain[i][k][0] + abbe_gain[i][k][1] * (position[i] - abbe_reference[i])) * (lagged[k] - abbe_from[k]);
        if (!(fabs(wanted) < 1e300))
            wanted = last[i];
        if (wanted > last[i] + step)
            wanted = last[i] + step;
        if (wanted < last[i] - step)
            wanted = last[i] - step;
        last[i] = wanted;
    }
    begun = 1;
    @WRITE@
}
