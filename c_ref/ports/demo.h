/* Functions that the robot of demo.c needs from its board, beside port.h and a radio. A board is
 * avr/demo_atmega.c. */
#ifndef MCP_ASDF_DEMO_H
#define MCP_ASDF_DEMO_H

#include "mcp_asdf.h"

/* Switch on sensor, clock and the receiving side of the serial line, whose bytes go to radio_hear(). */
void board_start(void);

/* Whether a control tick, a tenth of a second, has begun since the last call. Does not wait. */
bool board_tick(void);

/* Look at the floor: whether the ground sensor can tell the colour of the tile, which then is in *tile. */
bool board_sees(mcp_asdf_observation_t *tile);

#endif
