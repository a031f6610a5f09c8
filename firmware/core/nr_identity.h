/* What a node on the CAN bus says of itself: its protocol, version, build and calibration page, in two frames that take
 * turns every half second, each at 1 Hz. The torque node's and the drive's are laid out alike; only their ids differ. */
#ifndef NR_IDENTITY_H
#define NR_IDENTITY_H

#include <stdbool.h>
#include <stdint.h>

enum { NR_IDENTITY_PERIOD_US = 500000 };

struct nr_identity {
    uint32_t firmware_id;       /* of NAME_FIRMWARE; NAME_CALIBRATION is the next one */
    uint32_t serial;            /* of the calibration page */
    bool calibrated;
    bool begun;
    bool calibration_next;
    uint8_t counter;
    uint32_t due_us;
};

/* True when a frame is due; then `id` and `data` are it. The first one is due at once. */
bool nr_identity_tick(struct nr_identity *identity, uint32_t now_us, uint32_t *id, uint8_t data[8]);

#endif
