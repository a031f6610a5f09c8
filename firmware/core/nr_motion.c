#include "nr_motion.h"

enum { Q8 = 256, UNITS_PER_MDEG = 10000000, SLOWEST_TURN = 3000, FARTHEST_MDEG = 1000000 };

static int64_t size(int64_t value)
{
    return value < 0 ? -value : value;
}

static int64_t within(int64_t value, int64_t limit)
{
    if (size(value) <= limit) {
        return value;
    }
    return value < 0 ? -limit : limit;
}

/* `value` on its way to `goal`, by the share of the lag that passed. */
static int64_t closer(int64_t value, int64_t goal, uint32_t elapsed_us, uint32_t lag_us)
{
    if (elapsed_us >= lag_us) {
        return goal;
    }
    return value + (goal - value) * (int64_t)elapsed_us / (int64_t)lag_us;
}

void nr_motion_rest(struct nr_motion *motion, int32_t angle_mdeg)
{
    *motion = (struct nr_motion){.angle_mdeg = angle_mdeg, .resting = true};
}

void nr_motion_rename(struct nr_motion *motion, int32_t angle_mdeg)
{
    motion->angle_mdeg = angle_mdeg;
}

static bool too_fast(const struct nr_motion *motion, const struct nr_motion_config *config)
{
    return size(motion->turning) > motion->pace_q8 / Q8 * config->speed_percent / 100 + config->speed_floor;
}

static bool too_far(const struct nr_motion *motion, const struct nr_motion_config *config)
{
    const int64_t slack = motion->pace_q8 * (int64_t)config->slack_us / Q8;
    return size(motion->following) > (int64_t)config->floor_mdeg * UNITS_PER_MDEG + slack;
}

static enum nr_motion_verdict named(const struct nr_motion *motion)
{
    const int64_t way = motion->expected_q8;
    const int64_t back = way > 0 ? -motion->turning : motion->turning;
    if (way != 0 && back > size(way) / Q8 / 4 + SLOWEST_TURN) {
        return NR_MOTION_AGAINST;
    }
    return way == 0 || (way > 0) != (motion->following > 0) ? NR_MOTION_RUNS : NR_MOTION_STALLS;
}

enum nr_motion_verdict nr_motion_step(struct nr_motion *motion, const struct nr_motion_config *config,
                                      uint32_t elapsed_us, int32_t angle_mdeg, int32_t asked)
{
    const int64_t moved = within((int64_t)angle_mdeg - motion->angle_mdeg, FARTHEST_MDEG) * UNITS_PER_MDEG;
    motion->angle_mdeg = angle_mdeg;
    if (asked != 0 && motion->resting) {
        motion->resting = false;
        motion->following = 0;
    }
    motion->unasked_us = asked != 0 ? 0 : motion->unasked_us + elapsed_us;
    motion->expected_q8 = closer(motion->expected_q8, (int64_t)asked * Q8, elapsed_us, config->lag_us);
    motion->following += motion->expected_q8 * (int64_t)elapsed_us / Q8 - moved;
    if (elapsed_us > 0) {
        motion->turning = closer(motion->turning, moved / (int64_t)elapsed_us, elapsed_us, config->speed_us);
    }
    motion->pace_q8 = closer(motion->pace_q8, 0, elapsed_us, config->memory_us);
    if (size(asked) * Q8 > motion->pace_q8) {
        motion->pace_q8 = size(asked) * Q8;
    }
    if (motion->resting) {
        return size(motion->following) > (int64_t)config->rest_mdeg * UNITS_PER_MDEG ? NR_MOTION_UNASKED
                                                                                     : NR_MOTION_FOLLOWS;
    }
    const bool wrong = too_fast(motion, config) || too_far(motion, config);
    const enum nr_motion_verdict verdict = wrong ? named(motion) : NR_MOTION_FOLLOWS;
    if (motion->unasked_us >= config->rest_us) {
        nr_motion_rest(motion, angle_mdeg);
    }
    return verdict;
}
