#include <stddef.h>
#include <stdint.h>
#include <string.h>

/* The three that compilers call by themselves. */

void *memcpy(void *restrict to, const void *restrict from, size_t length)
{
    uint8_t *t = to;
    const uint8_t *f = from;
    while (length--) {
        *t++ = *f++;
    }
    return to;
}

void *memset(void *to, int value, size_t length)
{
    uint8_t *t = to;
    while (length--) {
        *t++ = (uint8_t)value;
    }
    return to;
}

int memcmp(const void *a, const void *b, size_t length)
{
    const uint8_t *x = a;
    const uint8_t *y = b;
    for (; length--; x++, y++) {
        if (*x != *y) {
            return *x - *y;
        }
    }
    return 0;
}
