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

static bool in_sequence(const struct nr_guard *guard, const struct nr_command *command)
{
    const uint8_t counted = (uint8_t)((command->counter - guard->last_counter) & 15u);
    const uint16_t beaten = (uint16_t)(command->heartbeat - guard->last_heartbeat);
    return guard->sequence_seen && counted >= 1 && counted <= 3 && beaten <= 3;
}

static bool same(const struct nr_command *a, const struct nr_command *b)
{
    return a->velocity == b->velocity && a->enable == b->enable && a->clear == b->clear && a->acknowledge == b->acknowledge &&
           a->sight_us == b->sight_us && a->counter == b->counter && a->heartbeat == b->heartbeat;
}

static void take_sequence(struct nr_guard *guard, uint32_t now_us, const struct nr_command *command)
{
    guard->sequence_seen = true;
    guard->last_counter = (uint8_t)(command->counter & 15u);
    guard->last_heartbeat = command->heartbeat;
    guard->sequence_us = now_us;
}

static void out_of_sequence(struct nr_guard *guard, uint32_t now_us, const struct nr_command *command)
{
    if (guard->command_seen && same(command, &guard->command)) {
        return; /* a bus repeats a frame whose acknowledgement was lost */
    }
    if (guard->foreign_us <= guard->config.foreign_limit * guard->config.foreign_us) {
        guard->foreign_us += guard->config.foreign_us;
    }
    if (!guard->sequence_seen || now_us - guard->sequence_us > guard->config.resync_us) {
        take_sequence(guard, now_us, command);
    }
}

bool nr_guard_command(struct nr_guard *guard, uint32_t now_us, const struct nr_command *command)
{
    if (!in_sequence(guard, command)) {
        out_of_sequence(guard, now_us, command);
        return false;
    }
    if (!guard->command_seen || command->heartbeat != guard->last_heartbeat) {
        guard->heartbeat_us = now_us;
    }
    take_sequence(guard, now_us, command);
    const bool asks = command->clear && !command->enable && command->velocity == 0;
    if (!asks) {
        guard->clear_asked = false;
    } else if (!guard->last_clear) {
        guard->clear_asked = true;
        guard->acknowledged = command->acknowledge;
        guard->sight_us = now_us - command->sight_us;
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
static uint16_t causes(const struct nr_guard *guard, uint32_t now_us, const struct nr_senses *senses)
{
    const struct nr_guard_config *limit = &guard->config;
    uint16_t found = 0;
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
    if (!senses->encoder_good) {
        found |= NR_FAULT_ENCODER;
    } else if (distance(senses->angle_mdeg, 0) > (int64_t)limit->angle_limit_mdeg + limit->angle_margin_mdeg &&
               !inward(guard->command.velocity, senses->angle_mdeg)) {
        found |= NR_FAULT_ANGLE;
    }
    if (guard->bad_frames > limit->bad_frames_limit) {
        found |= NR_FAULT_FRAME;
    }
    if (guard->foreign_us > limit->foreign_limit * limit->foreign_us) {
        found |= NR_FAULT_MASTER;
    }
    if (senses->emergency_stop) {
        found |= NR_FAULT_EMERGENCY_STOP;
    }
    return found;
}

/* What the shaft does against what was asked of it. */
static uint16_t judge_motion(struct nr_guard *guard, uint32_t elapsed_us, int32_t angle_mdeg, int32_t asked)
{
    if (guard->state == NR_SILENT || guard->state == NR_FAULT) {
        nr_motion_rest(&guard->motion, angle_mdeg); /* a hand may turn it */
        return 0;
    }
    const enum nr_motion_verdict verdict =
        nr_motion_step(&guard->motion, &guard->config.motion, elapsed_us, angle_mdeg, asked);
    if (verdict == NR_MOTION_FOLLOWS) {
        return 0;
    }
    if (guard->state == NR_READY || verdict == NR_MOTION_UNASKED) {
        return NR_FAULT_IDLE_MOTION;
    }
    if (verdict == NR_MOTION_RUNS) {
        return NR_FAULT_RUNAWAY;
    }
    return verdict == NR_MOTION_AGAINST ? NR_FAULT_DIRECTION : NR_FAULT_STALL;
}

static void forget(struct nr_guard *guard, uint32_t now_us, uint32_t elapsed_us)
{
    guard->foreign_us -= elapsed_us < guard->foreign_us ? elapsed_us : guard->foreign_us;
    if (!guard->window_open || now_us - guard->window_start_us >= guard->config.window_us) {
        guard->window_open = true;
        guard->window_start_us = now_us;
        guard->bad_frames = 0;
    }
}

static void watch_stillness(struct nr_guard *guard, uint32_t now_us, int32_t angle_mdeg)
{
    const bool moved = distance(angle_mdeg, guard->still_angle_mdeg) > guard->config.still_mdeg;
    if (guard->permitted != 0 || moved) {
        guard->still_since_us = now_us;
        guard->still_angle_mdeg = angle_mdeg;
    }
}

static bool still(const struct nr_guard *guard, uint32_t now_us)
{
    return now_us - guard->still_since_us >= guard->config.latch_us;
}

bool nr_guard_reference(struct nr_guard *guard, uint32_t now_us, uint16_t heartbeat, int32_t angle_mdeg)
{
    const bool known = guard->command_seen && now_us - guard->command_us <= guard->config.command_age_us &&
                       heartbeat == guard->command.heartbeat;
    if (!known || guard->state == NR_RUNNING || !still(guard, now_us)) {
        return false;
    }
    guard->referenced = true;
    guard->still_angle_mdeg = angle_mdeg;
    nr_motion_rename(&guard->motion, angle_mdeg);
    return true;
}

static bool latched(const struct nr_guard *guard)
{
    return (guard->faults & ~(unsigned)NR_FAULTS_TEMPORARY) != 0;
}

static void try_clear(struct nr_guard *guard, uint32_t now_us, uint16_t present)
{
    /* Damage done to frames before the clear is forgiven by it. */
    const uint16_t cause = (uint16_t)(present & ~(unsigned)NR_FAULT_FRAME);
    /* A shaft out of range can be cleared: it may then only turn back in. */
    const bool gone = (cause & ~(unsigned)NR_FAULT_ANGLE) == 0;
    if (gone && (!latched(guard) || (guard->acknowledged && still(guard, now_us)))) {
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

/* A shaft that nobody turns may wait for its sensors and for a sensible command; these end READY. */
enum { ENDS_READY = NR_FAULT_IDLE_MOTION | NR_FAULT_EMERGENCY_STOP };

/* What latches stays, also beside a fault that does not. */
static void latch(struct nr_guard *guard, uint32_t now_us, uint16_t present)
{
    const uint16_t latching = (uint16_t)(present & ~(unsigned)NR_FAULTS_TEMPORARY);
    if (guard->state == NR_SILENT && (present & NR_FAULT_EMERGENCY_STOP)) {
        guard->state = NR_FAULT;
    }
    if (guard->state != NR_FAULT) {
        return;
    }
    guard->faults |= latching;
    if (latching & ~(unsigned)NR_FAULT_ANGLE) {
        guard->cause_us = now_us;
    }
    if (latched(guard) && now_us - guard->cause_us < now_us - guard->sight_us + guard->config.latch_us) {
        guard->clear_asked = false;
    }
}

static void change_state(struct nr_guard *guard, uint32_t now_us, uint16_t present)
{
    const bool enable = guard->command.enable;
    latch(guard, now_us, present);
    if (guard->state == NR_SILENT || guard->state == NR_FAULT) {
        if (guard->clear_asked) {
            try_clear(guard, now_us, present);
        }
        return;
    }
    guard->clear_asked = false; /* nothing to clear: a stuck bit must not wait for a later fault */
    const bool waits = guard->state == NR_READY && !enable;
    const uint16_t reasons = waits ? (uint16_t)(present & ENDS_READY) : present;
    if (reasons != 0) {
        guard->faults = reasons;
        guard->state = NR_FAULT;
        guard->cause_us = now_us;
    } else if (waits && (present & NR_FAULT_COMMAND_AGE)) {
        guard->state = NR_SILENT; /* a host that left must ask again */
    } else if (!enable) {
        guard->state = NR_READY;
    } else if (now_us - guard->supply_us >= guard->config.contact_us) {
        guard->state = NR_RUNNING;
    }
}

int32_t nr_guard_step(struct nr_guard *guard, uint32_t now_us, const struct nr_senses *senses, int32_t asked)
{
    const uint32_t elapsed_us = now_us - guard->step_us;
    guard->step_us = now_us;
    uint16_t present = causes(guard, now_us, senses);
    present |= judge_motion(guard, elapsed_us, senses->angle_mdeg, asked);
    forget(guard, now_us, elapsed_us);
    watch_stillness(guard, now_us, senses->angle_mdeg);
    change_state(guard, now_us, present);
    const bool supply = guard->state == NR_READY || guard->state == NR_RUNNING;
    if (supply && !guard->supply) {
        guard->supply_us = now_us;
    }
    guard->supply = supply;
    guard->permitted = guard->state == NR_RUNNING ? permitted_velocity(guard, senses->angle_mdeg) : 0;
    return guard->permitted;
}
