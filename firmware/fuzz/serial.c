/* Bytes of the serial line into the frame decoder. What it takes must be the one encoding of what it gives. */
#include "../core/nr_frame.h"
#include "fuzz.h"

#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    uint8_t content[NR_COBS_MAX_CONTENT];
    uint8_t again[NR_COBS_MAX_FRAME];
    const size_t length = nr_frame_decode(data, size, content, sizeof content);
    CHECK(length <= sizeof content);
    if (length > 0) {
        CHECK(nr_frame_encode(content, length, again, sizeof again) == size + 1);
        CHECK(memcmp(again, data, size) == 0 && again[size] == 0);
    }
    const size_t sent = size < sizeof content ? size : sizeof content;
    const size_t stuffed = nr_frame_encode(data, sent, again, sizeof again);
    CHECK(stuffed == sent + 4 && memchr(again, 0, stuffed) == again + stuffed - 1);
    if (sent > 0) {
        CHECK(nr_frame_decode(again, stuffed - 1, content, sizeof content) == sent);
        CHECK(memcmp(content, data, sent) == 0);
    }
    return 0;
}

size_t fuzz_seed(uint8_t *out, size_t room, uint32_t (*random)(void), uint32_t damaged, size_t *frames)
{
    uint8_t content[NR_COBS_MAX_CONTENT];
    const size_t length = 1 + random() % sizeof content;
    for (size_t i = 0; i < length; i++) {
        content[i] = (uint8_t)(random() % 4 ? random() : 0);
    }
    *frames = 1;
    const size_t size = nr_frame_encode(content, length, out, room) - 1;
    for (uint32_t i = 0; i < damaged; i++) {
        out[random() % (uint32_t)size] = (uint8_t)random();
    }
    return damaged % 3 == 2 ? random() % (uint32_t)size : size;
}
