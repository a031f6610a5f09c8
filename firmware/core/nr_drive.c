#include "nr_drive.h"

#include "nr_frame.h"

#include "../generated/needle_rig.h"

const struct nr_drive_config nr_drive_defaults = {
    .counts_per_turn = 360000,
    .acceleration = 7200,
    .duty_per_velocity = 1193,
    .kp_q16 = 2400,
    .ki_q16 = 24000,
    .duty_limit = 32767,
    .guard = {
        .command_age_us = 50000,
        .heartbeat_us = 50000,
        .torque_age_us = 50000,
        .latch_us = 100000,
        .window_us = 40000,
        .velocity_limit = 900000,
        .rate_limit = 1200000,
        .angle_limit_mdeg = 720000,
        .angle_margin_mdeg = 2000,
        .torque_trip = 200000,
        .stall_percent = 20,
        .stall_floor_mdeg = 400,
        .bad_frames_limit = 10,
    },
};

enum { UNITS_PER_TURN = 3600000, VELOCITY_FILTER = 4 };

void nr_drive_init(struct nr_drive_node *node, const struct nr_drive_config *config, const void *page)
{
    *node = (struct nr_drive_node){.config = *config};
    struct nr_drive_calibration calibration;
    if (nr_page_read(page, NR_MAGIC_DRIVE, &calibration, sizeof calibration) && calibration.counts_per_turn != 0) {
        node->calibrated = true;
        node->config.counts_per_turn = calibration.counts_per_turn;
        node->config.duty_per_velocity = calibration.duty_per_velocity;
    }
    nr_guard_init(&node->guard, &config->guard);
}

void nr_drive_receive(struct nr_drive_node *node, uint32_t now_us, uint32_t id, const uint8_t *data, size_t length)
{
    if (id != NEEDLE_RIG_DRIVE_COMMAND_FRAME_ID && id != NEEDLE_RIG_TORQUE_STATUS_FRAME_ID) {
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
            .counter = frame.counter,
            .heartbeat = frame.heartbeat,
        };
        (void)nr_guard_command(&node->guard, now_us, &command);
    } else {
        struct needle_rig_torque_status_t frame;
        (void)needle_rig_torque_status_unpack(&frame, data, length);
        nr_guard_torque(&node->guard, now_us, frame.torque, frame.state == 0);
    }
}

static int32_t clamped(int64_t value, int32_t limit)
{
    if (value > limit) {
        return limit;
    }
    return value < -(int64_t)limit ? -limit : (int32_t)value;
}

/* 1e-4 deg */
static int64_t angle_units(const struct nr_drive_node *node)
{
    return (int64_t)node->counts * UNITS_PER_TURN / node->config.counts_per_turn;
}

static void measure(struct nr_drive_node *node, uint32_t now_us, int32_t counts)
{
    if (!node->started) {
        node->started = true;
        node->last_counts = counts;
        node->last_us = now_us - 1000;
    }
    const int32_t moved = (int32_t)((uint32_t)counts - (uint32_t)node->last_counts);
    const uint32_t elapsed_us = now_us - node->last_us;
    node->counts = (int32_t)((uint32_t)node->counts + (uint32_t)moved);
    node->last_counts = counts;
    node->last_us = now_us;
    if (elapsed_us > 0) {
        const int64_t velocity = (int64_t)moved * UNITS_PER_TURN / node->config.counts_per_turn * 1000000 / elapsed_us;
        node->velocity_q8 += (velocity * 256 - node->velocity_q8) / VELOCITY_FILTER;
    }
}

static int32_t law(struct nr_drive_node *node, int32_t permitted)
{
    const struct nr_drive_config *config = &node->config;
    node->ramp += clamped((int64_t)permitted - node->ramp, config->acceleration);
    const int64_t error = node->ramp - node->velocity_q8 / 256;
    const int64_t lag = node->lag + error * 1000;
    const int64_t duty = ((int64_t)node->ramp * config->duty_per_velocity + error * config->kp_q16 +
                          lag / 1000000 * config->ki_q16) / 65536;
    const int32_t limited = clamped(duty, config->duty_limit);
    if (limited == duty) {
        node->lag = lag; /* integrate only while not clipped */
    }
    return limited;
}

uint32_t nr_drive_tick(struct nr_drive_node *node, uint32_t now_us, int32_t counts, bool encoder_good, int32_t *duty,
                       uint8_t data[8])
{
    measure(node, now_us, counts);
    const int32_t angle_mdeg = clamped(angle_units(node) / 10, 8000000);
    const int32_t permitted = nr_guard_step(&node->guard, now_us, angle_mdeg, encoder_good, node->ramp);
    if (node->guard.state == NR_RUNNING) {
        *duty = law(node, permitted);
    } else {
        node->ramp = 0;
        node->lag = 0;
        *duty = 0;
    }
    const struct needle_rig_drive_status_t status = {
        .angle = angle_mdeg,
        .state = (uint8_t)node->guard.state,
        .counter = node->counter,
        .faults = node->guard.faults,
        .node_time = (uint16_t)((now_us / 100u) & 0xFFFFu),
    };
    (void)needle_rig_drive_status_pack(data, &status, 8);
    data[7] = nr_can_checksum(NEEDLE_RIG_DRIVE_STATUS_FRAME_ID, data);
    node->counter = (uint8_t)((node->counter + 1u) & 15u);
    return NEEDLE_RIG_DRIVE_STATUS_FRAME_ID;
}
