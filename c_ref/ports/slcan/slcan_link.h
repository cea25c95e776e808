/* One end of a serial line that carries CAN frames as lines of text (slcan.h), whichever end it is:
 *
 *   with an adapter   At start it tells the adapter to open its bus. Lines are frames on that bus.
 *   as an adapter     The first command that only hosts send makes it one, which grants and answers what
 * hosts ask for. Lines are frames on a bus whose only nodes are the host and this program.
 *
 * Time and memory are bounded whatever comes in: a line that is malformed, too long or has lost bytes is
 * dropped, a line that finds no room to leave is dropped whole, and both are counted. Nothing waits. No C
 * library is needed. */
#ifndef MCP_ASDF_PORT_SLCAN_LINK_H
#define MCP_ASDF_PORT_SLCAN_LINK_H

#include "outbox.h"
#include "slcan.h"

/* The counters stop at 65535.
 *   outbox    what is to be handed to port_put()
 *   dropped   lines that came in and were neither a frame nor a command
 *   unsent    lines that found no room, and those that an adapter refused */
typedef struct {
    outbox_t outbox;
    uint16_t dropped;
    uint16_t unsent;
    bool is_adapter;
    bool is_open;
    bool is_spoilt; /* the line that is coming in has lost bytes */
    uint8_t length; /* of the line so far */
    char line[SLCAN_LONGEST];
} slcan_link_t;

typedef enum {
    SLCAN_NOTHING,
    SLCAN_FRAME, /* a frame has come from the bus */
    SLCAN_OPENED /* a host has opened the bus, or an adapter was found: from now on somebody listens */
} slcan_event_t;

/* Begin: ask for an adapter. Writes every member. */
void slcan_start(slcan_link_t *link);

/* Take what port_get() returned. Writes *frame if that completes one. */
slcan_event_t slcan_take(slcan_link_t *link, int byte, mcp_asdf_frame_t *frame);

/* Send a frame; returns whether it is on its way. While the bus is closed it goes nowhere. */
bool slcan_send(slcan_link_t *link, const mcp_asdf_frame_t *frame);

/* ---- Between slcan_link.c and slcan_commands.c ---- */

/* Put a line, with its end, behind those that wait; false, and counted, if there is no room. */
bool slcan_put(slcan_link_t *link, const char *text, uint8_t length);

/* Tell a host; with an adapter at the other end say nothing. */
void slcan_answer(slcan_link_t *link, const char *text);

/* Count the line that has come as dropped, and tell a host. */
void slcan_drop(slcan_link_t *link);

/* Do what the line that has come asks for, which is no frame. */
slcan_event_t slcan_obey(slcan_link_t *link);

#endif
