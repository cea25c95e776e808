/* Functions that the robot of demo.c needs from its board, beside port.h and a radio. A board is
 * avr/demo_atmega.c. */
#ifndef MCP_ASDF_DEMO_H
#define MCP_ASDF_DEMO_H

#include "mcp_asdf.h"

/* Switch on the sensor, the clock and the receiving side of the serial line. From now on the board passes
 * received bytes to radio_receive_byte(). */
void board_start(void);

/* Whether a control tick, a tenth of a second, has begun since the last call. Does not wait. */
bool board_has_tick_begun(void);

/* Read the ground sensor. Returns whether it recognises the colour of the tile, which is then in *tile. */
bool board_read_tile(mcp_asdf_observation_t *tile);

#endif
