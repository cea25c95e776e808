/* A serial line that carries CAN frames as lines of text; slcan.h is the manual. */
#include "slcan.h"

#include "../port.h"

#define EXTENDED_ID_DIGITS 8U
#define STANDARD_ID_DIGITS 3U
#define EXTENDED_ID_MAX UINT32_C(0x1FFFFFFF)
#define STANDARD_ID_MAX UINT32_C(0x7FF)
#define DATA_LENGTH_MAX 8U
#define NO_DIGIT 16U
#define STATUS_UNSENT (1U << 1) /* flags of the answer to F: the adapters' "transmit queue full" */
#define STATUS_DROPPED (1U << 3)

/* ---- Lines of frames -------------------------------------------------------------------------------- */

/* Write the lowest `digit_count` hexadecimal digits of `value` to `text`, in capitals, the highest of them
 * first and without a terminating zero. Returns the address after the last one. */
static char *write_hex(char *text, uint32_t value, uint8_t digit_count)
{
    for (uint8_t digits_left = digit_count; digits_left > 0; --digits_left) {
        const uint32_t shift = 4 * (digits_left - 1U); /* of 4 bits a digit, those of the digits behind it */
        const uint32_t digit = (value >> shift) & 0xF;
        *text++ = "0123456789ABCDEF"[digit];
    }
    return text;
}

/* Returns the value of a hexadecimal digit, 0 .. 15, or NO_DIGIT for any other character. */
static uint8_t parse_digit(char letter)
{
    if (letter >= '0' && letter <= '9') {
        return (uint8_t)(letter - '0');
    }
    const char capital = (char)(letter & ~0x20); /* a small letter is the capital with this bit set */
    return capital >= 'A' && capital <= 'F' ? (uint8_t)(capital - 'A' + 10) : NO_DIGIT;
}

/* Read a number of up to 8 hexadecimal digits into *value. Returns false if a character is no digit; *value
 * is then of no use. */
static bool parse_hex(uint32_t *value, const char *text, uint8_t digit_count)
{
    *value = 0;
    for (uint8_t i = 0; i < digit_count; ++i) {
        const uint8_t digit = parse_digit(text[i]);
        if (digit == NO_DIGIT) {
            return false;
        }
        *value = (*value << 4) | digit;
    }
    return true;
}

/* Returns the letter with which the line of a frame begins: a small one for an 11-bit identifier. */
static char kind_of_line(bool is_standard, bool is_remote)
{
    if (is_remote) {
        return is_standard ? 'r' : 'R';
    }
    return is_standard ? 't' : 'T';
}

/* Write `frame` to `line` as text, without the carriage return that ends a line. Returns the number of
 * characters; 0, with nothing written, for an FD or error frame and for an id or a length out of range. */
uint8_t slcan_format_frame(char line[SLCAN_LINE_MAX], const mcp_asdf_frame_t *frame)
{
    const bool is_standard = (frame->flags & MCP_ASDF_FRAME_STANDARD) != 0;
    const bool is_remote = (frame->flags & MCP_ASDF_FRAME_REMOTE) != 0;
    const bool is_fd_or_error = (frame->flags & (MCP_ASDF_FRAME_FD | MCP_ASDF_FRAME_ERROR)) != 0;
    const uint32_t id_max = is_standard ? STANDARD_ID_MAX : EXTENDED_ID_MAX;
    if (is_fd_or_error || frame->length > DATA_LENGTH_MAX || frame->id > id_max) {
        return 0;
    }
    char *end = line;
    *end++ = kind_of_line(is_standard, is_remote);
    end = write_hex(end, frame->id, is_standard ? STANDARD_ID_DIGITS : EXTENDED_ID_DIGITS);
    end = write_hex(end, frame->length, 1);
    if (!is_remote) { /* remote frames have a length, but no data */
        for (uint8_t i = 0; i < frame->length; ++i) {
            end = write_hex(end, frame->data[i], 2);
        }
    }
    return (uint8_t)(end - line);
}

/* Convert the hexadecimal digits of a frame's data, and write its `byte_count` bytes to `data`. A byte has
 * two digits. Returns false if one of the characters is no digit; `data` is then of no use. */
static bool parse_data(uint8_t *data, const char *digits, uint8_t byte_count)
{
    for (uint8_t i = 0; i < byte_count; ++i) {
        uint32_t byte;
        if (!parse_hex(&byte, digits, 2)) {
            return false;
        }
        data[i] = (uint8_t)byte;
        digits += 2;
    }
    return true;
}

/* Returns the flags of a frame by the letter with which its line begins. */
static uint8_t flags_of_kind(char kind)
{
    uint8_t flags = 0;
    if (kind == 't' || kind == 'r') {
        flags |= MCP_ASDF_FRAME_STANDARD;
    }
    if (kind == 'r' || kind == 'R') {
        flags |= MCP_ASDF_FRAME_REMOTE;
    }
    return flags;
}

/* Convert the header of a line of `length` characters to the flags, the id and the length of *frame. A header
 * is a letter for the kind, the id in 3 or 8 hexadecimal digits, and a digit for the number of bytes. Returns
 * how many characters it has, or 0 if the line does not begin with one; *frame is then of no use. */
static uint8_t parse_header(mcp_asdf_frame_t *frame, const char *line, uint8_t length)
{
    if (length == 0) {
        return 0;
    }
    const char kind = line[0];
    frame->flags = flags_of_kind(kind);
    if (frame->flags == 0 && kind != 'T') { /* a data frame with a 29-bit identifier has no flags */
        return 0;
    }
    const bool is_standard = (frame->flags & MCP_ASDF_FRAME_STANDARD) != 0;
    const uint8_t id_digits = is_standard ? STANDARD_ID_DIGITS : EXTENDED_ID_DIGITS;
    const uint32_t id_max = is_standard ? STANDARD_ID_MAX : EXTENDED_ID_MAX;
    const uint8_t header_length = 1 + id_digits + 1;
    const bool has_id =
        length >= header_length && parse_hex(&frame->id, line + 1, id_digits) && frame->id <= id_max;
    if (!has_id) {
        return 0;
    }
    frame->length = parse_digit(line[header_length - 1]);
    /* NO_DIGIT, for a length that is no digit, is above the maximum, too. */
    return frame->length <= DATA_LENGTH_MAX ? header_length : 0;
}

/* Convert a line of `length` characters, without the carriage return at its end, to a frame. The line has
 * a header, and then two hexadecimal digits per byte of the data. Returns false, and leaves *frame as it was,
 * if the line is no frame. */
bool slcan_parse_frame(mcp_asdf_frame_t *frame, const char *line, uint8_t length)
{
    mcp_asdf_frame_t parsed = {0, 0, 0, {0}};
    const uint8_t header_length = parse_header(&parsed, line, length);
    const bool is_remote = (parsed.flags & MCP_ASDF_FRAME_REMOTE) != 0;
    const uint8_t byte_count = is_remote ? 0 : parsed.length; /* remote frames have a length, but no data */
    const int expected_length = header_length + 2 * byte_count;
    const bool is_frame = header_length != 0 && length == expected_length &&
                          parse_data(parsed.data, line + header_length, byte_count);
    if (!is_frame) {
        return false;
    }
    *frame = parsed;
    return true;
}

/* ---- Sending ---------------------------------------------------------------------------------------- */

/* Increment a counter, which stops at its largest value. */
static void increment(uint16_t *counter)
{
    if (*counter < UINT16_MAX) {
        ++*counter;
    }
}

/* Add a text to the outbox. Returns false, and counts an unsent line, if there is no room for it. */
static bool queue_text(slcan_link_t *link, const char *text, uint8_t length)
{
    const bool has_room = outbox_put(&link->outbox, text, length);
    if (!has_room) {
        increment(&link->unsent_lines);
    }
    return has_room;
}

/* Initialise the adapter with a closed bus, and queue an empty line, which ends whatever was on the serial
 * line before. */
void slcan_start(slcan_link_t *link)
{
    *link = (slcan_link_t){.is_open = false}; /* and the counters and the outbox are 0 */
    (void)queue_text(link, "\r", 1);
}

/* Queue a frame as a line, if the bus is open. Returns whether it was queued; counts an unsent line if the
 * outbox has no room for it. */
bool slcan_send_frame(slcan_link_t *link, const mcp_asdf_frame_t *frame)
{
    char line[SLCAN_LINE_MAX + 1]; /* with its end */
    const uint8_t length = slcan_format_frame(line, frame);
    if (!link->is_open || length == 0) {
        return false;
    }
    line[length] = '\r';
    return queue_text(link, line, length + 1);
}

/* ---- Commands ---------------------------------------------------------------------------------------- */

/* Queue a text that ends with a zero, as the answer to a line. */
static void send_answer(slcan_link_t *link, const char *text)
{
    uint8_t length = 0;
    while (text[length] != '\0') {
        ++length;
    }
    (void)queue_text(link, text, length);
}

/* Count the received line as dropped, and answer with the bell that means an error. */
static void drop_line(slcan_link_t *link)
{
    increment(&link->dropped_lines);
    send_answer(link, "\a");
}

/* Answer with the status flags: F, then two hexadecimal digits. Bit 1 is set if lines were unsent, bit 3 if
 * lines were dropped. */
static void send_status_flags(slcan_link_t *link)
{
    char answer[] = "F00\r";
    const uint32_t unsent_flag = link->unsent_lines > 0 ? STATUS_UNSENT : 0;
    const uint32_t dropped_flag = link->dropped_lines > 0 ? STATUS_DROPPED : 0;
    (void)write_hex(&answer[1], unsent_flag | dropped_flag, 2); /* in place of the two zeros */
    send_answer(link, answer);
}

/* Returns the number of characters, without the carriage return, of the command with this letter: 1, also for
 * letters that handle_command() refuses. Only the two for the bit rate are longer: S and a digit that stands
 * for it, or s and four digits for the registers that set it. */
static uint8_t command_length(char letter)
{
    switch (letter) {
    case 'S':
        return 2;
    case 's':
        return 5;
    default:
        return 1;
    }
}

/* Returns the letter of the command on the received line; '\r' for an empty line, and '?' if the line is too
 * long or too short for its letter. Noise that flips one bit makes a V of a T, the letter of a frame: the
 * length tells them apart. */
static char parse_command(const slcan_link_t *link)
{
    if (link->line_length == 0) {
        return '\r';
    }
    const char letter = link->line[0];
    if (link->line_length != command_length(letter)) {
        return '?';
    }
    return letter;
}

/* Carry out the command on the received line, and answer it: with a carriage return if it is accepted, and
 * with a bell if it is refused. Returns SLCAN_OPENED if it opens the bus, else SLCAN_NOTHING. */
static slcan_event_t handle_command(slcan_link_t *link)
{
    switch (parse_command(link)) {
    case 'O':
        send_answer(link, "\r");
        link->is_open = true;
        return SLCAN_OPENED;
    case 'C':
        link->is_open = false;
        send_answer(link, "\r");
        break;
    case 'S': /* any bit rate will do: there is no CAN wire */
    case 's':
    case '\r': /* an empty line, with which hosts end whatever was on the line before */
        send_answer(link, "\r");
        break;
    case 'V':
        send_answer(link, "V1001\r");
        break;
    case 'N':
        send_answer(link, "NASDF\r");
        break;
    case 'F':
        send_status_flags(link);
        break;
    default:
        drop_line(link);
    }
    return SLCAN_NOTHING;
}

/* ---- Receiving -------------------------------------------------------------------------------------- */

/* Handle a line that is complete. Returns SLCAN_FRAME, with the frame in *frame, if it is a frame;
 * SLCAN_OPENED if it is the command that opens the bus; else SLCAN_NOTHING. A damaged line is dropped, and a
 * frame is refused, with a bell as the answer, while the bus is closed. */
static slcan_event_t handle_line(slcan_link_t *link, mcp_asdf_frame_t *frame)
{
    if (link->is_line_damaged) {
        drop_line(link);
        return SLCAN_NOTHING;
    }
    if (!slcan_parse_frame(frame, link->line, link->line_length)) {
        return handle_command(link);
    }
    if (!link->is_open) {
        send_answer(link, "\a");
        return SLCAN_NOTHING;
    }
    /* The answer to a frame is a z, small for an 11-bit identifier. */
    const bool is_standard = (frame->flags & MCP_ASDF_FRAME_STANDARD) != 0;
    send_answer(link, is_standard ? "z\r" : "Z\r");
    return SLCAN_FRAME;
}

/* Append a received byte to the line, or handle the line if the byte ends it: a carriage return does, and a
 * bell, which also drops it. `byte` may be PORT_NOTHING, for which nothing happens, or PORT_LOST. Returns
 * SLCAN_FRAME, and writes *frame, if the line was a frame, or SLCAN_OPENED if it opened the bus, and else
 * SLCAN_NOTHING. A line that is too long or has lost bytes is marked as damaged, and dropped at its end. */
slcan_event_t slcan_handle_byte(slcan_link_t *link, int byte, mcp_asdf_frame_t *frame)
{
    slcan_event_t event = SLCAN_NOTHING;
    if (byte == PORT_NOTHING) {
        return event;
    }
    if (byte != '\r' && byte != '\a') {
        const bool is_too_long = link->line_length == SLCAN_LINE_MAX;
        if (byte == PORT_LOST || is_too_long) {
            link->is_line_damaged = true; /* until its end */
        }
        if (!link->is_line_damaged) {
            link->line[link->line_length] = (char)byte;
            ++link->line_length;
        }
        return event;
    }
    if (byte == '\r') {
        event = handle_line(link, frame);
    } else { /* a bell, which no host sends: noise */
        drop_line(link);
    }
    link->line_length = 0;
    link->is_line_damaged = false;
    return event;
}
