/* Frames member by member: what stands between members is nobody's. */
#ifndef FUZZ_SAME_FRAME_H
#define FUZZ_SAME_FRAME_H

#include "mcp_asdf_frame.h"

#include <stdbool.h>
#include <string.h>

static inline bool same_frame(const mcp_asdf_frame_t *a, const mcp_asdf_frame_t *b)
{
    return a->id == b->id && a->flags == b->flags && a->length == b->length &&
           memcmp(a->data, b->data, sizeof a->data) == 0;
}

#endif
