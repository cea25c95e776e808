/* The lines of CAN frames, both ways. */
#include "slcan.h"

#define LONG_DIGITS 8U
#define SHORT_DIGITS 3U
#define LONG_MAX UINT32_C(0x1FFFFFFF)
#define SHORT_MAX UINT32_C(0x7FF)
#define DATA_MAX 8U
#define NO_DIGIT 16U

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
