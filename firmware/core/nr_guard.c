#include "nr_guard.h"

static int32_t magnitude(int32_t value)
{
    if (value == INT32_MIN) {
        return INT32_MAX;
    }
    return value < 0 ? -value : value;
}

static int64_t distance(int32_t a, int32_t b)
{
    const int64_t d = (int64_t)a - (int64_t)b;
    return d < 0 ? -d : d;
}

void nr_guard_init(struct nr_guard *guard, const struct nr_guard_config *config)
{
    *guard = (struct nr_guard){.config = *config, .state = NR_SILENT};
}

bool nr_guard_command(struct nr_guard *guard, uint32_t now_us, const struct nr_command *command)
{
    const uint8_t moved_on = (uint8_t)((command->counter - guard->last_counter) & 15u);
    const bool in_sequence = guard->counter_seen && moved_on >= 1 && moved_on <= 3;
    guard->counter_seen = true;
    guard->last_counter = (uint8_t)(command->counter & 15u);
    if (!in_sequence) {
        return false;
    }
    if (!guard->command_seen || command->heartbeat != guard->last_heartbeat) {
        guard->heartbeat_us = now_us;
        guard->last_heartbeat = command->heartbeat;
    }
    const bool asks = command->clear && !command->enable && command->velocity == 0;
    if (!asks) {
        guard->clear_asked = false;
    } else if (!guard->last_clear) {
        guard->clear_asked = true;
    }
    guard->last_clear = command->clear;
    guard->command = *command;
    guard->command_seen = true;
    guard->command_us = now_us;
    return true;
}

void nr_guard_torque(struct nr_guard *guard, uint32_t now_us, int32_t torque, bool good)
{
    if (good) {
        guard->torque = torque;
        guard->torque_us = now_us;
        guard->torque_seen = true;
    }
}

void nr_guard_bad_frame(struct nr_guard *guard)
{
    if (guard->bad_frames < UINT16_MAX) {
        guard->bad_frames++;
    }
}

static bool inward(int32_t velocity, int32_t angle_mdeg)
{
    return angle_mdeg > 0 ? velocity < 0 : velocity > 0;
}

/* What would stop the motor now, whatever the state. */
static uint8_t causes(const struct nr_guard *guard, uint32_t now_us, int32_t angle_mdeg, bool encoder_good)
{
    const struct nr_guard_config *limit = &guard->config;
    uint8_t found = 0;
    if (!guard->command_seen || now_us - guard->command_us > limit->command_age_us) {
        found |= NR_FAULT_COMMAND_AGE;
    } else if (now_us - guard->heartbeat_us > limit->heartbeat_us) {
        found |= NR_FAULT_HEARTBEAT;
    }
    if (!guard->torque_seen || now_us - guard->torque_us > limit->torque_age_us) {
        found |= NR_FAULT_TORQUE_AGE;
    } else if (magnitude(guard->torque) > limit->torque_trip) {
        found |= NR_FAULT_TORQUE_TRIP;
    }
    if (magnitude(guard->command.velocity) > limit->velocity_limit) {
        found |= NR_FAULT_VELOCITY;
    }
    if (!encoder_good) {
        found |= NR_FAULT_ENCODER;
    } else if (distance(angle_mdeg, 0) > (int64_t)limit->angle_limit_mdeg + limit->angle_margin_mdeg &&
               !inward(guard->command.velocity, angle_mdeg)) {
        found |= NR_FAULT_ANGLE;
    }
    if (guard->bad_frames > limit->bad_frames_limit) {
        found |= NR_FAULT_FRAME;
    }
    return found;
}

/* Rate and stall, judged once a window. */
static uint8_t judge_window(struct nr_guard *guard, uint32_t now_us, int32_t angle_mdeg)
{
    const struct nr_guard_config *limit = &guard->config;
    if (!guard->window_open) {
        guard->window_open = true;
        guard->window_start_us = now_us;
        guard->window_angle_mdeg = angle_mdeg;
        guard->window_asked = 0;
        guard->bad_frames = 0;
        return 0;
    }
    const uint32_t elapsed_us = now_us - guard->window_start_us;
    if (elapsed_us < limit->window_us) {
        return 0;
    }
    uint8_t found = 0;
    const int64_t moved_mdeg = distance(angle_mdeg, guard->window_angle_mdeg);
    /* 1e-4 deg/s x us = 1e-10 deg = 1e-7 mdeg */
    if (moved_mdeg * 10000000 > (int64_t)limit->rate_limit * (int64_t)elapsed_us) {
        found |= NR_FAULT_VELOCITY;
    }
    const int64_t asked_mdeg = (guard->window_asked < 0 ? -guard->window_asked : guard->window_asked) / 10000000;
    if (asked_mdeg > limit->stall_floor_mdeg && moved_mdeg * 100 < asked_mdeg * limit->stall_percent) {
        found |= NR_FAULT_ENCODER;
    }
    guard->window_open = false;
    return found;
}

static void try_clear(struct nr_guard *guard, uint32_t now_us, uint8_t present)
{
    /* Damage done to frames before the clear is forgiven by it. */
    const uint8_t cause = (uint8_t)(present & ~(unsigned)NR_FAULT_FRAME);
    const bool latched = (guard->faults & ~(unsigned)NR_FAULTS_TEMPORARY) != 0;
    const bool still = now_us - guard->still_since_us >= guard->config.latch_us;
    /* A shaft out of range can be cleared: it may then only turn back in. */
    const bool gone = (cause & ~(unsigned)NR_FAULT_ANGLE) == 0;
    if (gone && (!latched || still)) {
        guard->faults = 0;
        guard->bad_frames = 0;
        guard->state = NR_READY;
    }
}

static int32_t permitted_velocity(const struct nr_guard *guard, int32_t angle_mdeg)
{
    const int32_t wanted = guard->command.velocity;
    const bool outward = (wanted > 0 && angle_mdeg >= guard->config.angle_limit_mdeg) ||
                         (wanted < 0 && angle_mdeg <= -guard->config.angle_limit_mdeg);
    return outward ? 0 : wanted;
}

int32_t nr_guard_step(struct nr_guard *guard, uint32_t now_us, int32_t angle_mdeg, bool encoder_good, int32_t asked)
{
    if (guard->window_open) {
        guard->window_asked += (int64_t)asked * (int64_t)(now_us - guard->step_us);
    }
    guard->step_us = now_us;
    uint8_t present = causes(guard, now_us, angle_mdeg, encoder_good);
    present |= judge_window(guard, now_us, angle_mdeg);
    if (guard->permitted != 0) {
        guard->still_since_us = now_us;
    }
    if (guard->state == NR_READY || guard->state == NR_RUNNING) {
        guard->clear_asked = false; /* nothing to clear: a stuck bit must not wait for a later fault */
    }
    if (guard->state == NR_SILENT || guard->state == NR_FAULT) {
        if (guard->clear_asked) {
            try_clear(guard, now_us, present);
        }
    } else if (guard->state == NR_READY && !guard->command.enable) {
        /* A shaft that stands still may wait for its sensors; a host that left must ask again. */
        if (present & NR_FAULT_COMMAND_AGE) {
            guard->state = NR_SILENT;
        }
    } else if (present != 0) {
        guard->faults = present;
        guard->state = NR_FAULT;
    } else {
        guard->state = guard->command.enable ? NR_RUNNING : NR_READY;
    }
    guard->permitted = guard->state == NR_RUNNING ? permitted_velocity(guard, angle_mdeg) : 0;
    return guard->permitted;
}
