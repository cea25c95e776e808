/* The two functions that a compiler may call by itself, for images without a C library. The targets are
 * volatile: else a compiler would recognise the loops, and could replace the loop in memcpy() by a call of
 * memcpy(), which is endless recursion. */
#include <stddef.h>

void *memcpy(void *restrict to, const void *restrict from, size_t size);
void *memset(void *to, int value, size_t size);

/* Copy `size` bytes between areas that do not overlap. Returns `to`. See the C standard. */
void *memcpy(void *restrict to, const void *restrict from, size_t size)
{
    volatile unsigned char *target = to;
    for (const unsigned char *source = from; size > 0; --size) {
        *target++ = *source++;
    }
    return to;
}

/* Fill `size` bytes with the lowest 8 bits of a value. Returns `to`. See the C standard. */
void *memset(void *to, int value, size_t size)
{
    for (volatile unsigned char *target = to; size > 0; --size) {
        *target++ = (unsigned char)value;
    }
    return to;
}
