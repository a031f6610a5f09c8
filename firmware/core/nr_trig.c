#include "nr_trig.h"

_Static_assert((-3 >> 1) == -2, "shifts of negative numbers must keep the sign");

/* CORDIC works in 1/256 microradian, so that 24 roundings stay below one microradian. */
enum { STEPS = 24, PI_FINE = 804247719 };

static const int32_t arc_tangent[STEPS] = {
    201061930, 118693788, 62714538, 31834879, 15979215, 7997397, 3999675, 1999959,
    999995, 499999, 250000, 125000, 62500, 31250, 15625, 7812,
    3906, 1953, 977, 488, 244, 122, 61, 31,
};

struct turned {
    int64_t length; /* times the CORDIC gain 1.646760258 */
    int32_t angle;
};

static struct turned vectoring(int32_t y_in, int32_t x_in)
{
    int64_t x = (int64_t)x_in * 256;
    int64_t y = (int64_t)y_in * 256;
    int32_t angle = 0;
    if (x < 0) {
        angle = y < 0 ? -PI_FINE : PI_FINE;
        x = -x;
        y = -y;
    }
    for (int i = 0; i < STEPS; i++) {
        const int64_t dx = x >> i;
        const int64_t dy = y >> i;
        if (y > 0) {
            x += dy;
            y -= dx;
            angle += arc_tangent[i];
        } else {
            x -= dy;
            y += dx;
            angle -= arc_tangent[i];
        }
    }
    return (struct turned){.length = x, .angle = angle};
}

static int32_t rounded(int32_t fine)
{
    return (fine + (fine < 0 ? -128 : 128)) / 256;
}

int32_t nr_wrapped_urad(int64_t angle_urad)
{
    int64_t angle = angle_urad % (2 * (int64_t)NR_PI_URAD);
    if (angle > NR_PI_URAD) {
        angle -= 2 * (int64_t)NR_PI_URAD;
    } else if (angle < -(int64_t)NR_PI_URAD) {
        angle += 2 * (int64_t)NR_PI_URAD;
    }
    return (int32_t)angle;
}

struct nr_polar nr_polar(int32_t y, int32_t x)
{
    if (x == 0 && y == 0) {
        return (struct nr_polar){0};
    }
    const struct turned turned = vectoring(y, x);
    return (struct nr_polar){
        .angle_urad = nr_wrapped_urad(rounded(turned.angle)),
        /* 652032874 = 2^30 / gain */
        .length = (int32_t)(((turned.length >> 8) * 652032874) >> 30),
    };
}

int32_t nr_sin_q20(int32_t angle_urad)
{
    int64_t angle = nr_wrapped_urad(angle_urad);
    if (angle > NR_PI_URAD / 2) {
        angle = NR_PI_URAD - angle;
    } else if (angle < -(int64_t)(NR_PI_URAD / 2)) {
        angle = -(int64_t)NR_PI_URAD - angle;
    }
    int64_t left = angle * 256;
    int64_t x = 652032874; /* 2^30 / gain */
    int64_t y = 0;
    for (int i = 0; i < STEPS; i++) {
        const int64_t dx = x >> i;
        const int64_t dy = y >> i;
        if (left >= 0) {
            x -= dy;
            y += dx;
            left -= arc_tangent[i];
        } else {
            x += dy;
            y -= dx;
            left += arc_tangent[i];
        }
    }
    return (int32_t)(y >> 10);
}
