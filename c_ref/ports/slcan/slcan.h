/* CAN frames as lines of text: the serial protocol of Lawicel's adapters ("slcan"), which Linux's slcand,
 * python-can and most UART-CAN adapters speak. docs/firmware_in_the_loop.md lists the commands.
 *
 * A line ends with a carriage return:
 *
 *     t123 2 0A0B           data frame: 11-bit identifier, length, bytes (without the spaces)
 *     T106BB82A 1 0A        data frame with a 29-bit identifier
 *     r123 2, R106BB82A 2   remote frames
 *
 * slcan_link_t is an adapter: it grants and answers what a host asks for. The lines that it takes and sends
 * are frames on a bus whose only nodes are the host and this one.
 *
 * Time and memory are bounded whatever comes in: a line that is malformed, too long or has lost bytes is
 * dropped, a line that finds no room to leave is dropped whole, and both are counted. Nothing waits, and
 * nothing here needs a C library, a heap or mutable static data. */
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

/* ---- Bytes that wait to leave: whole texts go in, single bytes come out ----------------------------- */

#define OUTBOX_SIZE 256U /* the bytes are counted around by one byte */

/* All zero is empty. */
typedef struct {
    char bytes[OUTBOX_SIZE];
    uint16_t waiting;
    uint8_t first;
} outbox_t;

/* Put `text` behind the others; returns false, and changes nothing, if not all of it finds room. */
static inline bool outbox_put(outbox_t *box, const char *text, uint8_t length)
{
    if (box->waiting + length > OUTBOX_SIZE) {
        return false;
    }
    for (uint8_t i = 0; i < length; ++i) {
        box->bytes[(uint8_t)(box->first + box->waiting)] = text[i];
        ++box->waiting;
    }
    return true;
}

/* Take the byte that has waited longest. Needs waiting > 0. */
static inline char outbox_take(outbox_t *box)
{
    --box->waiting;
    return box->bytes[box->first++];
}

/* ---- The adapter ------------------------------------------------------------------------------------ */

/* The counters stop at 65535.
 *   outbox    what is to be handed to port_put()
 *   dropped   lines that came in and were neither a frame nor a command
 *   unsent    lines that found no room */
typedef struct {
    outbox_t outbox;
    uint16_t dropped;
    uint16_t unsent;
    bool is_open;
    bool is_spoilt; /* the line that is coming in has lost bytes */
    uint8_t length; /* of the line so far */
    char line[SLCAN_LONGEST];
} slcan_link_t;

typedef enum {
    SLCAN_NOTHING,
    SLCAN_FRAME, /* a frame has come from the bus */
    SLCAN_OPENED /* a host has opened the bus: from now on somebody listens */
} slcan_event_t;

/* Begin, with an empty line that shows that somebody is there. Writes every member. */
void slcan_start(slcan_link_t *link);

/* Take what port_get() returned. Writes *frame if that completes one. */
slcan_event_t slcan_take(slcan_link_t *link, int byte, mcp_asdf_frame_t *frame);

/* Send a frame; returns whether it is on its way. While the bus is closed it goes nowhere. */
bool slcan_send(slcan_link_t *link, const mcp_asdf_frame_t *frame);

#endif
