/* CAN frames as lines of text: the serial protocol of Lawicel's adapters ("slcan"), which Linux's slcand,
 * python-can and most UART-CAN adapters speak. docs/platforms/serial.md lists the commands.
 *
 * A line ends with a carriage return:
 *
 *     t123 2 0A0B           data frame: 11-bit identifier, length, bytes (without the spaces)
 *     T106BB82A 1 0A        data frame with a 29-bit identifier
 *     r123 2, R106BB82A 2   remote frames
 *
 * slcan_link_t is an adapter: it carries out and answers a host's commands. To the host it looks like a bus
 * whose only other node is this one: lines with frames are what the two send to each other.
 *
 * Time and memory are bounded whatever comes in: a line that is malformed, too long or incomplete is dropped,
 * a line that finds no room in the outbox is dropped whole, and both are counted. Nothing waits, and nothing
 * here needs a C library, a heap or mutable static data. */
#ifndef MCP_ASDF_PORT_SLCAN_H
#define MCP_ASDF_PORT_SLCAN_H

#include "mcp_asdf_frame.h"

#include <stdbool.h>

#define SLCAN_LINE_MAX 26U /* characters of a line without its end: T, 8 digits, the length, 16 digits */

/* Write a frame as a line, without its end and without a terminating zero. Returns the number of characters,
 * 5 .. 26; 0 if there is no line for the frame: an FD or error frame, or an identifier or length that is too
 * large. O(1). */
uint8_t slcan_format_frame(char line[SLCAN_LINE_MAX], const mcp_asdf_frame_t *frame);

/* Read a frame from a line of `length` characters, without its end; hexadecimal letters may be small. Returns
 * whether the line is a frame; if not, *frame is unchanged. O(1). */
bool slcan_parse_frame(mcp_asdf_frame_t *frame, const char *line, uint8_t length);

/* ---- Outbox: queue of bytes to send, to which whole texts are added ------------------------------------ */

#define OUTBOX_SIZE 256U /* a uint8_t index into the ring of bytes wraps by itself */

/* An outbox that is all zero is empty.
 *   byte_count     bytes that wait, 0 .. OUTBOX_SIZE
 *   oldest_index   position of the byte that has waited longest */
typedef struct {
    char bytes[OUTBOX_SIZE];
    uint16_t byte_count;
    uint8_t oldest_index;
} outbox_t;

/* Add a text of `length` characters to the end of the queue. Returns false, and changes nothing, if there is
 * no room for all of it. */
static inline bool outbox_put(outbox_t *outbox, const char *text, uint8_t length)
{
    if (outbox->byte_count + length > OUTBOX_SIZE) {
        return false;
    }
    for (uint8_t i = 0; i < length; ++i) {
        /* The conversion wraps the index at 256, the size of the ring. */
        const uint8_t end_index = (uint8_t)(outbox->oldest_index + outbox->byte_count);
        outbox->bytes[end_index] = text[i];
        ++outbox->byte_count;
    }
    return true;
}

/* Remove and return the byte that has waited longest. The outbox must not be empty. */
static inline char outbox_take(outbox_t *outbox)
{
    const char oldest_byte = outbox->bytes[outbox->oldest_index];
    ++outbox->oldest_index; /* a uint8_t: wraps at 256, the size of the ring */
    --outbox->byte_count;
    return oldest_byte;
}

/* ---- The adapter ------------------------------------------------------------------------------------ */

/* State of the adapter. The counters stop at 65535.
 *   outbox            bytes for port_put()
 *   dropped_lines     received lines that were neither a frame nor a command
 *   unsent_lines      lines that found no room in the outbox
 *   is_open           whether the host has opened the bus
 *   is_line_damaged   whether the line that is being received has lost bytes or is too long
 *   line_length       characters received of this line */
typedef struct {
    outbox_t outbox;
    uint16_t dropped_lines;
    uint16_t unsent_lines;
    bool is_open;
    bool is_line_damaged;
    uint8_t line_length;
    char line[SLCAN_LINE_MAX];
} slcan_link_t;

typedef enum {
    SLCAN_NOTHING,
    SLCAN_FRAME, /* a frame has been received */
    SLCAN_OPENED /* a host has opened the bus: from now on it receives */
} slcan_event_t;

/* Initialise the adapter with a closed bus, and queue an empty line that shows a host that it is there. */
void slcan_start(slcan_link_t *link);

/* Handle a byte that port_get() returned, or its PORT_NOTHING or PORT_LOST. The end of a line carries out its
 * command, or completes a frame, which is written to *frame; the answer is queued. */
slcan_event_t slcan_handle_byte(slcan_link_t *link, int byte, mcp_asdf_frame_t *frame);

/* Queue a frame. Returns whether it will be sent: not if the bus is closed, the outbox is full, or the
 * frame has no line. */
bool slcan_send_frame(slcan_link_t *link, const mcp_asdf_frame_t *frame);

#endif
