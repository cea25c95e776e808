/* The frame codec: any frame to each decoder, where an estimate that is taken is what its encoder makes
 * again; and any numbers to each encoder, which refuses them or makes a legal frame. */
#include "input.h"

static const mcp_asdf_frame_format_t estimates = MCP_ASDF_FORMAT_ESTIMATE, commands = MCP_ASDF_FORMAT_COMMAND;

/* Room for any message, to see whether a refusal leaves it as it was. */
typedef union {
    mcp_asdf_estimate_t estimate;
    mcp_asdf_telemetry_t telemetry;
    mcp_asdf_command_t command;
    mcp_asdf_heartbeat_t heartbeat;
    uint8_t bytes[16];
} message_t;

/* An estimate survives the way through the codec, but for an off-grid alpha that no robot sends. */
static void check_again(const mcp_asdf_frame_format_t *format, const mcp_asdf_estimate_t *message)
{
    mcp_asdf_frame_t frame;
    mcp_asdf_estimate_t again;
    memcpy(&again, message, sizeof again); /* with what stands between members */
    MUST(mcp_asdf_encode_estimate(&frame, format, message) == MCP_ASDF_FRAME_OK);
    MUST(mcp_asdf_decode_estimate(&again, format->subject, &frame) == MCP_ASDF_FRAME_OK);
    MUST(memcmp(&again, message, sizeof again) == 0);
}

static void any_frame(input_t *in, bool is_estimate, uint32_t detail)
{
    mcp_asdf_frame_t frame = {0};
    message_t message, before;
    memset(&message, 0xA5, sizeof message);
    memcpy(&before, &message, sizeof before);
    const uint16_t subject = (is_estimate ? estimates : commands).subject;
    frame.id = input_take(in, detail & 1 ? 4 : 1) ^ (detail & 1 ? 0 : MCP_ASDF_FRAME_FILTER(subject));
    frame.flags = (uint8_t)(detail & 2 ? input_take(in, 1) : 0);
    frame.length = (uint8_t)(detail & 4 ? input_take(in, 1) : 8);
    for (int i = 0; i < 8; ++i) {
        frame.data[i] = (uint8_t)input_take(in, 1);
    }
    frame.data[7] |= detail & 8 ? 0 : 0xE0;
    const mcp_asdf_frame_status_t status = is_estimate
                                               ? mcp_asdf_decode_estimate(&message.estimate, subject, &frame)
                                               : mcp_asdf_decode_command(&message.command, subject, &frame);
    if (status != MCP_ASDF_FRAME_OK) {
        MUST(memcmp(&message, &before, sizeof message) == 0);
    } else if (is_estimate) {
        check_again(&estimates, &message.estimate);
    }
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
    const mcp_asdf_frame_status_t status =
        kind == 0   ? mcp_asdf_encode_estimate(&frame, &format, &message.estimate)
        : kind == 1 ? mcp_asdf_encode_telemetry(&frame, &format, &message.telemetry)
                    : mcp_asdf_encode_heartbeat(&frame, format.priority, &message.heartbeat);
    if (status != MCP_ASDF_FRAME_OK) {
        MUST(same_frame(&frame, &before));
        return;
    }
    const uint16_t subject = kind > 1 ? MCP_ASDF_SUBJECT_HEARTBEAT : format.subject;
    MUST(frame.flags == 0 && frame.length == 8 && frame.id >> 29 == 0 && frame.data[7] >= 0xE0);
    MUST((frame.id & MCP_ASDF_FRAME_MASK) == MCP_ASDF_FRAME_FILTER(subject));
    if (kind == 0) {
        MUST(mcp_asdf_decode_estimate(&message.estimate, subject, &frame) == MCP_ASDF_FRAME_OK);
        check_again(&format, &message.estimate);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    input_t in = {data, size};
    const uint32_t what = input_take(&in, 1);
    if (what & 4) {
        any_numbers(&in, what & 3);
    } else {
        any_frame(&in, (what & 1) == 0, what >> 3);
    }
    return 0;
}
