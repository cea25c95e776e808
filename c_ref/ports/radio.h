/* A radio that carries frames, as demo.c uses it. packet_radio.c is one, for any modem on the serial line. */
#ifndef MCP_ASDF_RADIO_H
#define MCP_ASDF_RADIO_H

#include "mcp_asdf_frame.h"

#include <stdbool.h>

/* Send a frame. Waits until the serial line has accepted all of it. */
void radio_send(const mcp_asdf_frame_t *frame);

/* Handle a byte that the serial line has received. The board calls this for each one, also from an interrupt.
 */
void radio_receive_byte(uint8_t byte);

/* Remove the oldest received frame from the queue, and write it to *frame. Returns whether there was one. Not
 * for interrupts. */
bool radio_next_frame(mcp_asdf_frame_t *frame);

/* Number of packets lost so far, modulo 256: damaged, or received while the queue was full. */
uint8_t radio_lost_packets(void);

#endif
