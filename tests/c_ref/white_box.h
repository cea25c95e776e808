/* What the white-box tests share: the core itself, with its static functions in reach. Values in tests come
 * from formulas of docs/design.md in the widest type at hand, not from the core. */
#ifndef WHITE_BOX_H
#define WHITE_BOX_H

#include "check.h"

#include <string.h>

#if TEST_WITHOUT_CLZ /* the portable leading_zeros(), which a host would not use */
#ifdef __clang__
#pragma clang diagnostic ignored "-Wbuiltin-macro-redefined"
#endif
#undef __x86_64__
#undef __i386__
#undef __ARM_FEATURE_CLZ
#endif

#ifdef TEST_HARDWARE_DIVIDE /* this variant, whatever the build as a whole has chosen */
#undef MCP_ASDF_HARDWARE_DIVIDE
#define MCP_ASDF_HARDWARE_DIVIDE TEST_HARDWARE_DIVIDE
#endif
#ifdef TEST_SPLIT_MULTIPLY
#undef MCP_ASDF_SPLIT_MULTIPLY
#define MCP_ASDF_SPLIT_MULTIPLY TEST_SPLIT_MULTIPLY
#endif
#ifdef TEST_EIGHT_BIT
#undef MCP_ASDF_EIGHT_BIT
#define MCP_ASDF_EIGHT_BIT TEST_EIGHT_BIT
#endif

#include "mcp_asdf.c"

#define TOTAL_MIN (UINT32_C(1) << 30) /* t as estimate() normalises it */
#define TOTAL_MAX (UINT32_MAX >> 1)
#define C_MAX (UINT32_C(0x80000000) - (INFORMATIVE_G >> 1)) /* the largest c that says something */

static mcp_asdf_config_t white_box_config = {0, 1, 1000, MCP_ASDF_MEMORY_MAX, MCP_ASDF_OFF};

/* What a robot keeps for b_hat; every member is written. */
static inline mcp_asdf_accuracy_t accuracy_of(uint32_t b_hat)
{
    mcp_asdf_accuracy_t accuracy;
    memset(&accuracy, 0xA5, sizeof accuracy);
    set_accuracy(&accuracy, b_hat);
    return accuracy;
}

/* A robot with these observations behind it. */
static inline mcp_asdf_t robot_at(uint32_t t, uint32_t n, uint32_t b_hat)
{
    mcp_asdf_t robot;
    memset(&robot, 0xA5, sizeof robot);
    CHECK_EQUAL(mcp_asdf_init(&robot, &white_box_config, 0, b_hat), MCP_ASDF_OK);
    robot.t = t;
    robot.n = n;
    return robot;
}

/* x_hat and alpha from the robot's own t and n. */
static inline void estimate_own(mcp_asdf_t *robot) { estimate(robot, robot->t, robot->n); }

#endif
