/* The base-drive node: CAN velocity commands, guarded, to a motor; its encoder back on the bus. */
#ifndef NR_DRIVE_H
#define NR_DRIVE_H

#include "nr_calibration.h"
#include "nr_guard.h"

#include <stddef.h>

struct nr_drive_config {
    int32_t counts_per_turn;   /* of the encoder, at the needle */
    int32_t acceleration;      /* ramp of the velocity, 1e-4 deg/s per ms */
    int32_t duty_per_velocity; /* feed-forward: duty (2^-15 of full) per 1e-4 deg/s, in 2^-16 */
    int32_t kp_q16;            /* duty per 1e-4 deg/s of velocity error, 2^-16 */
    int32_t ki_q16;            /* duty per 1e-4 deg of position error, 2^-16 */
    int32_t duty_limit;        /* 2^-15 of full */
    struct nr_guard_config guard;
};

extern const struct nr_drive_config nr_drive_defaults;

struct nr_drive_node {
    struct nr_drive_config config;
    struct nr_guard guard;
    bool calibrated;
    bool started;
    uint32_t last_us;
    int32_t last_counts;
    int32_t counts;        /* since start, unwrapped */
    int64_t velocity_q8;   /* measured, filtered, 1e-4 deg/s in 1/256 */
    int32_t ramp;          /* velocity wanted now */
    int64_t lag;           /* integral of the velocity error, 1e-4 deg in 1e-6 */
    uint8_t counter;
};

/* `page` stands in for the counts a turn and the feed-forward of `config`. */
void nr_drive_init(struct nr_drive_node *node, const struct nr_drive_config *config, const void *page);

/* Any frame seen on the bus: a command, the torque node's status, or neither. */
void nr_drive_receive(struct nr_drive_node *node, uint32_t now_us, uint32_t id, const uint8_t *data, size_t length);

/* Once a millisecond. `counts` is the encoder counter (32 bit, may wrap). Gives the motor's duty, +-2^15 for full,
 * exactly 0 with the bridge off unless the guard is RUNNING; fills one DRIVE_STATUS frame and gives its id. */
uint32_t nr_drive_tick(struct nr_drive_node *node, uint32_t now_us, int32_t counts, bool encoder_good, int32_t *duty,
                       uint8_t data[8]);

#endif
