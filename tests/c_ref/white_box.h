/* What the white-box tests share: the core itself, with its static functions in reach. Expected values come
 * from formulas of docs/design.md, computed plainly in the widest type at hand, never from the core. */
#ifndef WHITE_BOX_H
#define WHITE_BOX_H

#include "check.h"

#include <string.h>

#if MCP_ASDF_DIVIDE == 4 /* the engine's own */
#include "lanes_arithmetic.h"
#endif
#include "mcp_asdf.c"

#define C_MIN MCP_ASDF_B_HAT_MIN
#define ALPHA_MAX_UNITS ((UINT64_C(1) << 55) - (UINT64_C(1) << 31))
#define MOST 127 /* messages in a round */

/* A robot whose every byte, padding too, was written by init or is 0xA5. */
static inline mcp_asdf_t robot_with(const mcp_asdf_config_t *config, uint8_t id, uint32_t b_hat)
{
    mcp_asdf_t robot;
    memset(&robot, 0xA5, sizeof robot);
    CHECK_EQUAL(mcp_asdf_init(&robot, config, id, b_hat), MCP_ASDF_OK);
    return robot;
}

#endif
