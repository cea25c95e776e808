/* What a compiler may call by itself. */
#include <stdint.h>

void *memset(void *to, int value, __SIZE_TYPE__ size);
void *memset(void *to, int value, __SIZE_TYPE__ size)
{
    for (uint8_t *at = to; size > 0; --size) {
        *at++ = (uint8_t)value;
    }
    return to;
}

void *memcpy(void *restrict to, const void *restrict from, __SIZE_TYPE__ size);
void *memcpy(void *restrict to, const void *restrict from, __SIZE_TYPE__ size)
{
    const uint8_t *source = from;
    for (uint8_t *at = to; size > 0; --size) {
        *at++ = *source++;
    }
    return to;
}
