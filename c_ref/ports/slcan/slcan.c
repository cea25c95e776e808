/* A serial line that carries CAN frames as lines of text; slcan.h is the manual. */
#include "slcan.h"

#include "../port.h"

#define LONG_DIGITS 8U
#define SHORT_DIGITS 3U
#define LONG_MAX UINT32_C(0x1FFFFFFF)
#define SHORT_MAX UINT32_C(0x7FF)
#define DATA_MAX 8U
#define NO_DIGIT 16U

/* ---- Lines of frames -------------------------------------------------------------------------------- */

static char *put_hex(char *to, uint32_t value, uint8_t digits)
{
    for (uint8_t left = digits; left > 0; --left) {
        *to++ = "0123456789ABCDEF"[value >> 4 * (left - 1U) & 15];
    }
    return to;
}

static uint8_t digit_of(char letter)
{
    if (letter >= '0' && letter <= '9') {
        return (uint8_t)(letter - '0');
    }
    const char capital = (char)(letter & ~0x20);
    return capital >= 'A' && capital <= 'F' ? (uint8_t)(capital - 'A' + 10) : NO_DIGIT;
}

static bool take_hex(uint32_t *value, const char *from, uint8_t digits)
{
    *value = 0;
    for (uint8_t i = 0; i < digits; ++i) {
        const uint8_t digit = digit_of(from[i]);
        if (digit == NO_DIGIT) {
            return false;
        }
        *value = *value << 4 | digit;
    }
    return true;
}

uint8_t slcan_write(char line[SLCAN_LONGEST], const mcp_asdf_frame_t *frame)
{
    const bool is_short = (frame->flags & MCP_ASDF_FRAME_STANDARD) != 0;
    const bool is_remote = (frame->flags & MCP_ASDF_FRAME_REMOTE) != 0;
    if ((frame->flags & (MCP_ASDF_FRAME_FD | MCP_ASDF_FRAME_ERROR)) != 0 || frame->length > DATA_MAX ||
        frame->id > (is_short ? SHORT_MAX : LONG_MAX)) {
        return 0;
    }
    char *to = line;
    *to++ = (is_short ? "tr" : "TR")[is_remote];
    to = put_hex(to, frame->id, is_short ? SHORT_DIGITS : LONG_DIGITS);
    to = put_hex(to, frame->length, 1);
    for (uint8_t i = 0; i < frame->length && !is_remote; ++i) {
        to = put_hex(to, frame->data[i], 2);
    }
    return (uint8_t)(to - line);
}

bool slcan_read(mcp_asdf_frame_t *frame, const char *line, uint8_t length)
{
    if (length == 0) {
        return false;
    }
    mcp_asdf_frame_t found = {0, 0, 0, {0}};
    const char kind = line[0];
    const bool is_short = kind == 't' || kind == 'r', is_remote = kind == 'r' || kind == 'R';
    const uint8_t head = 2 + (is_short ? SHORT_DIGITS : LONG_DIGITS);
    if (!(is_short || is_remote || kind == 'T') || length < head ||
        !take_hex(&found.id, line + 1, head - 2) || found.id > (is_short ? SHORT_MAX : LONG_MAX)) {
        return false;
    }
    found.flags = (is_short ? MCP_ASDF_FRAME_STANDARD : 0) | (is_remote ? MCP_ASDF_FRAME_REMOTE : 0);
    found.length = digit_of(line[head - 1]);
    const uint8_t bytes = is_remote ? 0 : found.length;
    if (found.length > DATA_MAX || length != head + 2 * bytes) {
        return false;
    }
    for (uint8_t i = 0; i < bytes; ++i) {
        uint32_t byte;
        if (!take_hex(&byte, &line[head + 2U * i], 2)) {
            return false;
        }
        found.data[i] = (uint8_t)byte;
    }
    *frame = found;
    return true;
}

/* ---- Sending ---------------------------------------------------------------------------------------- */

static void count(uint16_t *counter) { *counter = (uint16_t)(*counter + (*counter < UINT16_MAX)); }

static bool put(slcan_link_t *link, const char *text, uint8_t length)
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
    (void)put(link, "\r", 1);
}

bool slcan_send(slcan_link_t *link, const mcp_asdf_frame_t *frame)
{
    char line[SLCAN_LONGEST + 1];
    const uint8_t length = slcan_write(line, frame);
    line[length] = '\r';
    return link->is_open && length > 0 && put(link, line, length + 1);
}

/* ---- Commands ---------------------------------------------------------------------------------------- */

static void answer(slcan_link_t *link, const char *text)
{
    uint8_t length = 0;
    while (text[length] != '\0') {
        ++length;
    }
    (void)put(link, text, length);
}

/* Count the line that has come as dropped, and tell the host. */
static void drop(slcan_link_t *link)
{
    count(&link->dropped);
    answer(link, "\a");
}

/* Bit 1: lines unsent; bit 3: lines dropped. */
static void answer_flags(slcan_link_t *link)
{
    const char *const unsent = link->dropped > 0 ? "F0A\r" : "F02\r";
    const char *const sent = link->dropped > 0 ? "F08\r" : "F00\r";
    answer(link, link->unsent > 0 ? unsent : sent);
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

static slcan_event_t obey(slcan_link_t *link)
{
    switch (command_on(link)) {
    case 'O':
        answer(link, "\r");
        link->is_open = true;
        return SLCAN_OPENED;
    case 'C':
        link->is_open = false;
        answer(link, "\r");
        break;
    case 'S': /* bit rates are granted: there is no wire that they would matter to */
    case 's':
    case '\r': /* an empty line, with which hosts end what stood there before */
        answer(link, "\r");
        break;
    case 'V':
        answer(link, "V1001\r");
        break;
    case 'N':
        answer(link, "NASDF\r");
        break;
    case 'F':
        answer_flags(link);
        break;
    default:
        drop(link);
    }
    return SLCAN_NOTHING;
}

/* ---- Taking what comes in --------------------------------------------------------------------------- */

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
    } else { /* a bell, which no host sends */
        drop(link);
    }
    link->length = 0;
    link->is_spoilt = false;
    return event;
}
