/* The base-drive node: CAN velocity commands, guarded, to a motor; its encoder back on the bus.
 *
 * The velocity loop asks its motor for the ramp and a correction. The correction takes `following` of nr_motion.h back to
 * zero and is bounded by what the encoder confirms and the load explains, so that an encoder that stands still cannot
 * make the motor race: the correction may be a share of the measured velocity, of the torque at the base and of the pace,
 * and a little more.
 */
#ifndef NR_DRIVE_H
#define NR_DRIVE_H

#include "nr_calibration.h"
#include "nr_guard.h"
#include "nr_identity.h"

#include <stddef.h>

struct nr_drive_config {
    int32_t counts_per_turn;    /* of the encoder, at the needle */
    int32_t acceleration;       /* ramp of the velocity, 1e-4 deg/s per ms */
    int32_t duty_per_velocity;  /* feed-forward: duty (2^-15 of full) per 1e-4 deg/s, in 2^-16 */
    int32_t duty_limit;         /* 2^-15 of full */
    int32_t velocity_gain;      /* correction per velocity error */
    int32_t following_gain;     /* correction per `following`, 1/s */
    int32_t measured_percent;   /* bound of the correction: of the measured velocity */
    int32_t pace_percent;       /* of the pace */
    int32_t torque_percent;     /* of the torque, 1e-4 deg/s per 1e-5 N.mm */
    int32_t least_correction;   /* 1e-4 deg/s */
    struct nr_guard_config guard;
};

extern const struct nr_drive_config nr_drive_defaults;

struct nr_drive_inputs {
    int32_t counts;             /* of the encoder, 32 bit, may wrap */
    bool encoder_good;
    bool index;                 /* over the index mark */
    bool emergency_stop;        /* pressed, or its wire is broken */
};

struct nr_drive_outputs {
    int32_t duty;               /* +-2^15 for full, exactly 0 with the bridge off unless the guard is RUNNING */
    bool supply;                /* safe-torque-off: whether the bridge may have its supply */
    bool health_due;            /* send `health`, before `status` */
    uint8_t health[8];
    uint8_t status[8];
};

struct nr_drive_node {
    struct nr_drive_config config;
    struct nr_guard guard;
    struct nr_identity identity;
    bool started;
    uint32_t last_us;
    uint64_t uptime_us;
    int32_t last_counts;
    int32_t counts;             /* unwrapped, from the reference, or from where it started */
    int64_t velocity_q8;        /* measured, filtered, 1e-4 deg/s in 1/256 */
    int32_t ramp;               /* velocity wanted now */
    bool index_before;
    bool index_seen;
    int32_t index_mdeg;
    uint8_t counter;
    uint8_t health_counter;
    uint16_t health_sent;       /* first twelve bits of the newest DRIVE_HEALTH, without its counter */
    uint32_t health_us;
};

/* `page` stands in for the counts a turn and the feed-forward of `config`. */
void nr_drive_init(struct nr_drive_node *node, const struct nr_drive_config *config, const void *page);

/* Any frame seen on the bus: a command, a reference, the torque node's status, or neither. */
void nr_drive_receive(struct nr_drive_node *node, uint32_t now_us, uint32_t id, const uint8_t *data, size_t length);

/* Once a millisecond. */
void nr_drive_tick(struct nr_drive_node *node, uint32_t now_us, const struct nr_drive_inputs *in,
                   struct nr_drive_outputs *out);

#endif
