/* The frame codec against the rules of docs/design.md, which are written here once more: with division,
 * remainder and floating point instead of masks and shifts. tests/host_tools/bus compares any frame, and the
 * acceptance filter, with the codec in Python. */
#include "mcp_asdf_frame.h"

#include "check.h"

#include <string.h>

/* The kinds of frames that a robot decodes. */
enum { ESTIMATE, COMMAND, KIND_COUNT };

static const uint16_t subjects[KIND_COUNT] = {3000, 3002};

/* From node 42 with transfer id 5. */
static const mcp_asdf_frame_t valid_estimate = {
    UINT32_C(0x106BB82A), 0, 8, {0x00, 0x00, 0x40, 0x00, 0x00, 0x80, 0x3F, 0xE5}};
static const mcp_asdf_frame_t valid_command = {
    UINT32_C(0x0C6BBA2A), 0, 8, {0x04, 0x03, 0x02, 0x01, 0x11, 0x03, 0x00, 0xE5}};

static mcp_asdf_frame_t valid_frame(int kind) { return kind == ESTIMATE ? valid_estimate : valid_command; }

/* Value of little-endian bytes. */
static uint64_t read_number(const uint8_t *bytes, int count)
{
    uint64_t value = 0;
    while (count > 0) {
        value = value * 256 + bytes[--count];
    }
    return value;
}

/* ---- Confidences: alpha words in memory, binary32 numbers in frames ---- */

/* Bits of the float that an alpha word is: exact, as a mantissa has 24 bits. */
static uint32_t expected_binary32(uint32_t word)
{
    const float value = (float)((double)(word / 256) * (double)(UINT32_C(1) << word % 32) / 16777216);
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

/* The word of the largest confidence not above a finite number, with the smallest shift. */
static uint32_t expected_alpha_word(uint32_t binary32)
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

/* Decode a frame as one of this kind, and return the status. Checks that all members were read, or after an
 * error none was written. */
static mcp_asdf_frame_status_t decode_and_check_members(int kind, const mcp_asdf_frame_t *frame)
{
    union {
        mcp_asdf_estimate_t estimate;
        mcp_asdf_command_t command;
        uint8_t bytes[16];
    } message, before;
    memset(&message, 0xA5, sizeof message);
    before = message;
    const mcp_asdf_frame_status_t status =
        kind == ESTIMATE ? mcp_asdf_decode_estimate(&message.estimate, subjects[ESTIMATE], frame)
                         : mcp_asdf_decode_command(&message.command, subjects[COMMAND], frame);
    const uint32_t node = frame->id % 128, transfer_id = frame->data[7] % 32;
    if (status != MCP_ASDF_FRAME_OK) {
        CHECK(memcmp(&message, &before, sizeof message) == 0);
    } else if (kind == ESTIMATE) {
        CHECK(message.estimate.node == node && message.estimate.transfer_id == transfer_id);
        CHECK_EQUAL(message.estimate.x_hat, read_number(frame->data, 3));
        CHECK_EQUAL(message.estimate.alpha, expected_alpha_word((uint32_t)read_number(frame->data + 3, 4)));
    } else {
        CHECK(message.command.node == node && message.command.transfer_id == transfer_id);
        CHECK(message.command.target == frame->data[4] && message.command.action == frame->data[5]);
        CHECK_EQUAL(message.command.tick, read_number(frame->data, 4));
    }
    return status;
}

/* Status of a frame by docs/design.md, whatever its content: the first error in the order of the header. */
static mcp_asdf_frame_status_t expected_envelope_status(const mcp_asdf_frame_t *frame, uint32_t subject)
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

/* Status of a frame of this kind by docs/design.md. */
static mcp_asdf_frame_status_t expected_status(int kind, const mcp_asdf_frame_t *frame)
{
    const mcp_asdf_frame_status_t envelope = expected_envelope_status(frame, subjects[kind]);
    const uint8_t *const data = frame->data;
    if (envelope != MCP_ASDF_FRAME_OK) {
        return envelope;
    }
    if (kind == ESTIMATE) { /* the exponent of a finite number is below 255; the sign is the highest bit */
        if (read_number(data, 3) > 8388608)
            return MCP_ASDF_FRAME_ERR_X_HAT;
        return read_number(data + 3, 4) / 8388608 < 255 ? MCP_ASDF_FRAME_OK : MCP_ASDF_FRAME_ERR_ALPHA;
    }
    if (data[4] >= 128 && data[4] < 255)
        return MCP_ASDF_FRAME_ERR_TARGET;
    return data[5] <= 3 ? MCP_ASDF_FRAME_OK : MCP_ASDF_FRAME_ERR_ACTION;
}

/* Check that both decoders return what docs/design.md says. */
static void check_decoders(const mcp_asdf_frame_t *frame)
{
    for (int kind = 0; kind < KIND_COUNT; ++kind) {
        GIVEN(kind, frame->id, read_number(frame->data, 8));
        CHECK_EQUAL(-decode_and_check_members(kind, frame), -expected_status(kind, frame));
    }
}

static void decoders_check_every_bit_of_the_identifier(void)
{
    for (int kind = 0; kind < KIND_COUNT; ++kind) {
        for (int bit = 0; bit < 32; ++bit) {
            mcp_asdf_frame_t frame = valid_frame(kind);
            frame.id ^= UINT32_C(1) << bit;
            check_decoders(&frame);
        }
    }
}

static void decoders_check_flags_and_length(void)
{
    for (int kind = 0; kind < KIND_COUNT; ++kind) {
        for (int value = 0; value < 256; ++value) {
            mcp_asdf_frame_t flagged = valid_frame(kind), sized = valid_frame(kind);
            flagged.flags = (uint8_t)value;
            sized.length = (uint8_t)value;
            check_decoders(&flagged);
            check_decoders(&sized);
        }
    }
}

static void decoders_read_or_refuse_every_value_of_each_byte(void)
{
    for (int kind = 0; kind < KIND_COUNT; ++kind) {
        for (int value = 0; value < 256; ++value) {
            for (int index = 0; index < 8; ++index) {
                mcp_asdf_frame_t frame = valid_frame(kind);
                frame.data[index] = (uint8_t)value;
                check_decoders(&frame);
            }
        }
    }
}

/* Random numbers, and numbers near limits: one unit, too large for a word, not finite, negative. */
/* design: R16 */
static void decoders_round_any_binary32_number_to_an_alpha_word(void)
{
    static const uint32_t ends[] = {0x33800000, 0x4F000000, 0x7F800000, 0x80000000};
    for (uint32_t i = 0; i < 100000; ++i) {
        mcp_asdf_frame_t frame = valid_estimate;
        const uint32_t binary32 = i % 2 == 0 ? check_random_word() : ends[i / 2 % 4] - 3 + i % 7;
        for (int index = 0; index < 4; ++index) {
            frame.data[3 + index] = (uint8_t)(binary32 >> 8 * index);
        }
        check_decoders(&frame);
    }
}

/* ---- Encoders ---- */

/* A limit of some member, or a number beside one. */
static uint32_t random_limit(void)
{
    static const uint32_t limits[] = {0,   1,   3,    4,    7,    8,       15,      16,       127,
                                      128, 255, 3000, 6143, 6144, 8388608, 8388609, 16777200, 16777201};
    return limits[check_random_word() % COUNT(limits)];
}

static uint8_t random_byte(void) { return (uint8_t)random_limit(); }

/* A frame before it is encoded, and the result that the encoder should have.
 *   status   of the encoder; the first error counts
 *   id       identifier without the subject
 *   tail     the last byte of the data, in its place */
typedef struct {
    mcp_asdf_frame_t frame;
    mcp_asdf_frame_format_t format;
    uint8_t node, transfer_id;
    mcp_asdf_frame_status_t status;
    uint32_t id;
    uint64_t tail;
} encoding_t;

/* An encoding by a node in a format. The node or the format may be invalid. */
static encoding_t random_encoding(void)
{
    encoding_t encoding = {.format = {(uint16_t)random_limit(), random_byte()},
                           .node = random_byte(),
                           .transfer_id = random_byte(),
                           .status = MCP_ASDF_FRAME_OK};
    memset(&encoding.frame, 0x5A, sizeof encoding.frame);
    if (encoding.node > 127) {
        encoding.status = MCP_ASDF_FRAME_ERR_NODE;
    } else if (encoding.format.subject > 6143 || encoding.format.priority > 7) {
        encoding.status = MCP_ASDF_FRAME_ERR_FORMAT;
    }
    encoding.id = encoding.format.priority * 67108864U + 6291456U + encoding.node;
    encoding.tail = (uint64_t)(224 + encoding.transfer_id % 32) << 56;
    GIVEN(encoding.node, encoding.format.subject, encoding.format.priority);
    return encoding;
}

/* Expect an error of a member, unless there is an earlier one. */
static void expect_error_if(encoding_t *encoding, bool is_invalid, mcp_asdf_frame_status_t error)
{
    if (is_invalid && encoding->status == MCP_ASDF_FRAME_OK) {
        encoding->status = error;
    }
}

/* Check status and frame of an encoder: a frame of these 7 bytes, or after an error the frame as it was. */
static void check_encoding(const encoding_t *encoding, mcp_asdf_frame_status_t status, uint32_t subject,
                           uint64_t content)
{
    mcp_asdf_frame_t unchanged;
    memset(&unchanged, 0x5A, sizeof unchanged);
    CHECK_EQUAL(-status, -encoding->status);
    if (encoding->status == MCP_ASDF_FRAME_OK) {
        CHECK_EQUAL(encoding->frame.id, encoding->id + subject * 256U);
        CHECK(encoding->frame.flags == 0 && encoding->frame.length == 8);
        CHECK_EQUAL(read_number(encoding->frame.data, 8), content + encoding->tail);
    } else {
        CHECK(memcmp(&encoding->frame, &unchanged, sizeof unchanged) == 0);
    }
}

#define ENCODINGS 100000

static void estimates_are_written_or_refused(void)
{
    for (uint32_t i = 0; i < ENCODINGS; ++i) {
        encoding_t encoding = random_encoding();
        const mcp_asdf_estimate_t estimate = {encoding.node, encoding.transfer_id, random_limit(),
                                              check_random_word()};
        expect_error_if(&encoding, estimate.x_hat > 8388608, MCP_ASDF_FRAME_ERR_X_HAT);
        const mcp_asdf_frame_status_t status =
            mcp_asdf_encode_estimate(&encoding.frame, &encoding.format, &estimate);
        const uint64_t alpha = expected_binary32(estimate.alpha);
        check_encoding(&encoding, status, encoding.format.subject, estimate.x_hat + (alpha << 24));
    }
}

static void heartbeats_are_written_or_refused(void)
{
    for (uint32_t i = 0; i < ENCODINGS; ++i) {
        encoding_t encoding = random_encoding();
        const mcp_asdf_heartbeat_t heartbeat = {encoding.node, encoding.transfer_id, random_byte(),
                                                random_byte(), random_byte(),        check_random_word()};
        if (encoding.node <= 127 && encoding.format.priority <= 7) {
            encoding.status = MCP_ASDF_FRAME_OK; /* a heartbeat has a fixed subject, not the format's */
        }
        expect_error_if(&encoding, heartbeat.health > 3, MCP_ASDF_FRAME_ERR_HEALTH);
        expect_error_if(&encoding, heartbeat.mode > 3, MCP_ASDF_FRAME_ERR_MODE);
        const mcp_asdf_frame_status_t status =
            mcp_asdf_encode_heartbeat(&encoding.frame, encoding.format.priority, &heartbeat);
        const uint64_t health = heartbeat.health, mode = heartbeat.mode, vendor = heartbeat.vendor_status;
        check_encoding(&encoding, status, 7509,
                       heartbeat.uptime + (health << 32) + (mode << 40) + (vendor << 48));
    }
}

static void telemetry_is_written_or_refused(void)
{
    for (uint32_t i = 0; i < ENCODINGS; ++i) {
        encoding_t encoding = random_encoding();
        const mcp_asdf_telemetry_t telemetry = {encoding.node, encoding.transfer_id, random_byte(),
                                                random_limit(), random_limit()};
        expect_error_if(&encoding, telemetry.x > 8388608, MCP_ASDF_FRAME_ERR_X);
        expect_error_if(&encoding, telemetry.b_hat < 16 || telemetry.b_hat > 16777200,
                        MCP_ASDF_FRAME_ERR_B_HAT);
        const mcp_asdf_frame_status_t status =
            mcp_asdf_encode_telemetry(&encoding.frame, &encoding.format, &telemetry);
        const uint64_t b_hat = telemetry.b_hat, updates = telemetry.updates;
        check_encoding(&encoding, status, encoding.format.subject,
                       telemetry.x + (b_hat << 24) + (updates << 48));
    }
}

int main(void)
{
    decoders_check_every_bit_of_the_identifier();
    decoders_check_flags_and_length();
    decoders_read_or_refuse_every_value_of_each_byte();
    decoders_round_any_binary32_number_to_an_alpha_word();
    estimates_are_written_or_refused();
    heartbeats_are_written_or_refused();
    telemetry_is_written_or_refused();
    return check_report();
}
