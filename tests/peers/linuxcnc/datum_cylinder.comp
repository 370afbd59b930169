component datum_cylinder """The true datum cylinder of the rig, on the table C, and three displacement sensors on
the bed that look at it from the side. A table turns by +C here, seen from above counter-clockwise. What a
sensor reports is the way along its ray, from its zero point on the nominal surface to the true one.""";

pin in float c "joint C, degrees";
pin io float radius = 30.0 "mm";
pin io float ecc_x = 0.0 "of the cylinder from the true axis at C = 0, mm";
pin io float ecc_y = 0.0;
pin io float motion_xc_#[9] = 0.0 "error motion of C along X over its angle: cosine of this order, mm";
pin io float motion_xs_#[9] = 0.0 "and its sine";
pin io float motion_yc_#[9] = 0.0;
pin io float motion_ys_#[9] = 0.0;
pin io float form_c_#[9] = 0.0 "form of the cylinder over the angle about its own axis, mm";
pin io float form_s_#[9] = 0.0;
pin io float angle_#[3] = 0.0 "where a sensor is, degrees from X, counter-clockwise from above";
pin out float distance_#[3] "mm";

function _ fp;
license "Apache-2.0 OR MIT";
author "The trued contributors";
;;

#include <rtapi_math.h>

FUNCTION(_) {
    double q = c * M_PI / 180.0, motion_x = 0.0, motion_y = 0.0;
    for (int k = 1; k < 9; k++) {
        motion_x += motion_xc(k) * cos(k * q) + motion_xs(k) * sin(k * q);
        motion_y += motion_yc(k) * cos(k * q) + motion_ys(k) * sin(k * q);
    }
    /* Centre of the cylinder in the machine frame. */
    double x = cos(q) * ecc_x - sin(q) * ecc_y + motion_x;
    double y = sin(q) * ecc_x + cos(q) * ecc_y + motion_y;
    for (int i = 0; i < 3; i++) {
        double nx = cos(angle(i) * M_PI / 180.0), ny = sin(angle(i) * M_PI / 180.0), far = 0.0;
        /* The ray (radius - far)·n meets the surface where it is as far from the centre as the form says; its
           slope is some 1e-4, so each round leaves a ten thousandth of the error. */
        for (int round = 0; round < 4; round++) {
            double u = (radius - far) * nx - x, v = (radius - far) * ny - y;
            double psi = atan2(v, u) - q, wide = radius;
            for (int k = 2; k < 9; k++) wide += form_c(k) * cos(k * psi) + form_s(k) * sin(k * psi);
            far += sqrt(u * u + v * v) - wide;
        }
        distance(i) = far;
    }
}
