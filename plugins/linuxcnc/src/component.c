component @NAME@ "Kinematics with the errors of a calibration";
pin out s32 dummy = 0 "Not used; a component needs a pin.";
option period no;
license "GPL";
;;
/* @TITLE@
 * Trivial kinematics (joints in the order @LETTERS@, mm and degrees) with corrections: joints get the commands with which the tool of
 * the machine is where that of a machine without errors would be. Reversal is not in here: see COMP_FILE in @NAME@.ini. */
#include "rtapi_math.h"
#include "kinematics.h"

#define ABBE_JOINTS @JOINTS@

@CODE@

int kinematicsInverse(const EmcPose *world, double *joint, const KINEMATICS_INVERSE_FLAGS *iflags,
                      KINEMATICS_FORWARD_FLAGS *fflags)
{
    const double command[ABBE_JOINTS] = {@READ@};
    (void)iflags;
    (void)fflags;
    return abbe_joints(command, joint);
}

/* The inverse of the inverse: corrections change little over their own size, so a few passes find it. */
int kinematicsForward(const double *joint, EmcPose *world, const KINEMATICS_FORWARD_FLAGS *fflags,
                      KINEMATICS_INVERSE_FLAGS *iflags)
{
    double command[ABBE_JOINTS], found[ABBE_JOINTS];
    int i, pass;
    (void)fflags;
    (void)iflags;
    for (i = 0; i < ABBE_JOINTS; i++)
        command[i] = joint[i];
    for (pass = 0; pass < 40; pass++) {
        double most = 0.0;
        if (abbe_joints(command, found) != 0)
            return -1;
        for (i = 0; i < ABBE_JOINTS; i++) {
            if (!(fabs(joint[i] - found[i]) < 1e300))
                return -1;
            command[i] += joint[i] - found[i];
            most = fmax(most, fabs(joint[i] - found[i]));
        }
        if (most < 1e-10) {
            @WRITE@
            return 0;
        }
    }
    return -1;
}

KINEMATICS_TYPE kinematicsType(void)
{
    return KINEMATICS_BOTH;
}

KINS_NOT_SWITCHABLE
EXPORT_SYMBOL(kinematicsType);
EXPORT_SYMBOL(kinematicsForward);
EXPORT_SYMBOL(kinematicsInverse);
