/* The Hall node: four pairs of analogue signals to four angles, sent over the serial line. */
#ifndef NR_HALL_H
#define NR_HALL_H

#include "nr_calibration.h"
#include "nr_frame.h"

/* Counts of one 12-bit conversion of sine and cosine. */
struct nr_hall_pair {
    uint16_t sine;
    uint16_t cosine;
};

struct nr_hall_node {
    struct nr_hall_calibration calibration[NR_HALL_SENSORS];
    bool calibrated;
    uint16_t counter;
};

void nr_hall_init(struct nr_hall_node *node, const void *page);

/* Angle, -pi to pi, and field amplitude of one sensor (16 x the length of the corrected pair, 0 to 65535). */
int32_t nr_hall_angle_urad(const struct nr_hall_calibration *calibration, struct nr_hall_pair pair, uint16_t *field);

/* One sample of all sensors as a frame for the serial line; gives its length. */
size_t nr_hall_tick(struct nr_hall_node *node, uint32_t now_us, const struct nr_hall_pair pair[NR_HALL_SENSORS],
                    uint8_t frame[NR_COBS_MAX_FRAME]);

#endif
