/* Calls for programs that drive many robots: one of them takes the place of many from Python. */
#ifndef MCP_ASDF_MESSAGES_H
#define MCP_ASDF_MESSAGES_H

#include <stddef.h>
#include <stdint.h>

#include "mcp_asdf.h"

/* Hands over messages one after the other, three words each: sender, x_hat, alpha. Returns how many the robot
 * accepted. O(count). */
static inline size_t mcp_asdf_receive_all(mcp_asdf_t *robot, const uint32_t *messages, size_t count)
{
    size_t accepted = 0;
    for (size_t i = 0; i < count; ++i, messages += 3)
        accepted += mcp_asdf_receive(robot, (uint8_t)(messages[0] < 255 ? messages[0] : 255), messages[1],
                                     messages[2]) == MCP_ASDF_OK;
    return accepted;
}

#endif
