/* Fuzz targets, one a decoder. Each stops the program when what it feeds is taken for more than it is. */
#ifndef FUZZ_H
#define FUZZ_H

#include <stddef.h>
#include <stdint.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

/* An input made of good frames with `damaged` bytes changed; gives its length and the frames in it. */
size_t fuzz_seed(uint8_t *out, size_t room, uint32_t (*random)(void), uint32_t damaged, size_t *frames);

#define CHECK(holds) \
    do { \
        if (!(holds)) { \
            __builtin_trap(); \
        } \
    } while (0)

#endif
