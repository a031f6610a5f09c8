/* The torque node: load-cell counts to a torque on the CAN bus. */
#ifndef NR_TORQUE_H
#define NR_TORQUE_H

#include "nr_calibration.h"
#include "nr_identity.h"

enum { NR_TORQUE_OK = 0, NR_TORQUE_STARTING = 1, NR_TORQUE_SATURATED = 2, NR_TORQUE_SENSOR_FAULT = 3 };

/* The filter is one pole: y += (x - y) / 2^NR_TORQUE_FILTER_SHIFT at 1 kHz, a bandwidth (-3 dB) of 46 Hz and a delay of
 * 3 ms for slow signals. */
enum { NR_TORQUE_FILTER_SHIFT = 2, NR_TORQUE_STARTING_TICKS = 32 };

struct nr_torque_node {
    struct nr_torque_calibration calibration;
    struct nr_identity identity;
    int64_t filtered_q8; /* counts in 1/256 */
    uint32_t ticks;
    uint16_t same_counts; /* conversions in a row with the very same counts */
    int32_t last_counts;
    uint8_t counter;
};

void nr_torque_init(struct nr_torque_node *node, const void *page);

/* One conversion (24-bit signed counts) to one TORQUE_STATUS frame; gives the frame's id. */
uint32_t nr_torque_tick(struct nr_torque_node *node, uint32_t now_us, int32_t counts, bool converted,
                        uint8_t data[8]);

#endif
