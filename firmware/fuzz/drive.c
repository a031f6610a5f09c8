/* CAN frames into the drive node: records of id (2 bytes), length (1), data (8), 6 ms each. */
#include "../core/nr_drive.h"
#include "../core/nr_frame.h"
#include "fuzz.h"

#include <string.h>

enum { RECORD = 11, COMMAND = 272, TORQUE = 257, REFERENCE = 275, SEED_RECORDS = 40 };

/* The checksum once more, bit by bit over the message as one polynomial, so that it is not the node's own. */
static uint8_t remainder_of(uint32_t id, const uint8_t *data)
{
    const uint8_t message[9] = {(uint8_t)id, (uint8_t)(id >> 8), data[0], data[1], data[2],
                                data[3], data[4], data[5], data[6]};
    uint32_t left = 0xFFu;
    for (unsigned bit = 0; bit < 72; bit++) {
        const uint32_t in = (message[bit / 8] >> (7 - bit % 8)) & 1u;
        const uint32_t out = (left >> 7) & 1u;
        left = (left << 1) & 0xFFu;
        left ^= (in ^ out) ? 0x1Du : 0;
    }
    return (uint8_t)(left ^ 0xFFu);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static const uint8_t blank[256];
    struct nr_drive_node node;
    memset(&node, 0, sizeof node);
    nr_drive_init(&node, &nr_drive_defaults, blank);
    bool cleared = false;
    uint32_t now_us = 0;
    for (; size >= RECORD; data += RECORD, size -= RECORD) {
        now_us += 6000; /* a shaft must stand for 100 ms before it can be referenced */
        const uint32_t id = (uint32_t)data[0] | (uint32_t)(data[1] & 7u) << 8;
        const size_t length = data[2] % 9u;
        const uint8_t *frame = data + 3;
        const bool valid = length == 8 && frame[7] == remainder_of(id, frame);
        const struct nr_guard before = node.guard;
        nr_drive_receive(&node, now_us, id, frame, length);
        const struct nr_guard after = node.guard;
        const uint8_t step = (uint8_t)(((frame[3] >> 4) - before.last_counter) & 15u);
        const uint16_t beats = (uint16_t)((frame[4] | (unsigned)frame[5] << 8) - before.last_heartbeat);
        const bool command = valid && id == COMMAND;
        const bool taken = command && before.sequence_seen && step >= 1 && step <= 3 && beats <= 3;
        const bool known = before.command_seen && (frame[4] | (unsigned)frame[5] << 8) == before.command.heartbeat;
        CHECK(after.torque_us == before.torque_us || (valid && id == TORQUE && (frame[3] & 15u) == 0));
        CHECK(after.sequence_seen == (before.sequence_seen || command));
        CHECK(after.foreign_us <= before.foreign_us || (command && !taken));
        CHECK(after.referenced == before.referenced || (valid && id == REFERENCE && known));
        CHECK(taken || (after.command.velocity == before.command.velocity &&
                        after.command.enable == before.command.enable &&
                        after.command_us == before.command_us && after.clear_asked == before.clear_asked));
        cleared = cleared || (taken && after.clear_asked);
        const struct nr_drive_inputs in = {.encoder_good = true};
        struct nr_drive_outputs out = {.duty = 1};
        nr_drive_tick(&node, now_us, &in, &out);
        const bool awake = node.guard.state == NR_READY || node.guard.state == NR_RUNNING;
        CHECK(out.duty == 0 || (cleared && node.guard.state == NR_RUNNING));
        CHECK(out.supply == awake && (cleared || !out.supply));
    }
    return 0;
}

size_t fuzz_seed(uint8_t *out, size_t room, uint32_t (*random)(void), uint32_t damaged, size_t *frames)
{
    uint8_t *at = out;
    *frames = SEED_RECORDS;
    for (uint32_t i = 0; i < SEED_RECORDS && (size_t)(at - out) + RECORD <= room; i++, at += RECORD) {
        const uint32_t id = i % 3 == 2 ? (i % 12 == 8 ? REFERENCE : TORQUE) : COMMAND;
        const uint32_t velocity = random() & 0x7FFFFu;
        const uint8_t record[RECORD] = {(uint8_t)id, (uint8_t)(id >> 8), 8, (uint8_t)velocity,
                                        (uint8_t)(velocity >> 8), (uint8_t)(velocity >> 16),
                                        (uint8_t)(id == TORQUE ? 0 : (i << 4) | (i == 4 ? 2u : i > 4)),
                                        (uint8_t)(id == REFERENCE && i % 24 == 8 ? i - 1 : i), 0, 0, 0};
        memcpy(at, record, RECORD);
        if (i == 4 || id == TORQUE) {
            memset(at + 3, 0, 3);
        }
        at[10] = nr_can_checksum(id, at + 3);
    }
    for (uint32_t i = 0; i < damaged; i++) {
        out[random() % (uint32_t)(at - out)] = (uint8_t)random();
    }
    return (size_t)(at - out);
}
