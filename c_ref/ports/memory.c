/* The two functions that a compiler may call by itself, for images without a C library. The pointers are
 * volatile so that it does not make a call of memcpy() out of the loop inside memcpy(). */
#include <stddef.h>

void *memcpy(void *restrict to, const void *restrict from, size_t size);
void *memset(void *to, int value, size_t size);

void *memcpy(void *restrict to, const void *restrict from, size_t size)
{
    volatile unsigned char *target = to;
    for (const unsigned char *source = from; size > 0; --size) {
        *target++ = *source++;
    }
    return to;
}

void *memset(void *to, int value, size_t size)
{
    for (volatile unsigned char *target = to; size > 0; --size) {
        *target++ = (unsigned char)value;
    }
    return to;
}
