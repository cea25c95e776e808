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

#include "mcp_asdf.c"

#define C_MIN MCP_ASDF_B_HAT_MIN
#define C_MAX (ONE_HALF - (INFORMATIVE >> 1)) /* the largest c that says something */
#define ALPHA_MAX UINT32_C(0xFFFFFF1F)        /* the word of the largest confidence, 2^31 - 2^7 */
#define ALPHA_MAX_UNITS ((UINT64_C(1) << 55) - (UINT64_C(1) << 31))
#define ALPHA_ONE UINT32_C(0x80000001) /* the word of 1.0 */
#define MOST 127                       /* messages in a round */

static const mcp_asdf_config_t white_box_config = {0, 1, MCP_ASDF_MEMORY_MAX, MCP_ASDF_OFF};

/* A random number below limit > 0, small ones as likely as large ones. */
static inline uint32_t random_below(uint32_t limit) { return check_random_word() % limit; }

/* Leading zeros of a word, one by one; 31 for 0. */
static inline uint32_t plain_zeros(uint32_t value)
{
    uint32_t zeros = 0;
    while (zeros < 31 && (value << zeros & UINT32_C(0x80000000)) == 0) {
        ++zeros;
    }
    return zeros;
}

/* A robot whose every byte, padding too, was written by init or is 0xA5. */
static inline mcp_asdf_t robot_with(const mcp_asdf_config_t *config, uint8_t id, uint32_t b_hat)
{
    mcp_asdf_t robot;
    memset(&robot, 0xA5, sizeof robot);
    CHECK_EQUAL(mcp_asdf_init(&robot, config, id, b_hat), MCP_ASDF_OK);
    return robot;
}

/* A robot with these observations behind it, whose x_hat and alpha are those of t > 0 and n. */
static inline mcp_asdf_t robot_at(uint32_t t, uint32_t n, uint32_t b_hat)
{
    mcp_asdf_t robot = robot_with(&white_box_config, 0, b_hat);
    const message_t own = estimate(t, n, &robot.accuracy);
    robot.t = t;
    robot.n = n;
    robot.x_hat = own.x_hat;
    robot.alpha = own.alpha;
    return robot;
}

#endif
