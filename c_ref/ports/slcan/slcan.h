/* CAN frames as lines of text: the serial protocol of Lawicel's adapters ("slcan"), which Linux's slcand,
 * python-can and most UART-CAN adapters speak. docs/firmware_in_the_loop.md lists the commands.
 *
 * A line ends with a carriage return:
 *
 *     t123 2 0A0B           data frame: 11-bit identifier, length, bytes (without the spaces)
 *     T106BB82A 1 0A        data frame with a 29-bit identifier
 *     r123 2, R106BB82A 2   remote frames
 *
 * Nothing here needs a C library, a heap or mutable static data. */
#ifndef MCP_ASDF_PORT_SLCAN_H
#define MCP_ASDF_PORT_SLCAN_H

#include "mcp_asdf_frame.h"

#include <stdbool.h>

#define SLCAN_LONGEST 26U /* characters of a line without its end: T, 8 digits, the length, 16 digits */

/* Write the line of a frame, without its end and without a terminating zero. Returns the number of
 * characters, 5 .. 26; 0 if it has none: FD and error frames, identifiers or lengths that are too large.
 * O(1). */
uint8_t slcan_write(char line[SLCAN_LONGEST], const mcp_asdf_frame_t *frame);

/* Read the frame of a line of `length` characters without its end; letters may be small. Returns whether it
 * is one: any other text leaves *frame as it was. O(1). */
bool slcan_read(mcp_asdf_frame_t *frame, const char *line, uint8_t length);

#endif
