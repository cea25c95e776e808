/* Black box: the frame codec. The rules are those of docs/frame.md, written once more with division,
 * remainder and floating point instead of masks and shifts. tests/host_tools/bus compares any frame, and the
 * acceptance filter, with the codec in Python. */
#include "mcp_asdf_frame.h"

#include "check.h"

#include <string.h>

#define KINDS 2 /* that a robot decodes: estimate, command */

static const uint16_t subjects[KINDS] = {3000, 3002};

/* From node 42 with transfer id 5. */
static const mcp_asdf_frame_t legal_estimate = {
    UINT32_C(0x106BB82A), 0, 8, {0x00, 0x00, 0x40, 0x00, 0x00, 0x80, 0x3F, 0xE5}};
static const mcp_asdf_frame_t legal_command = {
    UINT32_C(0x0C6BBA2A), 0, 8, {0x04, 0x03, 0x02, 0x01, 0x11, 0x03, 0x00, 0xE5}};

static mcp_asdf_frame_t legal(int kind) { return kind == 0 ? legal_estimate : legal_command; }

static uint64_t number(const uint8_t *bytes, int count)
{
    uint64_t value = 0;
    while (count > 0) {
        value = value * 256 + bytes[--count];
    }
    return value;
}

/* ---- Confidences: the core's word in memory, binary32 in the frame ---- */

/* Exact, as a mantissa has 24 bits. */
static uint32_t binary32_by_the_text(uint32_t word)
{
    const float value = (float)((double)(word / 256) * (double)(UINT32_C(1) << word % 32) / 16777216);
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

/* The word of the largest confidence not above a finite number, with the smallest shift. */
static uint32_t word_by_the_text(uint32_t binary32)
{
    float value;
    memcpy(&value, &binary32, sizeof value);
    const double units = (double)value * 16777216;
    if (units >= 36028797018963968.0) { /* 2^55 */
        return 0xFFFFFF1F;
    }
    uint64_t mantissa = (uint64_t)units, shift = 0;
    for (; mantissa >= 16777216; mantissa /= 2) {
        ++shift;
    }
    return (uint32_t)(mantissa * 256 + shift);
}

/* ---- Decoders ---- */

/* What a kind's decoder says, and whether it read every member, or nothing on failure. */
static mcp_asdf_frame_status_t decode(int kind, const mcp_asdf_frame_t *frame)
{
    union {
        mcp_asdf_estimate_t estimate;
        mcp_asdf_command_t command;
        uint8_t bytes[16];
    } message, before;
    memset(&message, 0xA5, sizeof message);
    before = message;
    const mcp_asdf_frame_status_t status =
        kind == 0 ? mcp_asdf_decode_estimate(&message.estimate, subjects[0], frame)
                  : mcp_asdf_decode_command(&message.command, subjects[1], frame);
    const uint32_t node = frame->id % 128, transfer_id = frame->data[7] % 32;
    if (status != MCP_ASDF_FRAME_OK) {
        CHECK(memcmp(&message, &before, sizeof message) == 0);
    } else if (kind == 0) {
        CHECK(message.estimate.node == node && message.estimate.transfer_id == transfer_id);
        CHECK_EQUAL(message.estimate.x_hat, number(frame->data, 3));
        CHECK_EQUAL(message.estimate.alpha, word_by_the_text((uint32_t)number(frame->data + 3, 4)));
    } else {
        CHECK(message.command.node == node && message.command.transfer_id == transfer_id);
        CHECK(message.command.target == frame->data[4] && message.command.action == frame->data[5]);
        CHECK_EQUAL(message.command.tick, number(frame->data, 4));
    }
    return status;
}

/* The status by the text of docs/frame.md, for the envelope, in the order of the header. */
static mcp_asdf_frame_status_t envelope_by_the_text(const mcp_asdf_frame_t *frame, uint32_t subject)
{
    const uint32_t id = frame->id;
    if (frame->flags / 4 % 2 == 1)
        return MCP_ASDF_FRAME_ERR_ERROR_FRAME;
    if (frame->flags / 2 % 2 == 1)
        return MCP_ASDF_FRAME_ERR_REMOTE_FRAME;
    if (frame->flags / 8 % 2 == 1)
        return MCP_ASDF_FRAME_ERR_FD_FRAME;
    if (frame->flags % 2 == 1)
        return MCP_ASDF_FRAME_ERR_STANDARD_ID;
    if (id / 33554432 % 2 == 1)
        return MCP_ASDF_FRAME_ERR_SERVICE;
    if (id / 16777216 % 2 == 1)
        return MCP_ASDF_FRAME_ERR_ANONYMOUS;
    if (id / 8388608 % 2 == 1 || id / 128 % 2 == 1)
        return MCP_ASDF_FRAME_ERR_RESERVED_BITS;
    if (id / 256 % 8192 != subject || id / 536870912 != 0)
        return MCP_ASDF_FRAME_ERR_SUBJECT;
    if (frame->length != 8)
        return MCP_ASDF_FRAME_ERR_LENGTH;
    return frame->data[7] / 32 == 7 ? MCP_ASDF_FRAME_OK : MCP_ASDF_FRAME_ERR_MULTI_FRAME;
}

static mcp_asdf_frame_status_t by_the_text(int kind, const mcp_asdf_frame_t *frame)
{
    const mcp_asdf_frame_status_t envelope = envelope_by_the_text(frame, subjects[kind]);
    const uint8_t *const data = frame->data;
    if (envelope != MCP_ASDF_FRAME_OK) {
        return envelope;
    }
    if (kind == 0) { /* the exponent of a finite number is below 255; the sign is the highest bit */
        if (number(data, 3) > 8388608)
            return MCP_ASDF_FRAME_ERR_X_HAT;
        return number(data + 3, 4) / 8388608 < 255 ? MCP_ASDF_FRAME_OK : MCP_ASDF_FRAME_ERR_ALPHA;
    }
    if (data[4] >= 128 && data[4] < 255)
        return MCP_ASDF_FRAME_ERR_TARGET;
    return data[5] <= 3 ? MCP_ASDF_FRAME_OK : MCP_ASDF_FRAME_ERR_ACTION;
}

static void agrees(const mcp_asdf_frame_t *frame)
{
    for (int kind = 0; kind < KINDS; ++kind) {
        GIVEN(kind, frame->id, number(frame->data, 8));
        CHECK_EQUAL(-decode(kind, frame), -by_the_text(kind, frame));
    }
}

/* Every bit of an identifier, every value of every byte. */
static void each_part_of_a_legal_frame(void)
{
    for (int kind = 0; kind < KINDS; ++kind) {
        for (int bit = 0; bit < 32; ++bit) {
            mcp_asdf_frame_t frame = legal(kind);
            frame.id ^= UINT32_C(1) << bit;
            agrees(&frame);
        }
        for (int value = 0; value < 256; ++value) {
            mcp_asdf_frame_t flagged = legal(kind), sized = flagged;
            flagged.flags = (uint8_t)value;
            sized.length = (uint8_t)value;
            agrees(&flagged);
            agrees(&sized);
            for (int at = 0; at < 8; ++at) {
                mcp_asdf_frame_t frame = legal(kind);
                frame.data[at] = (uint8_t)value;
                agrees(&frame);
            }
        }
    }
}

/* Numbers of any kind: one unit, too large for a word, not finite, negative, and beside these. */
/* design: R16 */
static void confidences_are_read(void)
{
    static const uint32_t ends[] = {0x33800000, 0x4F000000, 0x7F800000, 0x80000000};
    for (uint32_t i = 0; i < 100000; ++i) {
        mcp_asdf_frame_t frame = legal_estimate;
        const uint32_t binary32 = i % 2 == 0 ? check_random_word() : ends[i / 2 % 4] - 3 + i % 7;
        for (int at = 0; at < 4; ++at) {
            frame.data[3 + at] = (uint8_t)(binary32 >> 8 * at);
        }
        agrees(&frame);
    }
}

/* ---- Encoders ---- */

static uint32_t any(void)
{
    static const uint32_t ends[] = {0,   1,   3,    4,    7,    8,       15,      16,       127,
                                    128, 255, 3000, 6143, 6144, 8388608, 8388609, 16777200, 16777201};
    return ends[check_random_word() % COUNT(ends)];
}

/* A frame that was made is that of these bytes; one that was refused is as it was. */
static void check_frame(const mcp_asdf_frame_t *frame, int status, int expected, uint32_t id, uint64_t data)
{
    mcp_asdf_frame_t blank;
    memset(&blank, 0x5A, sizeof blank);
    CHECK_EQUAL(-status, -expected);
    if (expected == MCP_ASDF_FRAME_OK) {
        CHECK(frame->id == id && frame->flags == 0 && frame->length == 8);
        CHECK_EQUAL(number(frame->data, 8), data);
    } else {
        CHECK(memcmp(frame, &blank, sizeof blank) == 0);
    }
}

/* The first complaint counts. */
static void encoders_refuse_or_write_every_member(void)
{
    for (uint32_t i = 0; i < 100000; ++i) {
        const mcp_asdf_frame_format_t format = {(uint16_t)any(), (uint8_t)any()};
        const uint8_t node = (uint8_t)any(), transfer = (uint8_t)any();
        const mcp_asdf_estimate_t estimate = {node, transfer, any(), check_random_word()};
        const mcp_asdf_heartbeat_t beat = {node,           transfer,       (uint8_t)any(),
                                           (uint8_t)any(), (uint8_t)any(), check_random_word()};
        const mcp_asdf_telemetry_t telemetry = {node, transfer, (uint8_t)any(), any(), any()};
        const int of_node = node > 127 ? MCP_ASDF_FRAME_ERR_NODE : MCP_ASDF_FRAME_OK;
        const int of_priority = format.priority > 7 && of_node == 0 ? MCP_ASDF_FRAME_ERR_FORMAT : of_node;
        const int of_format = format.subject > 6143 && of_node == 0 ? MCP_ASDF_FRAME_ERR_FORMAT : of_priority;
        const uint32_t id = format.priority * 67108864U + 6291456U + node;
        const uint64_t tail = (uint64_t)(224 + transfer % 32) << 56, one = 1;
        mcp_asdf_frame_t made[3];
        memset(made, 0x5A, sizeof made);
        GIVEN(i, node, format.subject);
        check_frame(&made[0], mcp_asdf_encode_estimate(&made[0], &format, &estimate),
                    of_format != 0             ? of_format
                    : estimate.x_hat > 8388608 ? MCP_ASDF_FRAME_ERR_X_HAT
                                               : MCP_ASDF_FRAME_OK,
                    id + format.subject * 256U,
                    tail + estimate.x_hat + (one << 24) * binary32_by_the_text(estimate.alpha));
        check_frame(&made[1], mcp_asdf_encode_heartbeat(&made[1], format.priority, &beat),
                    of_priority != 0  ? of_priority
                    : beat.health > 3 ? MCP_ASDF_FRAME_ERR_HEALTH
                    : beat.mode > 3   ? MCP_ASDF_FRAME_ERR_MODE
                                      : MCP_ASDF_FRAME_OK,
                    id + 7509U * 256U,
                    tail + beat.uptime + (one << 32) * beat.health + (one << 40) * beat.mode +
                        (one << 48) * beat.vendor_status);
        check_frame(&made[2], mcp_asdf_encode_telemetry(&made[2], &format, &telemetry),
                    of_format != 0                                       ? of_format
                    : telemetry.x > 8388608                              ? MCP_ASDF_FRAME_ERR_X
                    : telemetry.b_hat < 16 || telemetry.b_hat > 16777200 ? MCP_ASDF_FRAME_ERR_B_HAT
                                                                         : MCP_ASDF_FRAME_OK,
                    id + format.subject * 256U,
                    tail + telemetry.x + (one << 24) * telemetry.b_hat + (one << 48) * telemetry.updates);
    }
}

int main(void)
{
    each_part_of_a_legal_frame();
    confidences_are_read();
    encoders_refuse_or_write_every_member();
    return check_report();
}
