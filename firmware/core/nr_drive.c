#include "nr_drive.h"

#include "nr_frame.h"

#include "../generated/needle_rig.h"

const struct nr_drive_config nr_drive_defaults = {
    .counts_per_turn = 360000,
    .acceleration = 7200,
    .duty_per_velocity = 1193,
    .duty_limit = 32767,
    .velocity_gain = 2,
    .following_gain = 20,
    .measured_percent = 38, /* with the pace's share 50: a motor of 0.7 of the nominal gain wants 43 */
    .pace_percent = 12,
    .torque_percent = 15,   /* a droop of 1.5 deg/s per N.mm */
    .least_correction = 5500, /* half a N.mm in the gears, where no sensor sees it */
    .guard = {
        .command_age_us = 50000,
        .heartbeat_us = 50000,
        .torque_age_us = 50000,
        .latch_us = 100000,
        .window_us = 40000,
        .contact_us = 20000,
        .resync_us = 20000,
        .foreign_us = 50000,
        .velocity_limit = 900000,
        .angle_limit_mdeg = 720000,
        .angle_margin_mdeg = 2000,
        .still_mdeg = 10,
        .torque_trip = 200000,
        .bad_frames_limit = 10,
        .foreign_limit = 3,
        .motion = {
            .lag_us = 20000,
            .memory_us = 400000,
            .slack_us = 50000,
            .rest_us = 100000,
            .floor_mdeg = 250,
            .rest_mdeg = 1000,
            .speed_us = 5000,
            .speed_percent = 130,
            .speed_floor = 150000,
        },
    },
};

enum {
    SIGHT_UNIT_US = 5000,
    UNITS_PER_TURN = 3600000, /* 1e-4 deg */
    MDEG_PER_TURN = 360000,
    FARTHEST_MDEG = 8000000, /* what DRIVE_STATUS can carry */
    VELOCITY_FILTER = 4,
    HEALTH_PERIOD_US = 10000,
    HEALTH_FLAGS = 0xFFF
};

static const int64_t MOST_MOVED = INT64_MAX / 1000000; /* 1e-4 deg, which fits in 64 bits as 1e-10 deg */
static const int64_t MOST_VELOCITY = INT64_MAX / 512;  /* 1e-4 deg/s, of which two in 1/256 have a difference that fits */

void nr_drive_init(struct nr_drive_node *node, const struct nr_drive_config *config, const void *page)
{
    *node = (struct nr_drive_node){
        .config = *config,
        .identity = {.firmware_id = NEEDLE_RIG_DRIVE_FIRMWARE_FRAME_ID},
    };
    uint32_t serial;
    struct nr_drive_calibration calibration;
    if (nr_page_read(page, NR_MAGIC_DRIVE, &calibration, sizeof calibration, &serial) &&
        calibration.counts_per_turn != 0) {
        node->identity.calibrated = true;
        node->identity.serial = serial;
        node->config.counts_per_turn = calibration.counts_per_turn;
        node->config.duty_per_velocity = calibration.duty_per_velocity;
    }
    nr_guard_init(&node->guard, &config->guard);
}

static int32_t clamped(int64_t value, int32_t limit)
{
    if (value > limit) {
        return limit;
    }
    return value < -(int64_t)limit ? -limit : (int32_t)value;
}

/* `clamped` in 64 bits. */
static int64_t saturated(int64_t value, int64_t limit)
{
    if (value > limit) {
        return limit;
    }
    return value < -limit ? -limit : value;
}

static int64_t magnitude(int64_t value)
{
    return value < 0 ? -value : value;
}

static int32_t angle_of(const struct nr_drive_node *node)
{
    const int64_t mdeg = (int64_t)node->counts * MDEG_PER_TURN / node->config.counts_per_turn;
    return clamped(mdeg, FARTHEST_MDEG);
}

static void take_reference(struct nr_drive_node *node, uint32_t now_us, uint16_t heartbeat, int32_t angle_mdeg)
{
    const int32_t before_mdeg = angle_of(node);
    if (!nr_guard_reference(&node->guard, now_us, heartbeat, angle_mdeg)) {
        return;
    }
    node->counts = clamped((int64_t)angle_mdeg * node->config.counts_per_turn / MDEG_PER_TURN, INT32_MAX);
    node->index_mdeg += angle_of(node) - before_mdeg;
}

void nr_drive_receive(struct nr_drive_node *node, uint32_t now_us, uint32_t id, const uint8_t *data, size_t length)
{
    const bool mine = id == NEEDLE_RIG_DRIVE_COMMAND_FRAME_ID || id == NEEDLE_RIG_TORQUE_STATUS_FRAME_ID ||
                      id == NEEDLE_RIG_DRIVE_REFERENCE_FRAME_ID;
    if (!mine) {
        return;
    }
    if (!nr_can_valid(id, data, length)) {
        nr_guard_bad_frame(&node->guard);
        return;
    }
    if (id == NEEDLE_RIG_DRIVE_COMMAND_FRAME_ID) {
        struct needle_rig_drive_command_t frame;
        (void)needle_rig_drive_command_unpack(&frame, data, length);
        const struct nr_command command = {
            .velocity = frame.velocity,
            .enable = frame.enable != 0,
            .clear = frame.clear != 0,
            .acknowledge = frame.acknowledge != 0,
            .sight_us = (uint32_t)frame.sight * SIGHT_UNIT_US,
            .counter = frame.counter,
            .heartbeat = frame.heartbeat,
        };
        (void)nr_guard_command(&node->guard, now_us, &command);
    } else if (id == NEEDLE_RIG_DRIVE_REFERENCE_FRAME_ID) {
        struct needle_rig_drive_reference_t frame;
        (void)needle_rig_drive_reference_unpack(&frame, data, length);
        take_reference(node, now_us, frame.heartbeat, frame.angle);
    } else {
        struct needle_rig_torque_status_t frame;
        (void)needle_rig_torque_status_unpack(&frame, data, length);
        nr_guard_torque(&node->guard, now_us, frame.torque, frame.state == 0);
    }
}

static void measure(struct nr_drive_node *node, uint32_t now_us, const struct nr_drive_inputs *in)
{
    if (!node->started) {
        node->started = true;
        node->index_before = in->index; /* standing over the mark is not passing it */
        node->last_counts = in->counts;
        node->last_us = now_us - 1000;
    }
    const int32_t moved = (int32_t)((uint32_t)in->counts - (uint32_t)node->last_counts);
    const uint32_t elapsed_us = now_us - node->last_us;
    node->uptime_us += elapsed_us;
    node->counts = (int32_t)((uint32_t)node->counts + (uint32_t)moved);
    node->last_counts = in->counts;
    node->last_us = now_us;
    if (elapsed_us > 0) {
        const int64_t units = saturated((int64_t)moved * UNITS_PER_TURN / node->config.counts_per_turn, MOST_MOVED);
        const int64_t velocity = saturated(units * 1000000 / elapsed_us, MOST_VELOCITY);
        node->velocity_q8 += (velocity * 256 - node->velocity_q8) / VELOCITY_FILTER;
    }
}

/* What the ramp is corrected by, 1e-4 deg/s. */
static int32_t correction(const struct nr_drive_node *node)
{
    const struct nr_drive_config *config = &node->config;
    const struct nr_motion *motion = &node->guard.motion;
    const int64_t measured = node->velocity_q8 / 256;
    const int64_t wanted = (motion->expected_q8 / 256 - measured) * config->velocity_gain +
                           motion->following / 1000000 * config->following_gain;
    const int64_t percent = magnitude(measured) * config->measured_percent +
                            motion->pace_q8 / 256 * config->pace_percent +
                            magnitude(node->guard.torque) * config->torque_percent;
    return clamped(wanted, clamped(percent / 100 + config->least_correction, INT32_MAX));
}

static int32_t law(struct nr_drive_node *node, int32_t permitted)
{
    const struct nr_drive_config *config = &node->config;
    node->ramp += clamped((int64_t)permitted - node->ramp, config->acceleration);
    if (node->ramp == 0 && node->guard.motion.resting) {
        return 0; /* nothing is asked: the motor holds by its own friction, and cannot creep */
    }
    const int64_t velocity = (int64_t)node->ramp + correction(node);
    return clamped(velocity * config->duty_per_velocity / 65536, config->duty_limit);
}

static void watch_index(struct nr_drive_node *node, bool index, int32_t angle_mdeg)
{
    if (index && !node->index_before) {
        node->index_seen = true;
        node->index_mdeg = angle_mdeg;
    }
    node->index_before = index;
}

static void report_health(struct nr_drive_node *node, uint32_t now_us, bool emergency_stop, struct nr_drive_outputs *out)
{
    const uint64_t uptime_s = node->uptime_us / 1000000u;
    const struct needle_rig_drive_health_t health = {
        .motion_faults = (uint8_t)(node->guard.faults >> 8),
        .supply_on = node->guard.supply,
        .emergency_stop = emergency_stop,
        .referenced = node->guard.referenced,
        .index_seen = node->index_seen,
        .counter = node->health_counter,
        .index_angle = clamped(node->index_mdeg, FARTHEST_MDEG),
        .uptime = (uint16_t)(uptime_s < UINT16_MAX ? uptime_s : UINT16_MAX),
    };
    (void)needle_rig_drive_health_pack(out->health, &health, 8);
    const uint16_t flags = (uint16_t)((out->health[0] | (unsigned)out->health[1] << 8) & HEALTH_FLAGS);
    out->health_due = flags != node->health_sent || now_us - node->health_us >= HEALTH_PERIOD_US;
    if (!out->health_due) {
        return;
    }
    out->health[7] = nr_can_checksum(NEEDLE_RIG_DRIVE_HEALTH_FRAME_ID, out->health);
    node->health_sent = flags;
    node->health_us = now_us;
    node->health_counter = (uint8_t)((node->health_counter + 1u) & 15u);
}

static void report_status(struct nr_drive_node *node, uint32_t now_us, int32_t angle_mdeg, uint8_t data[8])
{
    const struct needle_rig_drive_status_t status = {
        .angle = angle_mdeg,
        .state = (uint8_t)node->guard.state,
        .counter = node->counter,
        .faults = (uint8_t)(node->guard.faults & 0xFFu),
        .node_time = (uint16_t)((now_us / 100u) & 0xFFFFu),
    };
    (void)needle_rig_drive_status_pack(data, &status, 8);
    data[7] = nr_can_checksum(NEEDLE_RIG_DRIVE_STATUS_FRAME_ID, data);
    node->counter = (uint8_t)((node->counter + 1u) & 15u);
}

void nr_drive_tick(struct nr_drive_node *node, uint32_t now_us, const struct nr_drive_inputs *in,
                   struct nr_drive_outputs *out)
{
    measure(node, now_us, in);
    const struct nr_senses senses = {
        .angle_mdeg = angle_of(node),
        .encoder_good = in->encoder_good,
        .emergency_stop = in->emergency_stop,
    };
    const int32_t permitted = nr_guard_step(&node->guard, now_us, &senses, node->ramp);
    if (node->guard.state == NR_RUNNING) {
        out->duty = law(node, permitted);
    } else {
        node->ramp = 0;
        out->duty = 0;
    }
    out->supply = node->guard.supply;
    watch_index(node, in->index, senses.angle_mdeg);
    report_health(node, now_us, in->emergency_stop, out);
    report_status(node, now_us, senses.angle_mdeg, out->status);
}
