/* The deterministic run of one target: `million FRAMES SEED` feeds it good frames with damage done to them. */
#include "fuzz.h"

#include <stdio.h>
#include <stdlib.h>

static uint32_t state;

static uint32_t xorshift(void)
{
    state ^= state << 13;
    state ^= state >> 17;
    state ^= state << 5;
    return state;
}

int main(int count, char **words)
{
    const size_t wanted = count > 1 ? strtoul(words[1], NULL, 10) : 1000000;
    state = (uint32_t)(count > 2 ? strtoul(words[2], NULL, 10) : 1) | 1u;
    uint8_t input[512];
    size_t done = 0;
    while (done < wanted) {
        size_t frames = 0;
        const size_t size = fuzz_seed(input, sizeof input, xorshift, xorshift() % 6, &frames);
        (void)LLVMFuzzerTestOneInput(input, size);
        done += frames;
    }
    printf("%zu frames\n", done);
    return 0;
}
