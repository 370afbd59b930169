component touch_artefact """The true machine of the rig: a ball stylus against a cylinder, or balls, on
a tilting rotary table; or a laser's beam against the first ball. Contact is computed in the servo thread from the joint positions, through the
axes as they truly stand; whoever measures knows nothing of these pins. All that is placed by `where
it stands' is in machine coordinates, mm, with all axes at zero.""";

pin in float x "joint X, mm";
pin in float y "joint Y, mm";
pin in float z "joint Z, mm";
pin in float b "joint B, degrees";
pin in float c "joint C, degrees";
pin in bit stuck "the probe reads closed whatever it touches";
pin in bit dead "the probe reads open whatever it touches";
pin out bit contact "to motion.probe-input";
pin out float gap "distance from the stylus ball to the artefact, mm";
pin out u32 touches "number of contacts so far";

pin io float radius = 45.0 "of the cylinder, mm; 0: there is none";
pin io float top = 100.0 "of the cylinder, over the table, mm";
pin io float foot = 0.0;
pin io float ecc_x = 0.0 "the cylinder's axis from the true C axis at C = 0, mm";
pin io float ecc_y = 0.0;

pin io float ball_radius_#[4] = 0.0 "of a ball, mm; 0: there is none";
pin io float ball_x_#[4] = 0.0 "where its centre stands";
pin io float ball_y_#[4] = 0.0;
pin io float ball_z_#[4] = 0.0;

pin io bit tilt_about_x = 0 "the table tilts about X, not about Y: then joint B is an axis A";
pin io float scale_x = 0.0 "X moves too far by this ratio";
pin io float b_x = 0.0 "where the true tilting axis stands across it (X of B, Y of A)";
pin io float b_z = 0.0;
pin io float b_a = 0.0 "its direction is Y's, turned by this about X, rad; X's about Y";
pin io float b_c = 0.0 "and then by this about Z, rad";
pin io float c_x = 0.0 "where the true C axis stands at Z = 0";
pin io float c_y = 0.0;
pin io float c_a = 0.0 "its direction is Z's, turned by this about X, rad";
pin io float c_b = 0.0 "and then by this about Y, rad";

pin io float ball = 3.0 "radius of the stylus ball, mm";
pin io float stylus_x = 0.0 "its centre from the spindle's datum, mm";
pin io float stylus_y = 0.0;
pin io float stylus_z = 0.0;
pin io float noise = 0.0 "standard deviation of one touch, mm";
pin io u32 seed = 1;

pin io float laser_x = 0.0 "zero point of a laser from the spindle's datum, mm";
pin io float laser_y = 0.0;
pin io float laser_z = 0.0;
pin io float laser_a = 0.0 "its beam is -Z, turned by this about X, rad";
pin io float laser_b = 0.0 "and then by this about Y, rad";
pin out bit sees "its beam meets ball 0";
pin out float distance "from its zero point along the beam to ball 0, mm";

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

/* Turn p about the line through `through` along the unit vector `along`, right-handed (Rodrigues). */
static void turn_about(double p[3], const double through[3], const double along[3], double angle) {
    double r[3], cross[3], dot = 0.0;
    for (int i = 0; i < 3; i++) r[i] = p[i] - through[i];
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        dot += along[i] * r[i];
        cross[i] = along[j] * r[k] - along[k] * r[j];
    }
    for (int i = 0; i < 3; i++)
        p[i] = through[i] + cos(angle) * r[i] + sin(angle) * cross[i]
            + (1.0 - cos(angle)) * dot * along[i];
}

/* From the surface of an upright cylinder; u, v from its axis, w over the table. */
static double to_cylinder(double u, double v, double w, double wide, double low, double high) {
    double radial = sqrt(u * u + v * v) - wide;
    double axial = w > 0.5 * (high + low) ? w - high : low - w;
    if (radial > 0.0 && axial > 0.0) return sqrt(radial * radial + axial * axial);
    return radial > axial ? radial : axial;
}

/* Along the line from p to q, which are 1 apart, to the sphere of this radius about its centre; 0: past it. */
static int along_beam(const double p[3], const double q[3], const double centre[3], double wide, double *far) {
    double along = 0.0, square = 0.0;
    for (int i = 0; i < 3; i++) {
        along += (q[i] - p[i]) * (centre[i] - p[i]);
        square += (centre[i] - p[i]) * (centre[i] - p[i]);
    }
    double half = wide * wide - (square - along * along);
    if (half <= 0.0) return 0;
    *far = along - sqrt(half);
    return 1;
}

FUNCTION(_) {
    double true_x = x * (1.0 + scale_x);
    double p[3] = { true_x + stylus_x, y + stylus_y, z + stylus_z }, d = 1e9;
    double at_b[3] = { b_x, 0.0, b_z }, at_c[3] = { c_x, c_y, 0.0 };
    double along_b[3] = { -sin(b_c) * cos(b_a), cos(b_c) * cos(b_a), sin(b_a) };
    if (tilt_about_x) {
        at_b[0] = 0.0; at_b[1] = b_x;
        along_b[0] = cos(b_c) * cos(b_a); along_b[1] = sin(b_c) * cos(b_a); along_b[2] = -sin(b_a);
    }
    double along_c[3] = { sin(c_b) * cos(c_a), -sin(c_a), cos(c_b) * cos(c_a) };

    if (!ready) {
        state = 88172645463325252ULL ^ ((rtapi_u64)seed << 32);
        scatter = 0.0;
        ready = 1;
    }
    /* The stylus, carried back from the machine to the table at B = 0, then C = 0. A table turns by
       +B and +C here: the opposite of ISO 841, as in LinuxCNC's own five-axis samples. */
    turn_about(p, at_b, along_b, -b * M_PI / 180.0);
    turn_about(p, at_c, along_c, -c * M_PI / 180.0);

    if (radius > 0.0) d = to_cylinder(p[0] - c_x - ecc_x, p[1] - c_y - ecc_y, p[2], radius, foot, top);
    for (int i = 0; i < 4; i++) {
        double u = p[0] - ball_x(i), v = p[1] - ball_y(i), w = p[2] - ball_z(i);
        double far = sqrt(u * u + v * v + w * w) - ball_radius(i);
        if (ball_radius(i) > 0.0 && far < d) d = far;
    }
    d -= ball;

    /* The beam, carried back as the stylus is. */
    double from[3] = { true_x + laser_x, y + laser_y, z + laser_z }, far = 0.0;
    double to[3] = { from[0] - cos(laser_a) * sin(laser_b), from[1] + sin(laser_a),
        from[2] - cos(laser_a) * cos(laser_b) };
    double at_ball[3] = { ball_x(0), ball_y(0), ball_z(0) };
    turn_about(from, at_b, along_b, -b * M_PI / 180.0);
    turn_about(from, at_c, along_c, -c * M_PI / 180.0);
    turn_about(to, at_b, along_b, -b * M_PI / 180.0);
    turn_about(to, at_c, along_c, -c * M_PI / 180.0);
    sees = ball_radius(0) > 0.0 && along_beam(from, to, at_ball, ball_radius(0), &far);
    distance = far;

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
