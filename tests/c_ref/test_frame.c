/* Black box: the frame codec. The rules are those of docs/frame.md, written once more with division and
 * remainder instead of masks; the examples are worked out by hand. tests/host_tools/bus compares any
 * frame, and the acceptance filter, with the codec in Python. */
#include "mcp_asdf_frame.h"

#include "check.h"

#include <string.h>

#define KINDS 2 /* that a robot decodes: estimate, command */

static const mcp_asdf_frame_format_t estimates = MCP_ASDF_FORMAT_ESTIMATE;
static const uint16_t subjects[KINDS] = {3000, 3002};

/* From node 42 with transfer id 5. */
static const mcp_asdf_frame_t legal_estimate = {
    UINT32_C(0x106BB82A), 0, 8, {0x00, 0x00, 0x40, 0x00, 0x00, 0x80, 0x3F, 0xE5}};
static const mcp_asdf_frame_t legal_command = {
    UINT32_C(0x0C6BBA2A), 0, 8, {0x04, 0x03, 0x02, 0x01, 0x11, 0x03, 0x00, 0xE5}};

static mcp_asdf_frame_t legal(int kind) { return kind == 0 ? legal_estimate : legal_command; }

/* ---- Decoders ---- */

/* What a kind's decoder says, and whether it kept its promise to write nothing on failure. */
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
    CHECK(status == MCP_ASDF_FRAME_OK || memcmp(&message, &before, sizeof message) == 0);
    return status;
}

/* The status by the text of docs/frame.md, for the envelope. */
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

static uint32_t number(const uint8_t *bytes, int count)
{
    uint32_t value = 0;
    while (count > 0) {
        value = value * 256 + bytes[--count];
    }
    return value;
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
        GIVEN(kind, frame->id, number(frame->data, 4) | (uint64_t)number(frame->data + 4, 4) << 32);
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

static void set_number(uint8_t *bytes, uint32_t value, int count)
{
    for (int i = 0; i < count; ++i) {
        bytes[i] = (uint8_t)(value >> 8 * i);
    }
}

static void every_member_is_read(void)
{
    mcp_asdf_estimate_t heard;
    mcp_asdf_command_t order;
    CHECK_EQUAL(mcp_asdf_decode_estimate(&heard, 3000, &legal_estimate), MCP_ASDF_FRAME_OK);
    CHECK(heard.node == 42 && heard.transfer_id == 5 && heard.x_hat == UINT32_C(1) << 22);
    CHECK_EQUAL(heard.alpha, 0x80000001);
    memset(&order, 0xA5, sizeof order);
    CHECK_EQUAL(mcp_asdf_decode_command(&order, 3002, &legal_command), MCP_ASDF_FRAME_OK);
    CHECK(order.node == 42 && order.transfer_id == 5 && order.target == 17);
    CHECK(order.action == MCP_ASDF_SETTLE && order.tick == UINT32_C(0x01020304));
}

/* ---- Confidences: the core's word in memory, binary32 in the frame ---- */

typedef struct {
    uint32_t word, binary32;
} confidence_t;

/* Words, and the binary32 numbers of the same values: units of 2^-24, all shifts' ends, bits to ignore. */
static const confidence_t sent[] = {
    {0x00000000, 0x00000000}, {0x0000001F, 0x00000000}, {0x00000100, 0x33800000}, {0x00000101, 0x34000000},
    {0x00000300, 0x34400000}, {0x0000011F, 0x43000000}, {0x7FFFFF00, 0x3EFFFFFE}, {0x7FFFFF1F, 0x4E7FFFFE},
    {0x80000000, 0x3F000000}, {0x80000001, 0x3F800000}, {0x800000E1, 0x3F800000}, {0xC0000002, 0x40400000},
    {0xABCDEF1F, 0x4EABCDEF}, {0x80000100, 0x3F000001}, {0xABCDEF10, 0x472BCDEF}, {0xFFFFFF00, 0x3F7FFFFF},
    {0xFFFFFF1F, 0x4EFFFFFF},
};

/* Numbers that no word is, and the word of the largest confidence not above each. */
static const confidence_t rounded[] = {
    {0x00000000, 0x00000001}, {0x00000000, 0x00800000}, {0x00000000, 0x337FFFFF},
    {0x00000100, 0x33FFFFFF}, {0x00000300, 0x347FFFFF}, {0x7FFFFF00, 0x3EFFFFFF},
    {0x40000000, 0x3E800001}, {0xFFFFFF1F, 0x4F000000}, {0xFFFFFF1F, 0x7F7FFFFF},
};

static void check_heard(uint32_t binary32, uint32_t word)
{
    mcp_asdf_frame_t frame = legal_estimate;
    mcp_asdf_estimate_t heard = {0, 0, 0, 0};
    set_number(frame.data + 3, binary32, 4);
    GIVEN(word, binary32, 0);
    CHECK_EQUAL(mcp_asdf_decode_estimate(&heard, 3000, &frame), MCP_ASDF_FRAME_OK);
    CHECK_EQUAL(heard.alpha, word);
}

/* The same number as a word with the smallest shift and no bits to ignore. */
static uint32_t plain_word(uint32_t word)
{
    uint32_t mantissa = word >> 8, shift = word & 31;
    for (; shift > 0 && mantissa < UINT32_C(1) << 23; --shift) {
        mantissa <<= 1;
    }
    return mantissa == 0 ? 0 : mantissa << 8 | shift;
}

/* design: R16 */
static void confidences_are_converted(void)
{
    for (size_t i = 0; i < COUNT(sent); ++i) {
        const mcp_asdf_estimate_t message = {42, 5, 1, sent[i].word};
        mcp_asdf_frame_t frame;
        CHECK_EQUAL(mcp_asdf_encode_estimate(&frame, &estimates, &message), MCP_ASDF_FRAME_OK);
        CHECK_EQUAL(number(frame.data + 3, 4), sent[i].binary32);
        check_heard(sent[i].binary32, plain_word(sent[i].word));
    }
    for (size_t i = 0; i < COUNT(rounded); ++i) {
        check_heard(rounded[i].binary32, rounded[i].word);
    }
}

/* ---- Encoders ---- */

/* A format, a message of each kind, and what their encoders say, the first complaint first: 0 stands for OK.
 */
typedef struct {
    mcp_asdf_frame_format_t format;
    uint8_t node;
    uint32_t x_hat;
    uint8_t health, mode;
    uint32_t x, b_hat;
    int estimate, heartbeat, telemetry;
} trial_t;

enum {
    FORMAT = MCP_ASDF_FRAME_ERR_FORMAT,
    NODE = MCP_ASDF_FRAME_ERR_NODE,
    X_HAT = MCP_ASDF_FRAME_ERR_X_HAT,
    HEALTH = MCP_ASDF_FRAME_ERR_HEALTH,
    MODE = MCP_ASDF_FRAME_ERR_MODE,
    X = MCP_ASDF_FRAME_ERR_X,
    B_HAT = MCP_ASDF_FRAME_ERR_B_HAT
};

static const trial_t trials[] = {
    {{6143, 7}, 127, 8388608, 3, 3, 8388608, 16777200, 0, 0, 0},
    {{0, 0}, 0, 0, 0, 0, 0, 16, 0, 0, 0},
    {{6144, 7}, 127, 8388609, 0, 0, 8388609, 16, FORMAT, 0, FORMAT},
    {{0, 8}, 127, 0, 4, 0, 0, 16, FORMAT, FORMAT, FORMAT},
    {{6144, 8}, 128, 8388609, 4, 4, 0, 0, NODE, NODE, NODE},
    {{9, 0}, 1, 8388609, 4, 4, 8388609, 15, X_HAT, HEALTH, X},
    {{9, 0}, 1, 1, 3, 4, 1, 15, 0, MODE, B_HAT},
    {{9, 0}, 1, 1, 0, 0, 1, 16777201, 0, 0, B_HAT},
};

/* A frame that was made is that of these bytes; one that was refused is as it was. */
static void check_frame(const mcp_asdf_frame_t *frame, int status, int expected, uint32_t id,
                        const uint8_t data[8])
{
    CHECK_EQUAL(-status, -expected);
    if (expected == 0) {
        CHECK(frame->id == id && frame->flags == 0 && frame->length == 8);
        CHECK(memcmp(frame->data, data, 8) == 0);
    } else {
        CHECK(frame->id == 0x5A && frame->flags == 0x5A && frame->length == 0x5A && frame->data[0] == 0x5A);
    }
}

static void encoders_refuse_or_write_every_member(void)
{
    for (size_t i = 0; i < COUNT(trials); ++i) {
        const trial_t *const of = &trials[i];
        const uint8_t transfer = (uint8_t)(i * 37), tail = (uint8_t)(224 + transfer % 32);
        const uint32_t id = of->format.priority * 67108864U + 6291456U + of->node;
        const uint32_t envelope = id + of->format.subject * 256U;
        const mcp_asdf_frame_t blank = {0x5A, 0x5A, 0x5A, {0x5A}};
        uint8_t data[8] = {0, 0, 0, 0, 0, 0, 0, tail};
        mcp_asdf_frame_t frame = blank;
        GIVEN(i, of->node, of->format.subject);
        set_number(data, of->x_hat, 3);
        set_number(data + 3, 0x3F800000, 4);
        const mcp_asdf_estimate_t estimate = {of->node, transfer, of->x_hat, 0x80000001};
        check_frame(&frame, mcp_asdf_encode_estimate(&frame, &of->format, &estimate), of->estimate, envelope,
                    data);
        frame = blank;
        set_number(data, 0x01020304, 4);
        set_number(data + 4, of->health + of->mode * 256U + 0x990000, 3);
        const mcp_asdf_heartbeat_t beat = {of->node, transfer, of->health, of->mode, 0x99, 0x01020304};
        check_frame(&frame, mcp_asdf_encode_heartbeat(&frame, of->format.priority, &beat), of->heartbeat,
                    id + 7509U * 256U, data);
        frame = blank;
        set_number(data, of->x, 3);
        set_number(data + 3, of->b_hat, 3);
        data[6] = 7;
        const mcp_asdf_telemetry_t telemetry = {of->node, transfer, 7, of->x, of->b_hat};
        check_frame(&frame, mcp_asdf_encode_telemetry(&frame, &of->format, &telemetry), of->telemetry,
                    envelope, data);
    }
}

int main(void)
{
    each_part_of_a_legal_frame();
    every_member_is_read();
    confidences_are_converted();
    encoders_refuse_or_write_every_member();
    return check_report();
}
