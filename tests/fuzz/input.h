/* What a fuzzer gives, taken number by number; zeros follow its end. */
#ifndef FUZZ_INPUT_H
#define FUZZ_INPUT_H

#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

/* An oracle: a fuzzer keeps the input for which it does not hold. */
#define MUST(condition)                                                                                      \
    do {                                                                                                     \
        if (!(condition)) {                                                                                  \
            (void)fprintf(stderr, "%s:%d: not so: %s\n", __FILE__, __LINE__, #condition);                    \
            abort();                                                                                         \
        }                                                                                                    \
    } while (0)

typedef struct {
    const uint8_t *bytes;
    size_t left;
} input_t;

static inline uint32_t input_take(input_t *input, int bytes)
{
    uint32_t value = 0;
    for (int i = 0; i < bytes && input->left > 0; ++i, --input->left) {
        value |= (uint32_t)*input->bytes++ << 8 * i;
    }
    return value;
}

/* Any word; those beside powers of two and the ends in two bytes. */
static inline uint32_t input_word(input_t *input)
{
    const uint32_t kind = input_take(input, 1), bit = UINT32_C(1) << (kind >> 3);
    switch (kind & 7) {
    case 0:
        return input_take(input, 4);
    case 1:
        return bit - 1;
    case 2:
        return bit;
    case 3:
        return bit + 1;
    case 4:
        return input_take(input, 1);
    case 5:
        return 0 - input_take(input, 1);
    case 6:
        return input_take(input, 3);
    default:
        return input_take(input, 2) << 16;
    }
}

#endif
