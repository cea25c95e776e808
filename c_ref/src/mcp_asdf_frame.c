/* The codec of the bus frames. mcp_asdf_frame.h is the manual; docs/frame.md gives the layout. */
#include "mcp_asdf_frame.h"

#include "mcp_asdf.h"
#include "mcp_asdf_arithmetic.h"

#define FRAME_BYTES 8U
/* Of a binary32 number: from here on infinity, then NaN, then all with the sign bit set. */
#define BINARY32_INFINITE UINT32_C(0x7F800000)
#define BINARY32_FRACTION UINT32_C(0x007FFFFF)
#define BINARY32_IMPLICIT UINT32_C(0x00800000)
#define BINARY32_UNIT 126U                  /* biased exponent of numbers whose last bit is worth 2^-24 */
#define IDENTIFIER_ONES (UINT32_C(3) << 21) /* sent as 1, ignored */
#define SERVICE (UINT32_C(1) << 25)
#define ANONYMOUS (UINT32_C(1) << 24)
#define RESERVED (UINT32_C(1) << 23 | UINT32_C(1) << 7)
#define NOT_IN_IDENTIFIER UINT32_C(0xE0000000) /* a set bit here must not pass for a legal frame */
#define NODE_BITS 0x7FU
#define SINGLE_FRAME 0xE0U /* start, end and toggle of the tail byte */
#define TRANSFER_BITS 0x1FU
#define ANY_FLAG (MCP_ASDF_FRAME_STANDARD | MCP_ASDF_FRAME_REMOTE | MCP_ASDF_FRAME_ERROR | MCP_ASDF_FRAME_FD)

typedef mcp_asdf_frame_status_t status_t;

/* ---- Words in frames -------------------------------------------------------------------------------- */

static uint32_t read_24(const uint8_t *bytes)
{
    return bytes[0] | (uint32_t)bytes[1] << 8 | (uint32_t)bytes[2] << 16;
}

static uint32_t read_32(const uint8_t *bytes) { return read_24(bytes) | (uint32_t)bytes[3] << 24; }

static void write_24(uint8_t *bytes, uint32_t value)
{
    bytes[0] = (uint8_t)value;
    bytes[1] = (uint8_t)(value >> 8);
    bytes[2] = (uint8_t)(value >> 16);
}

static void write_32(uint8_t *bytes, uint32_t value)
{
    write_24(bytes, value);
    bytes[3] = (uint8_t)(value >> 24);
}

/* ---- The envelope of all messages ------------------------------------------------------------------- */

static status_t check_format(const mcp_asdf_frame_format_t *format, uint8_t node)
{
    if (node > MCP_ASDF_NODE_MAX) {
        return MCP_ASDF_FRAME_ERR_NODE;
    }
    return format->subject > MCP_ASDF_SUBJECT_MAX || format->priority > MCP_ASDF_PRIORITY_MAX
               ? MCP_ASDF_FRAME_ERR_FORMAT
               : MCP_ASDF_FRAME_OK;
}

static void seal(mcp_asdf_frame_t *frame, uint8_t priority, uint16_t subject, uint8_t node,
                 uint8_t transfer_id)
{
    frame->id = (uint32_t)priority << 26 | IDENTIFIER_ONES | MCP_ASDF_FRAME_FILTER(subject) | node;
    frame->flags = 0;
    frame->length = FRAME_BYTES;
    frame->data[7] = (uint8_t)(SINGLE_FRAME | (transfer_id & TRANSFER_BITS));
}

/* Why a frame with a flag or of another identifier is none of ours. */
static status_t what_is_special(const mcp_asdf_frame_t *frame)
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
    if ((frame->id & SERVICE) != 0U) {
        return MCP_ASDF_FRAME_ERR_SERVICE;
    }
    if ((frame->id & ANONYMOUS) != 0U) {
        return MCP_ASDF_FRAME_ERR_ANONYMOUS;
    }
    return (frame->id & RESERVED) != 0U ? MCP_ASDF_FRAME_ERR_RESERVED_BITS : MCP_ASDF_FRAME_ERR_SUBJECT;
}

static status_t open_envelope(const mcp_asdf_frame_t *frame, uint16_t subject)
{
    if ((frame->flags & ANY_FLAG) != 0U ||
        (frame->id & (MCP_ASDF_FRAME_MASK | NOT_IN_IDENTIFIER)) != MCP_ASDF_FRAME_FILTER(subject)) {
        return what_is_special(frame);
    }
    if (frame->length != FRAME_BYTES) {
        return MCP_ASDF_FRAME_ERR_LENGTH;
    }
    return (frame->data[7] & SINGLE_FRAME) == SINGLE_FRAME ? MCP_ASDF_FRAME_OK
                                                           : MCP_ASDF_FRAME_ERR_MULTI_FRAME;
}

static uint8_t node_of(const mcp_asdf_frame_t *frame) { return (uint8_t)(frame->id & NODE_BITS); }

static uint8_t transfer_id_of(const mcp_asdf_frame_t *frame)
{
    return (uint8_t)(frame->data[7] & TRANSFER_BITS);
}

/* ---- Confidence: the core's word and binary32 ------------------------------------------------------- */

/* Exact for every word. */
static uint32_t binary32_of(uint32_t alpha)
{
    uint32_t mantissa = alpha >> 8, exponent = BINARY32_UNIT + (alpha & ALPHA_SHIFT_MAX);
    if (mantissa == 0U) {
        return 0;
    }
    while (mantissa < BINARY32_IMPLICIT) { /* at most 23 turns, so the exponent stays above 102 */
        mantissa <<= 1;
        --exponent;
    }
    return exponent << 23 | (mantissa & BINARY32_FRACTION);
}

/* The word of the largest confidence not above a binary32 number >= 0; exact for what binary32_of() returned.
 */
static uint32_t word_of(uint32_t binary32)
{
    const uint32_t exponent = binary32 >> 23;
    const uint32_t mantissa = (binary32 & BINARY32_FRACTION) | BINARY32_IMPLICIT;
    if (exponent < BINARY32_UNIT) { /* subnormal numbers lose everything, too */
        const uint32_t lost = BINARY32_UNIT - exponent;
        return lost < 24U ? mantissa >> lost << 8 : 0U;
    }
    const uint32_t shift = exponent - BINARY32_UNIT;
    return shift <= ALPHA_SHIFT_MAX ? mantissa << 8 | shift : ALPHA_MAX;
}

/* ---- Estimate --------------------------------------------------------------------------------------- */

mcp_asdf_frame_status_t mcp_asdf_encode_estimate(mcp_asdf_frame_t *frame,
                                                 const mcp_asdf_frame_format_t *format,
                                                 const mcp_asdf_estimate_t *message)
{
    const status_t status = check_format(format, message->node);
    if (status != MCP_ASDF_FRAME_OK) {
        return status;
    }
    if (message->x_hat > MCP_ASDF_ONE) {
        return MCP_ASDF_FRAME_ERR_X_HAT;
    }
    write_24(&frame->data[0], message->x_hat);
    write_32(&frame->data[3], binary32_of(message->alpha));
    seal(frame, format->priority, format->subject, message->node, message->transfer_id);
    return MCP_ASDF_FRAME_OK;
}

mcp_asdf_frame_status_t mcp_asdf_decode_estimate(mcp_asdf_estimate_t *message, uint16_t subject,
                                                 const mcp_asdf_frame_t *frame)
{
    const status_t status = open_envelope(frame, subject);
    if (status != MCP_ASDF_FRAME_OK) {
        return status;
    }
    const uint32_t x_hat = read_24(&frame->data[0]), alpha = read_32(&frame->data[3]);
    if (x_hat > MCP_ASDF_ONE) {
        return MCP_ASDF_FRAME_ERR_X_HAT;
    }
    if (alpha >= BINARY32_INFINITE) {
        return MCP_ASDF_FRAME_ERR_ALPHA;
    }
    message->node = node_of(frame);
    message->transfer_id = transfer_id_of(frame);
    message->x_hat = x_hat;
    message->alpha = word_of(alpha);
    return MCP_ASDF_FRAME_OK;
}

/* ---- Heartbeat -------------------------------------------------------------------------------------- */

mcp_asdf_frame_status_t mcp_asdf_encode_heartbeat(mcp_asdf_frame_t *frame, uint8_t priority,
                                                  const mcp_asdf_heartbeat_t *message)
{
    const mcp_asdf_frame_format_t format = {0, priority};
    const status_t status = check_format(&format, message->node);
    if (status != MCP_ASDF_FRAME_OK) {
        return status;
    }
    if (message->health > MCP_ASDF_HEALTH_WARNING) {
        return MCP_ASDF_FRAME_ERR_HEALTH;
    }
    if (message->mode > MCP_ASDF_MODE_SOFTWARE_UPDATE) {
        return MCP_ASDF_FRAME_ERR_MODE;
    }
    write_32(&frame->data[0], message->uptime);
    frame->data[4] = message->health;
    frame->data[5] = message->mode;
    frame->data[6] = message->vendor_status;
    seal(frame, priority, MCP_ASDF_SUBJECT_HEARTBEAT, message->node, message->transfer_id);
    return MCP_ASDF_FRAME_OK;
}

/* ---- Telemetry -------------------------------------------------------------------------------------- */

mcp_asdf_frame_status_t mcp_asdf_encode_telemetry(mcp_asdf_frame_t *frame,
                                                  const mcp_asdf_frame_format_t *format,
                                                  const mcp_asdf_telemetry_t *message)
{
    const status_t status = check_format(format, message->node);
    if (status != MCP_ASDF_FRAME_OK) {
        return status;
    }
    if (message->x > MCP_ASDF_ONE) {
        return MCP_ASDF_FRAME_ERR_X;
    }
    if (message->b_hat < MCP_ASDF_FRAME_B_HAT_MIN || message->b_hat > MCP_ASDF_FRAME_B_HAT_MAX) {
        return MCP_ASDF_FRAME_ERR_B_HAT;
    }
    write_24(&frame->data[0], message->x);
    write_24(&frame->data[3], message->b_hat);
    frame->data[6] = message->updates;
    seal(frame, format->priority, format->subject, message->node, message->transfer_id);
    return MCP_ASDF_FRAME_OK;
}

/* ---- Command ---------------------------------------------------------------------------------------- */

mcp_asdf_frame_status_t mcp_asdf_decode_command(mcp_asdf_command_t *message, uint16_t subject,
                                                const mcp_asdf_frame_t *frame)
{
    const status_t status = open_envelope(frame, subject);
    if (status != MCP_ASDF_FRAME_OK) {
        return status;
    }
    const uint8_t target = frame->data[4], action = frame->data[5];
    if (target > MCP_ASDF_NODE_MAX && target != MCP_ASDF_EVERY_ROBOT) {
        return MCP_ASDF_FRAME_ERR_TARGET;
    }
    if (action > MCP_ASDF_SETTLE) {
        return MCP_ASDF_FRAME_ERR_ACTION;
    }
    message->node = node_of(frame);
    message->transfer_id = transfer_id_of(frame);
    message->tick = read_32(&frame->data[0]);
    message->target = target;
    message->action = action;
    return MCP_ASDF_FRAME_OK;
}
