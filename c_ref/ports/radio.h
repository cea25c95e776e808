/* A radio that carries frames, as demo.c uses it. packet_radio.c is one, for any modem on the serial line. */
#ifndef MCP_ASDF_RADIO_H
#define MCP_ASDF_RADIO_H

#include "mcp_asdf_frame.h"

#include <stdbool.h>

/* Send a frame; waits until the serial line has taken it. */
void radio_send(const mcp_asdf_frame_t *frame);

/* Called by the board for every byte that the serial line receives, from an interrupt if it likes. */
void radio_hear(uint8_t byte);

/* Take the oldest frame that is waiting; returns whether there was one. Not from an interrupt. */
bool radio_take(mcp_asdf_frame_t *frame);

/* Packets lost so far, modulo 256: damaged, or come while the queue was full. */
uint8_t radio_lost(void);

#endif
