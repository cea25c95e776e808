/* What a robot's main loop needs of its radio. esp_now.c and crazyflie.c have these functions. */
#ifndef MCP_ASDF_ROBOT_RADIO_H
#define MCP_ASDF_ROBOT_RADIO_H

#include "mcp_asdf.h"

/* Begin to receive. Call it once, before the other two. */
void radio_start(void);

/* Send x_hat and alpha to all robots in range. Does not wait; a message that cannot be sent is lost. */
void radio_broadcast(const mcp_asdf_t *robot);

/* Let the robot receive all messages that have come since the last call. */
void radio_receive(mcp_asdf_t *robot);

#endif
