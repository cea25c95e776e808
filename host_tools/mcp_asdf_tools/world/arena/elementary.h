/* Sines, angles and exponentials by power series. Mathematics libraries differ in the last bits; these
 * functions use + - * / and square roots only, which IEEE 754 rounds alike everywhere. They have no branches,
 * so that loops over robots and rays turn into vector instructions.
 */
#ifndef MCP_ASDF_ELEMENTARY_H
#define MCP_ASDF_ELEMENTARY_H

#include "targets.h"

#include <math.h>

#define PI 3.14159265358979323846

/* 1 / n: a division per term would dominate the cost of a series. */
static const double INVERSE[] = {0,       1,       1. / 2,  1. / 3,  1. / 4,  1. / 5,  1. / 6,  1. / 7,
                                 1. / 8,  1. / 9,  1. / 10, 1. / 11, 1. / 12, 1. / 13, 1. / 14, 1. / 15,
                                 1. / 16, 1. / 17, 1. / 18, 1. / 19, 1. / 20, 1. / 21};

/* Rotate the vector (*cx, *cy), of length 1, by an angle in radians of at most 1.6 either way; 0 leaves it to
 * the bit. The error is up to 1e-13. */
IN_LOOPS void arena_rotate(double *cx, double *cy, double angle)
{
    const double square = angle * angle;
    /* Power series up to angle^17, from their last terms; until it is multiplied by the angle, `sine` is
     *
     *     sin(angle) / angle = 1 - square / (2 3) (1 - square / (4 5) (1 - ...))
     *     cosine             = 1 - square / (1 2) (1 - square / (3 4) (1 - ...)) */
    double sine = 1, cosine = 1;
    for (int n = 17; n >= 3; n -= 2) {
        sine = 1 - sine * square * (INVERSE[n] * INVERSE[n - 1]);
        cosine = 1 - cosine * square * (INVERSE[n - 1] * INVERSE[n - 2]);
    }
    sine *= angle;
    const double x = *cx * cosine - *cy * sine, y = *cx * sine + *cy * cosine;
    /* A step of Newton's method for 1 / length keeps the length at 1, over any number of rotations. */
    const double scale = 1.5 - 0.5 * (x * x + y * y);
    *cx = angle != 0 ? x * scale : *cx;
    *cy = angle != 0 ? y * scale : *cy;
}

/* Returns the arc tangent, in radians, of z in [0, 1]. Halving the angle twice brings it below 0.2, where the
 * power series is good to 1e-16. */
IN_LOOPS double arc_tangent(double z)
{
    for (int halving = 0; halving < 2; ++halving) {
        z = z / (1 + sqrt(1 + z * z)); /* the tangent of half the angle */
    }
    const double square = z * z;
    double sum = 0; /* of the power series, over z: 1 - square (1/3 - square (1/5 - ...)) */
    for (int n = 21; n >= 1; n -= 2) {
        sum = INVERSE[n] - square * sum;
    }
    return 4 * z * sum; /* the angle was halved twice */
}

/* Returns the angle between (x, y), not both 0, and straight ahead, which is along x: [0, pi], for both
 * sides. An angle up to 45 degrees is the arc tangent of the smaller of |x| and |y| over the larger; the
 * others follow by symmetry. */
IN_LOOPS double arena_bearing(double x, double y)
{
    const double along = fabs(x), across = fabs(y);
    const double angle = arc_tangent(across < along ? across / along : along / across);
    const double acute = across < along ? angle : PI / 2 - angle;
    return x < 0 ? PI - acute : acute;
}

/* Returns exp(-x) for x in [0, 4], with a relative error below 1e-12: the 16th power of the power series for
 * x / 16. */
IN_LOOPS double arena_fading(double x)
{
    const double sixteenth = x / 16;
    double power = 1; /* of the series: 1 - sixteenth (1 - sixteenth / 2 (1 - sixteenth / 3 (1 - ...))) */
    for (int n = 10; n >= 1; --n) {
        power = 1 - power * sixteenth * INVERSE[n];
    }
    power *= power; /* squared four times */
    power *= power;
    power *= power;
    return power * power;
}

#endif
