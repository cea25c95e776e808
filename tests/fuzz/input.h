/* What a fuzzer gives, taken number by number; zeros follow its end. */
#ifndef FUZZ_INPUT_H
#define FUZZ_INPUT_H

#include "mcp_asdf_frame.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

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

/* Frames member by member: what stands between members is nobody's. */
static inline bool same_frame(const mcp_asdf_frame_t *a, const mcp_asdf_frame_t *b)
{
    return a->id == b->id && a->flags == b->flags && a->length == b->length &&
           memcmp(a->data, b->data, sizeof a->data) == 0;
}

#endif
