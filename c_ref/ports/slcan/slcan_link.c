/* One end of a serial line that carries CAN frames. */
#include "slcan_link.h"

#include "../port.h"

/* Ends what a program before us left of a line; closes, sets 1 Mbit/s, opens. */
#define OPENING "\r\rC\rS8\rO\r"

static void count(uint16_t *counter) { *counter = (uint16_t)(*counter + (*counter < UINT16_MAX)); }

/* Put a line, with its end, behind those that wait; false, and counted, if there is no room. */
static bool put(slcan_link_t *link, const char *text, uint8_t length)
{
    const bool has_room = outbox_put(&link->outbox, text, length);
    if (!has_room) {
        count(&link->unsent);
    }
    return has_room;
}

/* Only an adapter answers: two programs that answer each other's answers would never end. */
static void answer(slcan_link_t *link, const char *text)
{
    uint8_t length = 0;
    while (text[length] != '\0') {
        ++length;
    }
    if (link->is_adapter) {
        (void)put(link, text, length);
    }
}

static void drop(slcan_link_t *link)
{
    count(&link->dropped);
    answer(link, "\a");
}

void slcan_start(slcan_link_t *link)
{
    *link = (slcan_link_t){.is_open = false};
    (void)put(link, OPENING, sizeof OPENING - 1);
}

bool slcan_send(slcan_link_t *link, const mcp_asdf_frame_t *frame)
{
    char line[SLCAN_LONGEST + 1];
    const uint8_t length = slcan_write(line, frame);
    line[length] = '\r';
    return link->is_open && length > 0 && put(link, line, length + 1);
}

/* ---- What hosts ask of an adapter ---- */

static void answer_host(slcan_link_t *link, const char *text)
{
    link->is_open &= link->is_adapter; /* what was open is the bus of an adapter that is not there */
    link->is_adapter = true;
    answer(link, text);
}

/* Bit 1: lines unsent; bit 3: lines dropped. */
static void answer_flags(slcan_link_t *link)
{
    const char *const unsent = link->dropped > 0 ? "F0A\r" : "F02\r";
    const char *const sent = link->dropped > 0 ? "F08\r" : "F00\r";
    answer(link, link->unsent > 0 ? unsent : sent);
}

static slcan_event_t open(slcan_link_t *link)
{
    const slcan_event_t event = link->is_open ? SLCAN_NOTHING : SLCAN_OPENED;
    link->is_open = true;
    return event;
}

/* The line's first character if its length is right: noise turns a T into a V by one bit. */
static char command_on(const slcan_link_t *link)
{
    if (link->length == 0) {
        return '\r';
    }
    const char first = link->line[0];
    uint8_t right = 1;
    if (first == 'S' || first == 's') {
        right = first == 'S' ? 2 : 5;
    }
    if (link->length == right) {
        return first;
    }
    return '?';
}

/* C and F may also be the end of a frame that noise has cut in two: they do not show that there is a host. */
static slcan_event_t obey(slcan_link_t *link)
{
    switch (command_on(link)) {
    case 'O':
        answer_host(link, "\r");
        link->is_open = false;
        return open(link);
    case 'S': /* bit rates are granted: there is no wire that they would matter to */
    case 's':
        answer_host(link, "\r");
        break;
    case 'V':
        answer_host(link, "V1001\r");
        break;
    case 'N':
        answer_host(link, "NASDF\r");
        break;
    case 'C':
        link->is_open &= !link->is_adapter;
        answer(link, "\r");
        break;
    case 'F':
        answer_flags(link);
        break;
    case '\r': /* an empty line: a host clears it, or an adapter agrees to the opening */
        answer(link, "\r");
        return link->is_adapter ? SLCAN_NOTHING : open(link);
    case 'z': /* an adapter has sent what we gave it */
    case 'Z':
        break;
    default:
        drop(link);
    }
    return SLCAN_NOTHING;
}

/* ---- Lines that come in ---- */

static slcan_event_t take_line(slcan_link_t *link, mcp_asdf_frame_t *frame)
{
    if (link->is_spoilt) {
        drop(link);
        return SLCAN_NOTHING;
    }
    if (!slcan_read(frame, link->line, link->length)) {
        return obey(link);
    }
    if (!link->is_open) {
        answer(link, "\a");
        return SLCAN_NOTHING;
    }
    answer(link, (frame->flags & MCP_ASDF_FRAME_STANDARD) != 0 ? "z\r" : "Z\r");
    return SLCAN_FRAME;
}

/* An adapter says so that it refuses a line; from hosts it does not come. */
static void take_bell(slcan_link_t *link)
{
    if (link->is_adapter || link->is_spoilt || link->length > 0) {
        drop(link);
    } else {
        count(&link->unsent);
    }
}

slcan_event_t slcan_take(slcan_link_t *link, int byte, mcp_asdf_frame_t *frame)
{
    slcan_event_t event = SLCAN_NOTHING;
    if (byte == PORT_NOTHING) {
        return event;
    }
    if (byte != '\r' && byte != '\a') {
        link->is_spoilt |= byte == PORT_LOST || link->length == SLCAN_LONGEST;
        if (!link->is_spoilt) {
            link->line[link->length++] = (char)byte;
        }
        return event;
    }
    if (byte == '\r') {
        event = take_line(link, frame);
    } else {
        take_bell(link);
    }
    link->length = 0;
    link->is_spoilt = false;
    return event;
}
