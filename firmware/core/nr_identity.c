#include "nr_identity.h"

#include "nr_frame.h"

#include "../generated/needle_rig.h"

/* `needle-rig firmware build` says which; a build by hand says nothing. */
#ifndef NR_VERSION_MAJOR
#define NR_VERSION_MAJOR 0
#define NR_VERSION_MINOR 0
#define NR_VERSION_PATCH 0
#endif
#ifndef NR_BUILD
#define NR_BUILD 0
#endif

bool nr_identity_tick(struct nr_identity *identity, uint32_t now_us, uint32_t *id, uint8_t data[8])
{
    if (identity->begun && now_us - identity->due_us > UINT32_MAX / 2u) {
        return false;
    }
    identity->begun = true;
    identity->due_us = now_us + NR_IDENTITY_PERIOD_US;
    if (identity->calibration_next) {
        const struct needle_rig_torque_calibration_t calibration = {
            .protocol = NEEDLE_RIG_TORQUE_CALIBRATION_PROTOCOL_CURRENT_CHOICE,
            .calibrated = identity->calibrated,
            .counter = identity->counter,
            .serial = identity->serial,
        };
        (void)needle_rig_torque_calibration_pack(data, &calibration, 8);
        *id = identity->firmware_id + 1u;
        identity->counter = (uint8_t)((identity->counter + 1u) & 15u);
    } else {
        const struct needle_rig_torque_firmware_t firmware = {
            .protocol = NEEDLE_RIG_TORQUE_FIRMWARE_PROTOCOL_CURRENT_CHOICE,
            .major = NR_VERSION_MAJOR,
            .minor = NR_VERSION_MINOR,
            .patch = NR_VERSION_PATCH,
            .counter = identity->counter,
            .build = NR_BUILD,
        };
        (void)needle_rig_torque_firmware_pack(data, &firmware, 8);
        *id = identity->firmware_id;
    }
    data[7] = nr_can_checksum(*id, data);
    identity->calibration_next = !identity->calibration_next;
    return true;
}
