/* Angles without floating point: the same bits on every machine. */
#ifndef NR_TRIG_H
#define NR_TRIG_H

#include <stdint.h>

enum { NR_PI_URAD = 3141593 };

struct nr_polar {
    int32_t angle_urad; /* -pi to pi, 0 for the origin */
    int32_t length;
};

/* The point (x, y) in polar form, for |x|, |y| up to 2^27. From a length of 2^12 on the angle is within 6 urad and the
 * length within 4e-4. CORDIC in vectoring mode (Volder 1959). */
struct nr_polar nr_polar(int32_t y, int32_t x);

/* The same angle within -pi to pi. */
int32_t nr_wrapped_urad(int64_t angle_urad);

/* sin of an angle in microradians, in units of 2^-20; error below 3 units. */
int32_t nr_sin_q20(int32_t angle_urad);

#endif
