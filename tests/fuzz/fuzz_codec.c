/* The frame codec: any frame to every decoder, and what one of them takes is what its encoder makes again;
 * and any numbers to every encoder, which refuses them or makes a frame that its decoder takes. */
#include "input.h"
#include "same_frame.h"

static const mcp_asdf_frame_format_t formats[] = {MCP_ASDF_FORMAT_ESTIMATE, MCP_ASDF_FORMAT_TELEMETRY,
                                                  MCP_ASDF_FORMAT_COMMAND};

/* Room for any message, to see whether a refusal leaves it as it was. */
typedef union {
    mcp_asdf_estimate_t estimate;
    mcp_asdf_telemetry_t telemetry;
    mcp_asdf_command_t command;
    mcp_asdf_heartbeat_t heartbeat;
    uint8_t bytes[16];
} message_t;

static mcp_asdf_frame_status_t decode(message_t *message, uint32_t kind, uint16_t subject,
                                      const mcp_asdf_frame_t *frame)
{
    switch (kind) {
    case 0:
        return mcp_asdf_decode_estimate(&message->estimate, subject, frame);
    case 1:
        return mcp_asdf_decode_telemetry(&message->telemetry, subject, frame);
    case 2:
        return mcp_asdf_decode_command(&message->command, subject, frame);
    default:
        return mcp_asdf_decode_heartbeat(&message->heartbeat, frame);
    }
}

static mcp_asdf_frame_status_t encode(mcp_asdf_frame_t *frame, uint32_t kind,
                                      const mcp_asdf_frame_format_t *format, const message_t *message)
{
    switch (kind) {
    case 0:
        return mcp_asdf_encode_estimate(frame, format, &message->estimate);
    case 1:
        return mcp_asdf_encode_telemetry(frame, format, &message->telemetry);
    case 2:
        return mcp_asdf_encode_command(frame, format, &message->command);
    default:
        return mcp_asdf_encode_heartbeat(frame, format->priority, &message->heartbeat);
    }
}

/* What survives another way through the codec, which is all but off-grid alphas and reserved bits. */
static void check_again(uint32_t kind, const mcp_asdf_frame_format_t *format, const message_t *message)
{
    mcp_asdf_frame_t frame;
    message_t again;
    memcpy(&again, message, sizeof again); /* with what stands between members */
    MUST(encode(&frame, kind, format, message) == MCP_ASDF_FRAME_OK);
    MUST(frame.flags == 0 && frame.length == 8 && frame.id >> 29 == 0);
    const uint16_t subject = kind == 3 ? MCP_ASDF_SUBJECT_HEARTBEAT : format->subject;
    MUST((frame.id & MCP_ASDF_FRAME_MASK) == MCP_ASDF_FRAME_FILTER(subject));
    MUST(decode(&again, kind, format->subject, &frame) == MCP_ASDF_FRAME_OK);
    MUST(memcmp(&again, message, sizeof again) == 0);
}

static void any_frame(input_t *in, uint32_t kind, uint32_t detail)
{
    mcp_asdf_frame_t frame = {0};
    message_t message, before;
    memset(&message, 0xA5, sizeof message);
    memcpy(&before, &message, sizeof before);
    const uint16_t subject = kind == 3 ? MCP_ASDF_SUBJECT_HEARTBEAT : formats[kind].subject;
    frame.id = input_take(in, detail & 1 ? 4 : 1) ^ (detail & 1 ? 0 : MCP_ASDF_FRAME_FILTER(subject));
    frame.flags = (uint8_t)(detail & 2 ? input_take(in, 1) : 0);
    frame.length = (uint8_t)(detail & 4 ? input_take(in, 1) : 8);
    for (int i = 0; i < 8; ++i) {
        frame.data[i] = (uint8_t)input_take(in, 1);
    }
    frame.data[7] |= detail & 8 ? 0 : 0xE0;
    if (decode(&message, kind, subject, &frame) != MCP_ASDF_FRAME_OK) {
        MUST(memcmp(&message, &before, sizeof message) == 0);
        return;
    }
    const mcp_asdf_frame_format_t format = {kind == 3 ? 0 : subject, (uint8_t)(frame.id >> 26)};
    check_again(kind, &format, &message);
}

static void any_numbers(input_t *in, uint32_t kind)
{
    const mcp_asdf_frame_t before = {.id = UINT32_C(0xA5A5A5A5), .length = 1};
    mcp_asdf_frame_t frame = before;
    message_t message;
    const mcp_asdf_frame_format_t format = {(uint16_t)input_take(in, 2), (uint8_t)input_take(in, 1)};
    for (size_t i = 0; i < sizeof message.bytes; ++i) {
        message.bytes[i] = (uint8_t)input_take(in, 1);
    }
    if (encode(&frame, kind, &format, &message) != MCP_ASDF_FRAME_OK) {
        MUST(same_frame(&frame, &before));
        return;
    }
    MUST(decode(&message, kind, format.subject, &frame) == MCP_ASDF_FRAME_OK);
    check_again(kind, &format, &message);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    input_t in = {data, size};
    const uint32_t what = input_take(&in, 1);
    if (what & 4) {
        any_numbers(&in, what & 3);
    } else {
        any_frame(&in, what & 3, what >> 3);
    }
    return 0;
}
