/* The frame codec: any frame to each decoder, and an estimate that is taken to its encoder and back. */
#include "input.h"

static const mcp_asdf_frame_format_t estimates = MCP_ASDF_FORMAT_ESTIMATE, commands = MCP_ASDF_FORMAT_COMMAND;

/* Room for any message, to see whether a refusal leaves it as it was. */
typedef union {
    mcp_asdf_estimate_t estimate;
    mcp_asdf_command_t command;
    uint8_t bytes[16];
} message_t;

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    input_t in = {data, size};
    const uint32_t what = input_take(&in, 1), detail = what >> 3;
    const bool is_estimate = (what & 1) == 0;
    mcp_asdf_frame_t frame = {0};
    message_t message, before;
    memset(&message, 0xA5, sizeof message);
    memcpy(&before, &message, sizeof before);
    const uint16_t subject = (is_estimate ? estimates : commands).subject;
    frame.id = input_take(&in, detail & 1 ? 4 : 1) ^ (detail & 1 ? 0 : MCP_ASDF_FRAME_FILTER(subject));
    frame.flags = (uint8_t)(detail & 2 ? input_take(&in, 1) : 0);
    frame.length = (uint8_t)(detail & 4 ? input_take(&in, 1) : 8);
    for (int i = 0; i < 8; ++i) {
        frame.data[i] = (uint8_t)input_take(&in, 1);
    }
    frame.data[7] |= detail & 8 ? 0 : 0xE0;
    const mcp_asdf_frame_status_t status = is_estimate
                                               ? mcp_asdf_decode_estimate(&message.estimate, subject, &frame)
                                               : mcp_asdf_decode_command(&message.command, subject, &frame);
    if (status != MCP_ASDF_FRAME_OK) {
        MUST(memcmp(&message, &before, sizeof message) == 0);
    } else if (is_estimate) {
        memcpy(&before, &message, sizeof before); /* with what stands between members */
        MUST(mcp_asdf_encode_estimate(&frame, &estimates, &message.estimate) == MCP_ASDF_FRAME_OK);
        MUST(mcp_asdf_decode_estimate(&message.estimate, subject, &frame) == MCP_ASDF_FRAME_OK);
        MUST(memcmp(&message, &before, sizeof message) == 0);
    }
    return 0;
}
