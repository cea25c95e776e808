/* A serial line with any bytes on it, lost ones included, and the node behind it: lines are taken or dropped
 * whole, the outbox never holds more than it can, what is written is read back, and the robot stays possible.
 */
#include "input.h"
#include "mcp_asdf_image.h"
#include "node/node.h"
#include "port.h"
#include "slcan/slcan.h"

extern const uint32_t mcp_asdf_t_table_omega05_q30[];

static const node_settings_t settings = {.table = mcp_asdf_t_table_omega05_q30,
                                         .comms_period = 1,
                                         .filter_period = 3,
                                         .memory = 64,
                                         .estimate_format = MCP_ASDF_FORMAT_ESTIMATE,
                                         .telemetry_format = MCP_ASDF_FORMAT_TELEMETRY,
                                         .command_format = MCP_ASDF_FORMAT_COMMAND,
                                         .b_hat = UINT32_C(0xC0000000),
                                         .ticks_per_second = 3,
                                         .id = 5,
                                         .lockstep = true};

static bool send(void *link, const mcp_asdf_frame_t *frame)
{
    char line[SLCAN_LINE_MAX];
    mcp_asdf_frame_t read;
    const uint8_t length = slcan_format_frame(line, frame);
    MUST(length == 26 && slcan_parse_frame(&read, line, length));
    MUST(same_frame(&read, frame));
    return slcan_send_frame(link, frame);
}

/* A line that was taken is what is written of its frame, but for the size of letters. */
static void check_line(const char *line, uint8_t length, const mcp_asdf_frame_t *frame)
{
    char again[SLCAN_LINE_MAX];
    MUST(frame->id >> (frame->flags & MCP_ASDF_FRAME_STANDARD ? 11 : 29) == 0);
    MUST(slcan_format_frame(again, frame) == length);
    for (uint8_t i = 0; i < length; ++i) {
        MUST(((line[i] ^ again[i]) & ~0x20) == 0);
    }
}

static void any_byte(slcan_link_t *link, node_t *node, int byte)
{
    const mcp_asdf_frame_t before = {.id = UINT32_C(0xA5A5A5A5), .length = 8};
    mcp_asdf_frame_t frame = before;
    const slcan_link_t then = *link;
    const slcan_event_t event = slcan_handle_byte(link, byte, &frame);
    MUST(link->line_length <= SLCAN_LINE_MAX && link->outbox.byte_count <= OUTBOX_SIZE);
    if (event == SLCAN_FRAME) {
        check_line(then.line, then.line_length, &frame);
        node_handle_frame(node, &frame);
        MUST(mcp_asdf_invariants_hold(&node->robot));
    } else if (event == SLCAN_OPENED) {
        node_start(node);
    }
    MUST(event == SLCAN_FRAME || !then.is_open || same_frame(&frame, &before));
}

/* Any frame, legal or not, is either refused or written as a line that reads as it. */
static void any_frame(input_t in)
{
    char line[SLCAN_LINE_MAX];
    mcp_asdf_frame_t read, frame = {.id = input_take(&in, 4),
                                    .flags = input_take(&in, 1) & 15,
                                    .length = (uint8_t)input_take(&in, 1)};
    for (int i = 0; i < 8 && i < frame.length && (frame.flags & MCP_ASDF_FRAME_REMOTE) == 0; ++i) {
        frame.data[i] = (uint8_t)input_take(&in, 1);
    }
    const uint8_t length = slcan_format_frame(line, &frame);
    MUST(length == 0 || (slcan_parse_frame(&read, line, length) && same_frame(&read, &frame)));
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static slcan_link_t link;
    static node_t node;
    any_frame((input_t){data, size});
    slcan_start(&link);
    MUST(node_init(&node, &settings, (node_output_t){send, &link}) == MCP_ASDF_OK);
    for (size_t i = 0; i < size; ++i) {
        if (data[i] == 0xFE) { /* the host takes what has waited */
            while (link.outbox.byte_count > 0) {
                (void)outbox_take(&link.outbox);
            }
        } else {
            any_byte(&link, &node, data[i] == 0xFF ? PORT_LOST : data[i] == 0 ? PORT_NOTHING : data[i]);
        }
    }
    return 0;
}
