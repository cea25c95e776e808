/* The two functions that a compiler may call by itself, for images without a C library. The pointers are
 * volatile: else a compiler could replace the loop inside memcpy() by a call of memcpy(). */
#include <stddef.h>

void *memcpy(void *restrict to, const void *restrict from, size_t size);
void *memset(void *to, int value, size_t size);

/* Copy `size` bytes, byte by byte; see the C standard. */
void *memcpy(void *restrict to, const void *restrict from, size_t size)
{
    volatile unsigned char *target = to;
    for (const unsigned char *source = from; size > 0; --size) {
        *target++ = *source++;
    }
    return to;
}

/* Fill `size` bytes with a value; see the C standard. */
void *memset(void *to, int value, size_t size)
{
    for (volatile unsigned char *target = to; size > 0; --size) {
        *target++ = (unsigned char)value;
    }
    return to;
}
