#include "nr_torque.h"

#include "nr_frame.h"

#include "../generated/needle_rig.h"

enum { FULL_SCALE = 8388607, STUCK_TICKS = 1000, TORQUE_RAW_MAX = 8000000 };

void nr_torque_init(struct nr_torque_node *node, const void *page)
{
    *node = (struct nr_torque_node){.identity = {.firmware_id = NEEDLE_RIG_TORQUE_FIRMWARE_FRAME_ID}};
    node->identity.calibrated = nr_page_read(page, NR_MAGIC_TORQUE, &node->calibration, sizeof node->calibration,
                                             &node->identity.serial);
    if (!node->identity.calibrated) {
        node->calibration = (struct nr_torque_calibration){.offset_counts = 0, .gain_q24 = 1 << 24};
    }
}

static uint8_t judge(struct nr_torque_node *node, int32_t counts, bool converted)
{
    if (!converted || counts != node->last_counts) {
        node->same_counts = 0;
    } else if (node->same_counts < STUCK_TICKS) {
        node->same_counts++;
    }
    node->last_counts = counts;
    if (node->ticks < NR_TORQUE_STARTING_TICKS) {
        return NR_TORQUE_STARTING;
    }
    if (!converted || node->same_counts >= STUCK_TICKS) {
        return NR_TORQUE_SENSOR_FAULT;
    }
    return (counts >= FULL_SCALE || counts <= -FULL_SCALE) ? NR_TORQUE_SATURATED : NR_TORQUE_OK;
}

static int32_t calibrated(const struct nr_torque_calibration *calibration, int64_t counts_q8)
{
    const int64_t centred_q8 = counts_q8 - (int64_t)calibration->offset_counts * 256;
    int64_t torque = centred_q8 * calibration->gain_q24 / ((int64_t)1 << 32);
    if (torque > TORQUE_RAW_MAX) {
        torque = TORQUE_RAW_MAX;
    } else if (torque < -TORQUE_RAW_MAX) {
        torque = -TORQUE_RAW_MAX;
    }
    return (int32_t)torque;
}

uint32_t nr_torque_tick(struct nr_torque_node *node, uint32_t now_us, int32_t counts, bool converted, uint8_t data[8])
{
    const uint8_t state = judge(node, counts, converted);
    if (converted) {
        const int64_t counts_q8 = (int64_t)counts * 256;
        if (node->ticks == 0) {
            node->filtered_q8 = counts_q8;
        } else {
            node->filtered_q8 += (counts_q8 - node->filtered_q8) / (1 << NR_TORQUE_FILTER_SHIFT);
        }
        if (node->ticks < UINT32_MAX) {
            node->ticks++;
        }
    }
    const struct needle_rig_torque_status_t status = {
        .torque = calibrated(&node->calibration, node->filtered_q8),
        .state = state,
        .counter = node->counter,
        .node_time = (now_us / 10u) & 0xFFFFFFu,
    };
    (void)needle_rig_torque_status_pack(data, &status, 8);
    data[7] = nr_can_checksum(NEEDLE_RIG_TORQUE_STATUS_FRAME_ID, data);
    node->counter = (uint8_t)((node->counter + 1u) & 15u);
    return NEEDLE_RIG_TORQUE_STATUS_FRAME_ID;
}
