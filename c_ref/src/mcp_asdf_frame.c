/* The codec of the bus frames. mcp_asdf_frame.h is the manual; docs/design.md gives the layout. */
#include "mcp_asdf_frame.h"

#include "mcp_asdf.h"
#include "mcp_asdf_arithmetic.h"

#define FRAME_BYTES 8U

/* Parts of a binary32 number: a sign bit, 8 bits of an exponent, 23 bits of a fraction. */
#define BINARY32_INFINITY UINT32_C(0x7F800000)
#define BINARY32_FRACTION_MASK UINT32_C(0x007FFFFF)
#define BINARY32_IMPLICIT_BIT UINT32_C(0x00800000)
#define BINARY32_UNIT_EXPONENT 126U /* biased exponent of numbers whose last bit is worth 2^-24 */

/* Bits of the identifier beside priority, subject and node. */
#define ID_BITS_SENT_AS_ONE (UINT32_C(3) << 21) /* receivers ignore them */
#define ID_SERVICE (UINT32_C(1) << 25)
#define ID_ANONYMOUS (UINT32_C(1) << 24)
#define ID_RESERVED ((UINT32_C(1) << 23) | (UINT32_C(1) << 7))
#define ID_NODE_MASK 0x7FU
#define ID_PRIORITY_START 26U          /* the lowest of the priority's bits, 26 to 28 */
#define NOT_IN_ID UINT32_C(0xE0000000) /* bits 29 .. 31, which no identifier has */
/* All bits that must be as the subject has them. Priority, sender and the bits sent as 1 may be anything. */
#define CHECKED_ID_BITS (MCP_ASDF_FRAME_MASK | NOT_IN_ID)

/* The tail byte, the last of a frame's data. */
#define TAIL_BYTE 7U
#define TAIL_SINGLE_FRAME 0xE0U /* start, end and toggle bit */
#define TAIL_TRANSFER_ID_MASK 0x1FU

#define ANY_FLAG (MCP_ASDF_FRAME_STANDARD | MCP_ASDF_FRAME_REMOTE | MCP_ASDF_FRAME_ERROR | MCP_ASDF_FRAME_FD)

/* The same type by a short name; the public functions use the long one, as their declarations do. */
typedef mcp_asdf_frame_status_t status_t;

/* ---- Little-endian numbers --------------------------------------------------------------------------------
 */

/* Returns the number in the 3 bytes at `bytes`, below 2^24. */
static uint32_t read_24(const uint8_t *bytes)
{
    return bytes[0] | ((uint32_t)bytes[1] << 8) | ((uint32_t)bytes[2] << 16);
}

/* Returns the number in the 4 bytes at `bytes`. */
static uint32_t read_32(const uint8_t *bytes) { return read_24(bytes) | ((uint32_t)bytes[3] << 24); }

/* Write the lowest 24 bits of `value` to the 3 bytes at `bytes`. */
static void write_24(uint8_t *bytes, uint32_t value)
{
    bytes[0] = (uint8_t)value;
    bytes[1] = (uint8_t)(value >> 8);
    bytes[2] = (uint8_t)(value >> 16);
}

/* Write `value` to the 4 bytes at `bytes`. */
static void write_32(uint8_t *bytes, uint32_t value)
{
    write_24(bytes, value);
    bytes[3] = (uint8_t)(value >> 24);
}

/* ---- What all messages have in common --------------------------------------------------------------- */

/* Check the sender and the format of a message before it is encoded. Returns ERR_NODE if `node` is above 127,
 * else ERR_FORMAT if the subject or the priority of `format` is out of range, else OK. */
static status_t check_sender_and_format(const mcp_asdf_frame_format_t *format, uint8_t node)
{
    if (node > MCP_ASDF_NODE_MAX) {
        return MCP_ASDF_FRAME_ERR_NODE;
    }
    if (format->subject > MCP_ASDF_SUBJECT_MAX || format->priority > MCP_ASDF_PRIORITY_MAX) {
        return MCP_ASDF_FRAME_ERR_FORMAT;
    }
    return MCP_ASDF_FRAME_OK;
}

/* Write what encloses the content of every message: the identifier (from `priority`, `subject` and `node`),
 * no flags, the length of 8, and as the last byte of data the tail byte, with `transfer_id` modulo 32. The
 * content, data[0] to data[6], stays as it is. The caller has checked the ranges. */
static void write_envelope(mcp_asdf_frame_t *frame, uint8_t priority, uint16_t subject, uint8_t node,
                           uint8_t transfer_id)
{
    /* MCP_ASDF_FRAME_FILTER() returns an identifier with the bits of the subject alone. */
    frame->id = ((uint32_t)priority << ID_PRIORITY_START) | ID_BITS_SENT_AS_ONE |
                MCP_ASDF_FRAME_FILTER(subject) | node;
    frame->flags = 0;
    frame->length = FRAME_BYTES;
    frame->data[TAIL_BYTE] = (uint8_t)(TAIL_SINGLE_FRAME | (transfer_id & TAIL_TRANSFER_ID_MASK));
}

/* Returns the reason to refuse a frame in which check_envelope() has found a flag or an unexpected
 * identifier. It is the first reason in the order of mcp_asdf_frame_status_t. A frame with none of the flags
 * and bits that are tried here is refused for its subject. */
static status_t find_refusal_reason(const mcp_asdf_frame_t *frame)
{
    if ((frame->flags & MCP_ASDF_FRAME_ERROR) != 0U) {
        return MCP_ASDF_FRAME_ERR_ERROR_FRAME;
    }
    if ((frame->flags & MCP_ASDF_FRAME_REMOTE) != 0U) {
        return MCP_ASDF_FRAME_ERR_REMOTE_FRAME;
    }
    if ((frame->flags & MCP_ASDF_FRAME_FD) != 0U) {
        return MCP_ASDF_FRAME_ERR_FD_FRAME;
    }
    if ((frame->flags & MCP_ASDF_FRAME_STANDARD) != 0U) {
        return MCP_ASDF_FRAME_ERR_STANDARD_ID;
    }
    if ((frame->id & ID_SERVICE) != 0U) {
        return MCP_ASDF_FRAME_ERR_SERVICE;
    }
    if ((frame->id & ID_ANONYMOUS) != 0U) {
        return MCP_ASDF_FRAME_ERR_ANONYMOUS;
    }
    if ((frame->id & ID_RESERVED) != 0U) {
        return MCP_ASDF_FRAME_ERR_RESERVED_BITS;
    }
    return MCP_ASDF_FRAME_ERR_SUBJECT;
}

/* Check all of a frame but the content of its message: flags, identifier, length and tail byte. Returns OK if
 * it is a single-frame message of `subject` (0 .. 6143), else the first reason to refuse it, in the order of
 * mcp_asdf_frame_status_t. */
static status_t check_envelope(const mcp_asdf_frame_t *frame, uint16_t subject)
{
    /* Any flag is wrong, and so is any bit of the identifier that the subject has not, except in the
     * priority, the sender and the bits that are sent as 1. */
    if ((frame->flags & ANY_FLAG) != 0U || (frame->id & CHECKED_ID_BITS) != MCP_ASDF_FRAME_FILTER(subject)) {
        return find_refusal_reason(frame);
    }
    if (frame->length != FRAME_BYTES) {
        return MCP_ASDF_FRAME_ERR_LENGTH;
    }
    if ((frame->data[TAIL_BYTE] & TAIL_SINGLE_FRAME) != TAIL_SINGLE_FRAME) {
        return MCP_ASDF_FRAME_ERR_MULTI_FRAME;
    }
    return MCP_ASDF_FRAME_OK;
}

/* Returns the id of the node that sent `frame`, 0 .. 127. */
static uint8_t read_node(const mcp_asdf_frame_t *frame) { return (uint8_t)(frame->id & ID_NODE_MASK); }

/* Returns the number of the message in `frame` among those of its sender and kind, modulo 32. */
static uint8_t read_transfer_id(const mcp_asdf_frame_t *frame)
{
    return (uint8_t)(frame->data[TAIL_BYTE] & TAIL_TRANSFER_ID_MASK);
}

/* ---- Confidence: alpha words and binary32 ----------------------------------------------------------- */

/* Whether a binary32 number, given by its bits, can be an alpha: finite and not negative. As integers, the
 * bits of infinity, of all NaN and of all numbers with the sign bit set are at least BINARY32_INFINITY. */
static bool is_finite_and_not_negative(uint32_t binary32) { return binary32 < BINARY32_INFINITY; }

/* Returns the bits of the binary32 number that an alpha word stands for: mantissa (bits 8 to 31) times
 * 2^shift (bits 0 to 4) in units of 2^-24. Exact for every word. */
static uint32_t binary32_from_alpha_word(uint32_t alpha)
{
    /* ALPHA_SHIFT_MAX, 31, is also the mask of the 5 bits that hold the shift. */
    uint32_t mantissa = alpha >> 8;
    uint32_t exponent = BINARY32_UNIT_EXPONENT + (alpha & ALPHA_SHIFT_MAX); /* of a mantissa of 24 bits */
    if (mantissa == 0U) {
        return 0;
    }
    /* Shift until the highest bit of the mantissa is where binary32 leaves it out. */
    while (mantissa < BINARY32_IMPLICIT_BIT) { /* at most 23 turns, so the exponent stays above 102 */
        mantissa <<= 1;
        --exponent;
    }
    return (exponent << 23) | (mantissa & BINARY32_FRACTION_MASK);
}

/* Returns the word (mantissa in bits 8 to 31, shift in bits 0 to 4) of the largest alpha that is not above a
 * number, given as the bits of a binary32 number that is finite and not negative: 0 for a number below a unit
 * of 2^-24, ALPHA_MAX for one above the largest alpha. Exact for what binary32_from_alpha_word() returned. */
static uint32_t alpha_word_from_binary32(uint32_t binary32)
{
    const uint32_t exponent = binary32 >> 23;
    const uint32_t mantissa = (binary32 & BINARY32_FRACTION_MASK) | BINARY32_IMPLICIT_BIT;
    if (exponent < BINARY32_UNIT_EXPONENT) {
        /* Bits below the unit are lost. A subnormal number, whose exponent is 0, has got an implicit bit here
         * that it does not have: this does no harm, as all its bits are lost. */
        const uint32_t lost_bits = BINARY32_UNIT_EXPONENT - exponent;
        return lost_bits < 24U ? (mantissa >> lost_bits) << 8 : 0U;
    }
    const uint32_t shift = exponent - BINARY32_UNIT_EXPONENT;
    return shift <= ALPHA_SHIFT_MAX ? (mantissa << 8) | shift : ALPHA_MAX;
}

/* ---- Estimate --------------------------------------------------------------------------------------- */

/* Write an estimate to a frame: x_hat as Q23, and alpha, an alpha word in the message (mantissa in bits 8 to
 * 31, times 2 to the power of bits 0 to 4, in units of 2^-24), as a binary32 number. Returns OK; or the first
 * of ERR_NODE, ERR_FORMAT and ERR_X_HAT (above 1.0) that applies, and leaves *frame as it was. */
mcp_asdf_frame_status_t mcp_asdf_encode_estimate(mcp_asdf_frame_t *frame,
                                                 const mcp_asdf_frame_format_t *format,
                                                 const mcp_asdf_estimate_t *message)
{
    const status_t status = check_sender_and_format(format, message->node);
    if (status != MCP_ASDF_FRAME_OK) {
        return status;
    }
    if (message->x_hat > MCP_ASDF_ONE) {
        return MCP_ASDF_FRAME_ERR_X_HAT;
    }
    /* Bytes 0 to 2: x_hat; 3 to 6: alpha. */
    write_24(&frame->data[0], message->x_hat);
    write_32(&frame->data[3], binary32_from_alpha_word(message->alpha));
    write_envelope(frame, format->priority, format->subject, message->node, message->transfer_id);
    return MCP_ASDF_FRAME_OK;
}

/* Read an estimate from a frame of `subject` into *message: sender, transfer id, x_hat as Q23, and alpha,
 * which is a binary32 number in the frame and becomes an alpha word in the message (mantissa in bits 8 to 31,
 * times 2 to the power of bits 0 to 4, in units of 2^-24; rounded down). Returns OK, or the first reason to
 * refuse the frame and leaves *message as it was. */
mcp_asdf_frame_status_t mcp_asdf_decode_estimate(mcp_asdf_estimate_t *message, uint16_t subject,
                                                 const mcp_asdf_frame_t *frame)
{
    const status_t status = check_envelope(frame, subject);
    if (status != MCP_ASDF_FRAME_OK) {
        return status;
    }
    /* Bytes 0 to 2: x_hat; 3 to 6: alpha. */
    const uint32_t x_hat = read_24(&frame->data[0]);
    const uint32_t alpha_binary32 = read_32(&frame->data[3]);
    if (x_hat > MCP_ASDF_ONE) {
        return MCP_ASDF_FRAME_ERR_X_HAT;
    }
    if (!is_finite_and_not_negative(alpha_binary32)) {
        return MCP_ASDF_FRAME_ERR_ALPHA;
    }
    message->node = read_node(frame);
    message->transfer_id = read_transfer_id(frame);
    message->x_hat = x_hat;
    message->alpha = alpha_word_from_binary32(alpha_binary32);
    return MCP_ASDF_FRAME_OK;
}

/* ---- Heartbeat -------------------------------------------------------------------------------------- */

/* Write a heartbeat (uptime in seconds, health, mode, and the vendor's status) to a frame, with the
 * standard's fixed subject. Returns OK; or the first of ERR_NODE (above 127), ERR_FORMAT (the priority is
 * above 7), ERR_HEALTH and ERR_MODE that applies, and leaves *frame as it was. */
mcp_asdf_frame_status_t mcp_asdf_encode_heartbeat(mcp_asdf_frame_t *frame, uint8_t priority,
                                                  const mcp_asdf_heartbeat_t *message)
{
    const mcp_asdf_frame_format_t format = {.subject = 0, .priority = priority};
    /* check_sender_and_format() checks a subject, too, but the subject of heartbeats is fixed. So the
     * function gets subject 0, which is always valid, and finds only errors of node and priority. */
    const status_t status = check_sender_and_format(&format, message->node);
    if (status != MCP_ASDF_FRAME_OK) {
        return status;
    }
    if (message->health > MCP_ASDF_HEALTH_WARNING) {
        return MCP_ASDF_FRAME_ERR_HEALTH;
    }
    if (message->mode > MCP_ASDF_MODE_SOFTWARE_UPDATE) {
        return MCP_ASDF_FRAME_ERR_MODE;
    }
    /* Bytes 0 to 3: uptime; then a byte each. */
    write_32(&frame->data[0], message->uptime);
    frame->data[4] = message->health;
    frame->data[5] = message->mode;
    frame->data[6] = message->vendor_status;
    write_envelope(frame, priority, MCP_ASDF_SUBJECT_HEARTBEAT, message->node, message->transfer_id);
    return MCP_ASDF_FRAME_OK;
}

/* ---- Telemetry -------------------------------------------------------------------------------------- */

/* Write telemetry to a frame: x as Q23, b_hat as Q24, and the number of updates, modulo 256. Returns OK; or
 * the first of ERR_NODE, ERR_FORMAT, ERR_X (above 1.0) and ERR_B_HAT (out of range) that applies, and leaves
 * *frame as it was. */
mcp_asdf_frame_status_t mcp_asdf_encode_telemetry(mcp_asdf_frame_t *frame,
                                                  const mcp_asdf_frame_format_t *format,
                                                  const mcp_asdf_telemetry_t *message)
{
    const status_t status = check_sender_and_format(format, message->node);
    if (status != MCP_ASDF_FRAME_OK) {
        return status;
    }
    if (message->x > MCP_ASDF_ONE) {
        return MCP_ASDF_FRAME_ERR_X;
    }
    if (message->b_hat < MCP_ASDF_FRAME_B_HAT_MIN || message->b_hat > MCP_ASDF_FRAME_B_HAT_MAX) {
        return MCP_ASDF_FRAME_ERR_B_HAT;
    }
    /* Bytes 0 to 2: x; 3 to 5: b_hat; 6: updates. */
    write_24(&frame->data[0], message->x);
    write_24(&frame->data[3], message->b_hat);
    frame->data[6] = message->updates;
    write_envelope(frame, format->priority, format->subject, message->node, message->transfer_id);
    return MCP_ASDF_FRAME_OK;
}

/* ---- Command ---------------------------------------------------------------------------------------- */

/* Read a command from a frame of `subject`: sender, transfer id, target, action and tick. Returns OK, or the
 * first reason to refuse the frame and leaves *message as it was. */
mcp_asdf_frame_status_t mcp_asdf_decode_command(mcp_asdf_command_t *message, uint16_t subject,
                                                const mcp_asdf_frame_t *frame)
{
    const status_t status = check_envelope(frame, subject);
    if (status != MCP_ASDF_FRAME_OK) {
        return status;
    }
    /* Bytes 0 to 3: tick; 4: target; 5: action; 6 is spare, and may have any value. */
    const uint8_t target = frame->data[4], action = frame->data[5];
    if (target > MCP_ASDF_NODE_MAX && target != MCP_ASDF_EVERY_ROBOT) {
        return MCP_ASDF_FRAME_ERR_TARGET;
    }
    if (action > MCP_ASDF_SETTLE) {
        return MCP_ASDF_FRAME_ERR_ACTION;
    }
    message->node = read_node(frame);
    message->transfer_id = read_transfer_id(frame);
    message->tick = read_32(&frame->data[0]);
    message->target = target;
    message->action = action;
    return MCP_ASDF_FRAME_OK;
}
