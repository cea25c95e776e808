/* What the white-box tests share: the core itself, with its static functions in reach. Expected values come
 * from formulas of docs/design.md, computed plainly in the widest type at hand, never from the core. */
#ifndef WHITE_BOX_H
#define WHITE_BOX_H

#include "check.h"

#include <string.h>

#ifdef TEST_DIVIDE /* this variant, whatever the build as a whole has chosen */
#undef MCP_ASDF_DIVIDE
#define MCP_ASDF_DIVIDE TEST_DIVIDE
#endif
#ifdef TEST_SPLIT_MULTIPLY
#undef MCP_ASDF_SPLIT_MULTIPLY
#define MCP_ASDF_SPLIT_MULTIPLY TEST_SPLIT_MULTIPLY
#endif
#ifdef TEST_SHIFT_BYTES
#undef MCP_ASDF_SHIFT_BYTES
#define MCP_ASDF_SHIFT_BYTES TEST_SHIFT_BYTES
#endif
#ifdef TEST_HAS_CLZ
#undef MCP_ASDF_HAS_CLZ
#define MCP_ASDF_HAS_CLZ TEST_HAS_CLZ
#endif

#if MCP_ASDF_DIVIDE == 4 /* the engine's own */
#include "lanes_arithmetic.h"
#endif
#include "mcp_asdf.c"

#define C_MIN MCP_ASDF_B_HAT_MIN
#define ALPHA_MAX_UNITS ((UINT64_C(1) << 55) - (UINT64_C(1) << 31))
#define MOST 127 /* messages in a round */

/* A random number below limit > 0, small ones as likely as large ones. */
static inline uint32_t random_below(uint32_t limit) { return check_random_word() % limit; }

/* A robot whose every byte, padding too, was written by init or is 0xA5. */
static inline mcp_asdf_t robot_with(const mcp_asdf_config_t *config, uint8_t id, uint32_t b_hat)
{
    mcp_asdf_t robot;
    memset(&robot, 0xA5, sizeof robot);
    CHECK_EQUAL(mcp_asdf_init(&robot, config, id, b_hat), MCP_ASDF_OK);
    return robot;
}

#endif
