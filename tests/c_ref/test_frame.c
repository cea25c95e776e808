/* Black box: the frame codec. The rules are those of docs/frame.md, written once more with division and
 * remainder instead of masks; the examples are worked out by hand. */
#include "mcp_asdf_frame.h"

#include "check.h"

#include <string.h>

#define ALPHA_ONE UINT32_C(0x80000001)
#define LARGEST_ALPHA UINT32_C(0xFFFFFF1F) /* 2^31 - 2^7 */
#define INFINITE UINT32_C(0x7F800000)      /* as binary32 */

static const mcp_asdf_frame_format_t estimates = MCP_ASDF_FORMAT_ESTIMATE;
static const mcp_asdf_frame_format_t telemetry_format = MCP_ASDF_FORMAT_TELEMETRY;
static const mcp_asdf_frame_format_t commands = MCP_ASDF_FORMAT_COMMAND;

/* What a kind's decoder says, and whether it kept its promise to write nothing on failure. */
static mcp_asdf_frame_status_t decode(int kind, const mcp_asdf_frame_t *frame)
{
    union {
        mcp_asdf_estimate_t estimate;
        mcp_asdf_heartbeat_t heartbeat;
        mcp_asdf_telemetry_t telemetry;
        mcp_asdf_command_t command;
        uint8_t bytes[16];
    } message, before;
    mcp_asdf_frame_status_t status;
    memset(&message, 0xA5, sizeof message);
    before = message;
    if (kind == 0) {
        status = mcp_asdf_decode_estimate(&message.estimate, estimates.subject, frame);
    } else if (kind == 1) {
        status = mcp_asdf_decode_heartbeat(&message.heartbeat, frame);
    } else if (kind == 2) {
        status = mcp_asdf_decode_telemetry(&message.telemetry, telemetry_format.subject, frame);
    } else {
        status = mcp_asdf_decode_command(&message.command, commands.subject, frame);
    }
    CHECK(status == MCP_ASDF_FRAME_OK || memcmp(&message, &before, sizeof message) == 0);
    return status;
}

static const uint32_t subjects[] = {3000, 7509, 3001, 3002};

/* One legal frame of each kind, from node 42 with transfer id 5. */
static mcp_asdf_frame_t legal(int kind)
{
    static const mcp_asdf_frame_t frames[] = {
        {UINT32_C(0x106BB82A), 0, 8, {0x00, 0x00, 0x40, 0x00, 0x00, 0x80, 0x3F, 0xE5}},
        {UINT32_C(0x107D552A), 0, 8, {0x04, 0x03, 0x02, 0x01, 0x02, 0x01, 0x99, 0xE5}},
        {UINT32_C(0x186BB92A), 0, 8, {0x00, 0x00, 0x60, 0x33, 0x33, 0xF3, 0x07, 0xE5}},
        {UINT32_C(0x0C6BBA2A), 0, 8, {0x04, 0x03, 0x02, 0x01, 0x11, 0x03, 0x00, 0xE5}},
    };
    return frames[kind];
}

static bool same_frame(const mcp_asdf_frame_t *a, const mcp_asdf_frame_t *b)
{
    return a->id == b->id && a->flags == b->flags && a->length == b->length &&
           memcmp(a->data, b->data, 8) == 0;
}

static void examples_estimate_and_heartbeat(void)
{
    mcp_asdf_frame_t frame, expected = legal(0);
    const mcp_asdf_estimate_t estimate = {42, 5, UINT32_C(1) << 22, ALPHA_ONE};
    mcp_asdf_estimate_t heard;
    CHECK_EQUAL(mcp_asdf_encode_estimate(&frame, &estimates, &estimate), MCP_ASDF_FRAME_OK);
    CHECK(same_frame(&frame, &expected));
    CHECK_EQUAL(mcp_asdf_decode_estimate(&heard, 3000, &frame), MCP_ASDF_FRAME_OK);
    CHECK(heard.node == 42 && heard.transfer_id == 5 && heard.x_hat == estimate.x_hat);
    CHECK_EQUAL(heard.alpha, estimate.alpha);

    const mcp_asdf_heartbeat_t heartbeat = {
        42, 5, MCP_ASDF_HEALTH_CAUTION, MCP_ASDF_MODE_INITIALIZATION, 0x99, UINT32_C(0x01020304)};
    mcp_asdf_heartbeat_t beat;
    expected = legal(1);
    CHECK_EQUAL(mcp_asdf_encode_heartbeat(&frame, 4, &heartbeat), MCP_ASDF_FRAME_OK);
    CHECK(same_frame(&frame, &expected));
    CHECK_EQUAL(mcp_asdf_decode_heartbeat(&beat, &frame), MCP_ASDF_FRAME_OK);
    CHECK(beat.node == 42 && beat.transfer_id == 5 && beat.health == 2 && beat.mode == 1);
    CHECK(beat.vendor_status == 0x99 && beat.uptime == heartbeat.uptime);
}

static void examples_telemetry_and_command(void)
{
    mcp_asdf_frame_t frame, expected = legal(2);
    const mcp_asdf_telemetry_t telemetry = {42, 5, 7, UINT32_C(0x600000), UINT32_C(0xF33333)};
    mcp_asdf_telemetry_t seen;
    CHECK_EQUAL(mcp_asdf_encode_telemetry(&frame, &telemetry_format, &telemetry), MCP_ASDF_FRAME_OK);
    CHECK(same_frame(&frame, &expected));
    memset(&seen, 0xA5, sizeof seen);
    CHECK_EQUAL(mcp_asdf_decode_telemetry(&seen, 3001, &frame), MCP_ASDF_FRAME_OK);
    CHECK(seen.node == 42 && seen.transfer_id == 5 && seen.updates == 7);
    CHECK(seen.x == telemetry.x && seen.b_hat == telemetry.b_hat);

    const mcp_asdf_command_t command = {42, 5, 17, MCP_ASDF_SETTLE, UINT32_C(0x01020304)};
    mcp_asdf_command_t order;
    expected = legal(3);
    CHECK_EQUAL(mcp_asdf_encode_command(&frame, &commands, &command), MCP_ASDF_FRAME_OK);
    CHECK(same_frame(&frame, &expected));
    memset(&order, 0xA5, sizeof order);
    CHECK_EQUAL(mcp_asdf_decode_command(&order, 3002, &frame), MCP_ASDF_FRAME_OK);
    CHECK(order.node == 42 && order.transfer_id == 5 && order.target == 17);
    CHECK(order.action == MCP_ASDF_SETTLE && order.tick == command.tick);
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
    if (kind == 1) {
        return data[5] % 8 <= 3 ? MCP_ASDF_FRAME_OK : MCP_ASDF_FRAME_ERR_MODE;
    }
    if (kind == 3) {
        if (data[4] >= 128 && data[4] < 255)
            return MCP_ASDF_FRAME_ERR_TARGET;
        return data[5] <= 3 ? MCP_ASDF_FRAME_OK : MCP_ASDF_FRAME_ERR_ACTION;
    }
    if (number(data, 3) > 8388608) {
        return kind == 0 ? MCP_ASDF_FRAME_ERR_X_HAT : MCP_ASDF_FRAME_ERR_X;
    }
    if (kind == 0) { /* the exponent of a finite number is below 255; the sign is the highest bit */
        return number(data + 3, 4) / 8388608 < 255 ? MCP_ASDF_FRAME_OK : MCP_ASDF_FRAME_ERR_ALPHA;
    }
    return number(data + 3, 3) >= 16 && number(data + 3, 3) <= 16777200 ? MCP_ASDF_FRAME_OK
                                                                        : MCP_ASDF_FRAME_ERR_B_HAT;
}

static void agrees(const mcp_asdf_frame_t *frame)
{
    for (int kind = 0; kind < 4; ++kind) {
        GIVEN(kind, frame->id, number(frame->data, 4) | (uint64_t)number(frame->data + 4, 4) << 32);
        const mcp_asdf_frame_status_t status = decode(kind, frame), expected = by_the_text(kind, frame);
        CHECK_EQUAL(-status, -expected);
    }
}

static void every_single_bit(void)
{
    for (int kind = 0; kind < 4; ++kind) {
        for (int bit = 0; bit < 32; ++bit) {
            mcp_asdf_frame_t frame = legal(kind);
            frame.id ^= UINT32_C(1) << bit;
            agrees(&frame);
        }
        for (int bit = 0; bit < 64; ++bit) {
            mcp_asdf_frame_t frame = legal(kind);
            frame.data[bit / 8] = (uint8_t)(frame.data[bit / 8] ^ 1u << bit % 8);
            agrees(&frame);
        }
        for (int value = 0; value < 256; ++value) {
            mcp_asdf_frame_t flagged = legal(kind), sized = flagged;
            flagged.flags = (uint8_t)value;
            sized.length = (uint8_t)value;
            agrees(&flagged);
            agrees(&sized);
        }
    }
}

/* Every byte of every legal frame takes every value: all ends of all ranges that one byte decides. */
static void every_byte(void)
{
    for (int kind = 0; kind < 4; ++kind) {
        for (int at = 0; at < 8; ++at) {
            for (int value = 0; value < 256; ++value) {
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

static void ends_of_wide_ranges(void)
{
    static const uint32_t alphas[] = {0,          1,          0x7FFFFF,   0x800000,   INFINITE - 1,
                                      INFINITE,   0x7F800001, 0x7FC00000, 0x7FFFFFFF, 0x80000000,
                                      0xBF800000, 0xFFFFFFFF};
    static const uint32_t fractions[] = {0,        1,        15,       16,       17,       0x7FFFFF, 0x800000,
                                         0x800001, 0xFFFFEF, 0xFFFFF0, 0xFFFFF1, 0xFFFFFF, 0x400000};
    for (size_t i = 0; i < COUNT(alphas); ++i) {
        mcp_asdf_frame_t frame = legal(0);
        set_number(frame.data + 3, alphas[i], 4);
        agrees(&frame);
    }
    for (size_t i = 0; i < COUNT(fractions); ++i) {
        mcp_asdf_frame_t estimate = legal(0), x = legal(2), b_hat = x;
        set_number(estimate.data, fractions[i], 3);
        set_number(x.data, fractions[i], 3);
        set_number(b_hat.data + 3, fractions[i], 3);
        agrees(&estimate);
        agrees(&x);
        agrees(&b_hat);
    }
}

static void anything(void)
{
    for (int i = 0; i < 100000; ++i) {
        const uint64_t bits = check_random(), data = check_random();
        mcp_asdf_frame_t frame = legal((int)(bits & 3));
        if (bits >> 2 & 1)
            frame.id = (uint32_t)(bits >> 32);
        if ((bits >> 3 & 3) == 0)
            frame.flags = (uint8_t)(bits >> 8);
        if ((bits >> 5 & 3) == 0)
            frame.length = (uint8_t)(bits >> 16 & 15);
        set_number(frame.data, (uint32_t)data, 4);
        set_number(frame.data + 4, (uint32_t)(data >> 32), bits >> 7 & 1 ? 4 : 3);
        agrees(&frame);
    }
}

/* ---- Confidences: the core's word in memory, binary32 in the frame ---- */

/* The number that a word is, of at most 24 significant bits: exact in binary32. */
static float value_of(uint32_t word)
{
    return (float)(word >> 8) * (float)(UINT32_C(1) << (word & 31)) / 16777216.0F;
}

static uint32_t bits_of(float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
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

/* The binary32 number in the frame is the word's, and comes back as the same number. */
static void check_word(uint32_t word)
{
    const mcp_asdf_estimate_t sent = {42, 5, 1, word};
    mcp_asdf_estimate_t heard = {0, 0, 0, 0};
    mcp_asdf_frame_t frame;
    GIVEN(word, 0, 0);
    CHECK_EQUAL(mcp_asdf_encode_estimate(&frame, &estimates, &sent), MCP_ASDF_FRAME_OK);
    CHECK_EQUAL(number(frame.data + 3, 4), bits_of(value_of(word)));
    CHECK_EQUAL(mcp_asdf_decode_estimate(&heard, 3000, &frame), MCP_ASDF_FRAME_OK);
    CHECK_EQUAL(heard.alpha, plain_word(word));
}

/* Every shift, with all short mantissas, those around each power of two, and random ones; ignored bits. */
static void words_go_through_exactly(void)
{
    for (uint32_t shift = 0; shift < 32; ++shift) {
        for (uint32_t mantissa = 0; mantissa < 600; ++mantissa) {
            check_word(mantissa << 8 | shift);
            check_word((0xFFFFFF - mantissa) << 8 | shift);
            check_word((uint32_t)check_random() << 8 | shift | (mantissa & 7) << 5);
        }
        for (uint32_t bit = 1; bit < 24; ++bit) {
            const uint32_t power = UINT32_C(1) << bit;
            check_word(power << 8 | shift);
            check_word((power - 1) << 8 | shift);
            check_word((power + 1) << 8 | shift | 0xE0);
        }
    }
}

/* The largest confidence not above the number: a multiple of 2^-24, at most 2^31 - 2^7. */
static void check_binary32(uint32_t bits)
{
    mcp_asdf_frame_t frame = legal(0);
    mcp_asdf_estimate_t heard = {0, 0, 0, 0};
    float alpha;
    memcpy(&alpha, &bits, sizeof alpha);
    const double units = (double)alpha * 16777216.0, most = 16777215.0 * 2147483648.0;
    const uint64_t whole = units >= most ? UINT64_C(0xFFFFFF) << 31 : (uint64_t)units; /* rounded down */
    set_number(frame.data + 3, bits, 4);
    GIVEN(bits, 0, 0);
    CHECK_EQUAL(mcp_asdf_decode_estimate(&heard, 3000, &frame), MCP_ASDF_FRAME_OK);
    CHECK_EQUAL((uint64_t)(heard.alpha >> 8) << (heard.alpha & 31), whole);
    CHECK_EQUAL(heard.alpha, plain_word(heard.alpha));
}

/* Every exponent of a finite number, with the ends of its fractions, all single bits and random ones. */
static void every_exponent_of_binary32(void)
{
    for (uint32_t exponent = 0; exponent < 255; ++exponent) {
        for (uint32_t bit = 0; bit < 24; ++bit) {
            const uint32_t power = UINT32_C(1) << bit, ones = power - 1;
            check_binary32(exponent << 23 | (power & 0x7FFFFF));
            check_binary32(exponent << 23 | ones);
            check_binary32(exponent << 23 | (0x7FFFFF ^ ones));
        }
        for (int i = 0; i < 200; ++i) {
            check_binary32(exponent << 23 | ((uint32_t)check_random() & 0x7FFFFF));
        }
    }
}

/* ---- Any message ---- */

/* What an encoder takes is what the decoder takes, and comes back; what it refuses leaves the frame alone. */
static void estimates_of_any_numbers(void)
{
    for (int i = 0; i < 100000; ++i) {
        const uint64_t bits = check_random();
        const mcp_asdf_estimate_t message = {(uint8_t)(bits & 0x9F), (uint8_t)(bits >> 8),
                                             (uint32_t)(bits >> 16 & 0x1FFFFFF) % 0x800010,
                                             check_random_word()};
        const mcp_asdf_frame_format_t format = {(uint16_t)((bits >> 41 & 0x1FFF) % 6200),
                                                (uint8_t)(bits >> 54 & 15)};
        mcp_asdf_frame_t frame, before;
        mcp_asdf_estimate_t heard;
        memset(&frame, 0x5A, sizeof frame);
        before = frame;
        GIVEN(message.x_hat, message.alpha, bits);
        const bool is_legal =
            message.node < 128 && format.subject < 6144 && format.priority < 8 && message.x_hat <= 8388608;
        CHECK_EQUAL(mcp_asdf_encode_estimate(&frame, &format, &message) == MCP_ASDF_FRAME_OK, is_legal);
        if (!is_legal) {
            CHECK(same_frame(&frame, &before));
            continue;
        }
        CHECK_EQUAL(frame.id >> 26, format.priority);
        CHECK_EQUAL(frame.id & MCP_ASDF_FRAME_MASK, MCP_ASDF_FRAME_FILTER(format.subject));
        CHECK_EQUAL(mcp_asdf_decode_estimate(&heard, format.subject, &frame), MCP_ASDF_FRAME_OK);
        CHECK(heard.node == message.node && heard.x_hat == message.x_hat);
        CHECK_EQUAL(heard.alpha, plain_word(message.alpha));
        CHECK_EQUAL(heard.transfer_id, message.transfer_id % 32);
    }
}

/* "Spare bits beside health and mode are ignored" */
static void heartbeats_of_every_health_and_mode(void)
{
    for (uint8_t both = 0; both < 16; ++both) {
        const mcp_asdf_heartbeat_t sent = {1, 2, both % 4, both / 4, 3, 4};
        mcp_asdf_heartbeat_t beat = {0, 0, 0, 0, 0, 0};
        mcp_asdf_frame_t frame;
        GIVEN(sent.health, sent.mode, 0);
        CHECK_EQUAL(mcp_asdf_encode_heartbeat(&frame, 0, &sent), MCP_ASDF_FRAME_OK);
        CHECK(frame.data[4] == sent.health && frame.data[5] == sent.mode);
        frame.data[4] = (uint8_t)(frame.data[4] | 0xFC);
        frame.data[5] = (uint8_t)(frame.data[5] | 0xF8);
        CHECK_EQUAL(mcp_asdf_decode_heartbeat(&beat, &frame), MCP_ASDF_FRAME_OK);
        CHECK(beat.health == sent.health && beat.mode == sent.mode);
    }
}

static mcp_asdf_frame_t untouched;

#define REFUSED(call, expected)                                                                              \
    do {                                                                                                     \
        mcp_asdf_frame_t frame = untouched;                                                                  \
        CHECK_EQUAL(-(call), -(expected));                                                                   \
        CHECK(same_frame(&frame, &untouched));                                                               \
    } while (0)

static void what_encoders_refuse(void)
{
    const mcp_asdf_frame_format_t subject = {6144, 7}, priority = {6143, 8};
    const mcp_asdf_estimate_t good = {127, 0, UINT32_C(1) << 23, LARGEST_ALPHA}, node = {128, 0, 0, 0};
    const mcp_asdf_estimate_t x_hat = {0, 0, (UINT32_C(1) << 23) + 1, 0};
    const mcp_asdf_heartbeat_t health = {0, 0, 4, 0, 0, 0}, mode = {0, 0, 0, 4, 0, 0},
                               beat = {127, 0, 3, 3, 255, 0};
    const mcp_asdf_heartbeat_t beat_node = {128, 0, 0, 0, 0, 0};
    memset(&untouched, 0x5A, sizeof untouched);
    REFUSED(mcp_asdf_encode_estimate(&frame, &subject, &good), MCP_ASDF_FRAME_ERR_FORMAT);
    REFUSED(mcp_asdf_encode_estimate(&frame, &priority, &good), MCP_ASDF_FRAME_ERR_FORMAT);
    REFUSED(mcp_asdf_encode_estimate(&frame, &estimates, &node), MCP_ASDF_FRAME_ERR_NODE);
    REFUSED(mcp_asdf_encode_estimate(&frame, &estimates, &x_hat), MCP_ASDF_FRAME_ERR_X_HAT);
    REFUSED(mcp_asdf_encode_heartbeat(&frame, 7, &beat_node), MCP_ASDF_FRAME_ERR_NODE);
    REFUSED(mcp_asdf_encode_heartbeat(&frame, 8, &beat), MCP_ASDF_FRAME_ERR_FORMAT);
    REFUSED(mcp_asdf_encode_heartbeat(&frame, 7, &health), MCP_ASDF_FRAME_ERR_HEALTH);
    REFUSED(mcp_asdf_encode_heartbeat(&frame, 7, &mode), MCP_ASDF_FRAME_ERR_MODE);
}

static void what_encoders_refuse_of_the_optional_kinds(void)
{
    const mcp_asdf_frame_format_t priority = {6143, 8};
    const mcp_asdf_telemetry_t x = {0, 0, 0, 8388609, 16}, least = {0, 0, 0, 0, 15},
                               most = {0, 0, 0, 0, 16777201};
    const mcp_asdf_telemetry_t node = {128, 0, 0, 0, 16}, good = {0, 0, 0, 0, 16};
    const mcp_asdf_command_t target = {0, 0, 128, 0, 0}, below_all = {0, 0, 254, 0, 0},
                             action = {0, 0, 255, 4, 0};
    const mcp_asdf_command_t sender = {128, 0, 0, 0, 0}, order = {0, 0, 0, 0, 0};
    REFUSED(mcp_asdf_encode_telemetry(&frame, &telemetry_format, &x), MCP_ASDF_FRAME_ERR_X);
    REFUSED(mcp_asdf_encode_telemetry(&frame, &telemetry_format, &least), MCP_ASDF_FRAME_ERR_B_HAT);
    REFUSED(mcp_asdf_encode_telemetry(&frame, &telemetry_format, &most), MCP_ASDF_FRAME_ERR_B_HAT);
    REFUSED(mcp_asdf_encode_telemetry(&frame, &telemetry_format, &node), MCP_ASDF_FRAME_ERR_NODE);
    REFUSED(mcp_asdf_encode_telemetry(&frame, &priority, &good), MCP_ASDF_FRAME_ERR_FORMAT);
    REFUSED(mcp_asdf_encode_command(&frame, &commands, &target), MCP_ASDF_FRAME_ERR_TARGET);
    REFUSED(mcp_asdf_encode_command(&frame, &commands, &below_all), MCP_ASDF_FRAME_ERR_TARGET);
    REFUSED(mcp_asdf_encode_command(&frame, &commands, &action), MCP_ASDF_FRAME_ERR_ACTION);
    REFUSED(mcp_asdf_encode_command(&frame, &commands, &sender), MCP_ASDF_FRAME_ERR_NODE);
    REFUSED(mcp_asdf_encode_command(&frame, &priority, &order), MCP_ASDF_FRAME_ERR_FORMAT);
}

static void encoders_take_the_ends_of_all_ranges(void)
{
    const mcp_asdf_frame_format_t last = {6143, 7};
    const mcp_asdf_estimate_t estimate = {127, 255, UINT32_C(1) << 23, UINT32_MAX};
    const mcp_asdf_heartbeat_t heartbeat = {127, 255, 3, 3, 255, UINT32_MAX};
    const mcp_asdf_telemetry_t least = {127, 255, 255, 0, 16}, most = {127, 255, 255, 8388608, 16777200};
    const mcp_asdf_command_t one = {127, 255, 127, 3, UINT32_MAX}, all = {127, 255, 255, 3, UINT32_MAX};
    mcp_asdf_frame_t frame;
    CHECK_EQUAL(mcp_asdf_encode_estimate(&frame, &last, &estimate), MCP_ASDF_FRAME_OK);
    CHECK_EQUAL(mcp_asdf_encode_heartbeat(&frame, 7, &heartbeat), MCP_ASDF_FRAME_OK);
    CHECK_EQUAL(mcp_asdf_encode_telemetry(&frame, &last, &least), MCP_ASDF_FRAME_OK);
    CHECK_EQUAL(mcp_asdf_encode_telemetry(&frame, &last, &most), MCP_ASDF_FRAME_OK);
    CHECK_EQUAL(mcp_asdf_encode_command(&frame, &last, &one), MCP_ASDF_FRAME_OK);
    CHECK_EQUAL(mcp_asdf_encode_command(&frame, &last, &all), MCP_ASDF_FRAME_OK);
}

/* "exactly those whose identifier decode accepts" */
static void the_acceptance_filter_passes_what_decode_accepts(void)
{
    for (int i = 0; i < 100000; ++i) {
        mcp_asdf_frame_t frame = legal(0);
        frame.id =
            i & 1 ? frame.id ^ UINT32_C(1) << check_random() % 29 : (uint32_t)(check_random() & 0x1FFFFFFF);
        GIVEN(frame.id, 0, 0);
        CHECK_EQUAL((frame.id & MCP_ASDF_FRAME_MASK) == MCP_ASDF_FRAME_FILTER(3000),
                    decode(0, &frame) == MCP_ASDF_FRAME_OK);
    }
}

static void no_frame_has_a_larger_subject(void)
{
    mcp_asdf_frame_t frame = legal(0);
    mcp_asdf_estimate_t heard;
    CHECK_EQUAL(-mcp_asdf_decode_estimate(&heard, 3000 + 8192, &frame), -MCP_ASDF_FRAME_ERR_SUBJECT);
    CHECK_EQUAL(-mcp_asdf_decode_estimate(&heard, 3000 + 16384, &frame), -MCP_ASDF_FRAME_ERR_SUBJECT);
    CHECK_EQUAL(-mcp_asdf_decode_estimate(&heard, 3000 + 32768, &frame), -MCP_ASDF_FRAME_ERR_SUBJECT);
}

int main(void)
{
    examples_estimate_and_heartbeat();
    examples_telemetry_and_command();
    every_single_bit();
    every_byte();
    ends_of_wide_ranges();
    anything();
    words_go_through_exactly();
    every_exponent_of_binary32();
    estimates_of_any_numbers();
    heartbeats_of_every_health_and_mode();
    what_encoders_refuse();
    what_encoders_refuse_of_the_optional_kinds();
    encoders_take_the_ends_of_all_ranges();
    the_acceptance_filter_passes_what_decode_accepts();
    no_frame_has_a_larger_subject();
    return check_report();
}
