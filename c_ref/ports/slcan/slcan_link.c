/* One end of a serial line that carries CAN frames. */
#include "slcan_link.h"

#include "../port.h"

/* Ends what a program before us left of a line; closes, sets 1 Mbit/s, opens. */
#define OPENING "\r\rC\rS8\rO\r"

static void count(uint16_t *counter) { *counter = (uint16_t)(*counter + (*counter < UINT16_MAX)); }

bool slcan_put(slcan_link_t *link, const char *text, uint8_t length)
{
    const bool has_room = outbox_put(&link->outbox, text, length);
    if (!has_room) {
        count(&link->unsent);
    }
    return has_room;
}

void slcan_start(slcan_link_t *link)
{
    *link = (slcan_link_t){.is_open = false};
    (void)slcan_put(link, OPENING, sizeof OPENING - 1);
}

bool slcan_send(slcan_link_t *link, const mcp_asdf_frame_t *frame)
{
    char line[SLCAN_LONGEST + 1];
    const uint8_t length = slcan_write(line, frame);
    line[length] = '\r';
    return link->is_open && length > 0 && slcan_put(link, line, length + 1);
}

void slcan_drop(slcan_link_t *link)
{
    count(&link->dropped);
    slcan_answer(link, "\a");
}

static slcan_event_t take_line(slcan_link_t *link, mcp_asdf_frame_t *frame)
{
    if (link->is_spoilt) {
        slcan_drop(link);
        return SLCAN_NOTHING;
    }
    if (!slcan_read(frame, link->line, link->length)) {
        return slcan_obey(link);
    }
    if (!link->is_open) {
        slcan_answer(link, "\a");
        return SLCAN_NOTHING;
    }
    slcan_answer(link, (frame->flags & MCP_ASDF_FRAME_STANDARD) != 0 ? "z\r" : "Z\r");
    return SLCAN_FRAME;
}

/* An adapter says so that it refuses a line; from hosts it does not come. */
static void take_bell(slcan_link_t *link)
{
    if (link->is_adapter || link->is_spoilt || link->length > 0) {
        slcan_drop(link);
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
