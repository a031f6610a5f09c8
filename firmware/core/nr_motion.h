/* Follows what the motor was asked for against what the encoder saw, at any speed.
 *
 * `following` is what the shaft should have turned by now less what it turned. It should follow the asked velocity with
 * the lag of an ordinary motor (`lag_us`); the drive's loop takes `following` back to zero, so that it stays small at
 * any speed. More than `floor + slack x pace` is a fault, `pace` being the fastest that was asked of late. So is a shaft
 * much faster than the pace: a bridge that shorted is seen before it is far. Integers only, in the units of nr_guard.h.
 */
#ifndef NR_MOTION_H
#define NR_MOTION_H

#include <stdbool.h>
#include <stdint.h>

struct nr_motion_config {
    uint32_t lag_us;        /* of the motor, from asked to turned */
    uint32_t memory_us;     /* how soon a pace is forgotten */
    uint32_t slack_us;      /* time at the pace by which the shaft may be behind or ahead */
    uint32_t rest_us;       /* nothing asked for so long: the motor may rest */
    int32_t floor_mdeg;     /* behind or ahead at no pace at all */
    int32_t rest_mdeg;      /* moved while the motor rests: a hand may touch it */
    uint32_t speed_us;      /* over which the measured speed is smoothed */
    int32_t speed_percent;  /* of the pace: faster than this and */
    int32_t speed_floor;    /* this on top, 1e-4 deg/s, is too fast */
};

/* What was seen; the caller names it with the bits of its faults. */
enum nr_motion_verdict {
    NR_MOTION_FOLLOWS = 0,
    NR_MOTION_STALLS = 1,   /* turned less than asked */
    NR_MOTION_RUNS = 2,     /* turned more than asked */
    NR_MOTION_AGAINST = 4,  /* turned against what was asked */
    NR_MOTION_UNASKED = 8   /* moved while the motor rests */
};

struct nr_motion {
    int32_t angle_mdeg;
    int64_t expected_q8;    /* velocity that the shaft should have, in 1/256 */
    int64_t pace_q8;        /* fastest that was asked of late */
    int64_t turning;        /* velocity that it has, smoothed */
    int64_t following;      /* 1e-10 deg */
    uint32_t unasked_us;
    bool resting;
};

/* The shaft stands at `angle_mdeg` and nothing is asked. */
void nr_motion_rest(struct nr_motion *motion, int32_t angle_mdeg);

/* The same place has another angle from now on. */
void nr_motion_rename(struct nr_motion *motion, int32_t angle_mdeg);

/* What became of `asked`, which was in force for `elapsed_us` until now. */
enum nr_motion_verdict nr_motion_step(struct nr_motion *motion, const struct nr_motion_config *config,
                                      uint32_t elapsed_us, int32_t angle_mdeg, int32_t asked);

#endif
