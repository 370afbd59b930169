component touch_cylinder """The true machine of the rig: a ball stylus against a cylinder on a
tilting rotary table. Contact is computed in the servo thread from the joint positions, through the
axes as they truly stand; whoever measures knows nothing of these pins.""";

pin in float x "joint X, mm";
pin in float y "joint Y, mm";
pin in float z "joint Z, mm";
pin in float b "joint B, degrees";
pin in float c "joint C, degrees";
pin in bit stuck "the probe reads closed whatever it touches";
pin in bit dead "the probe reads open whatever it touches";
pin out bit contact "to motion.probe-input";
pin out float gap "distance from the ball to the cylinder, mm";
pin out u32 touches "number of contacts so far";

pin io float radius = 45.0 "of the cylinder, mm";
pin io float ball = 3.0 "radius of the ball, mm";
pin io float top = 100.0 "of the cylinder, over the table, mm";
pin io float foot = 0.0;
pin io float ecc_x = 0.0 "the cylinder's axis from the true C axis at C = 0, mm";
pin io float ecc_y = 0.0;
pin io float b_x = 0.0 "where the true B axis stands, mm";
pin io float b_z = 0.0;
pin io float c_x = 0.0 "where the true C axis stands at B = 0, mm";
pin io float c_y = 0.0;
pin io float stylus_x = 0.0 "the ball's centre from the spindle's axis, mm";
pin io float stylus_y = 0.0;
pin io float noise = 0.0 "standard deviation of one touch, mm";
pin io u32 seed = 1;

variable int ready;
variable double scatter;
variable rtapi_u64 state;

function _ fp;
license "Apache-2.0 OR MIT";
author "The trued contributors";
option extra_setup yes;
;;

#include <rtapi_math.h>

EXTRA_SETUP() { ready = 0; return 0; }

/* Marsaglia's xorshift64; the same seed gives the same machine. */
static double uniform(rtapi_u64 *s) {
    *s ^= *s << 13; *s ^= *s >> 7; *s ^= *s << 17;
    return (double)(*s >> 11) / 9007199254740992.0;
}

/* Sum of twelve: standard deviation 1. */
static double normal(rtapi_u64 *s) {
    double sum = -6.0;
    for (int i = 0; i < 12; i++) sum += uniform(s);
    return sum;
}

FUNCTION(_) {
    double tilt = b * M_PI / 180.0, turn = c * M_PI / 180.0;
    double u, v, px, py, pz, radial, axial, d;

    if (!ready) {
        state = 88172645463325252ULL ^ ((rtapi_u64)seed << 32);
        scatter = 0.0;
        ready = 1;
    }
    /* The ball's centre, carried back from the machine to the table at B = 0, then C = 0. A table
       turns by +B and +C here: the opposite of ISO 841, as in LinuxCNC's own five-axis samples. */
    u = x + stylus_x - b_x;
    v = z - b_z;
    px = cos(tilt) * u - sin(tilt) * v + b_x - c_x;
    pz = sin(tilt) * u + cos(tilt) * v + b_z;
    py = y + stylus_y - c_y;
    u = cos(turn) * px + sin(turn) * py - ecc_x;
    v = cos(turn) * py - sin(turn) * px - ecc_y;

    radial = sqrt(u * u + v * v) - radius;
    axial = pz > 0.5 * (top + foot) ? pz - top : foot - pz;
    if (radial > 0.0 && axial > 0.0) d = sqrt(radial * radial + axial * axial);
    else d = radial > axial ? radial : axial;
    d -= ball;

    /* One deviation a touch, drawn when the stylus comes free. */
    if (gap <= 0.0 && d > 0.0) scatter = noise * normal(&state);
    gap = d;
    if (stuck) contact = 1;
    else if (dead) contact = 0;
    else {
        if (d <= scatter && !contact) touches++;
        contact = d <= scatter;
    }
}
