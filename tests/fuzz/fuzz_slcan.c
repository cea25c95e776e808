/* A node receives any bytes over its serial line, some of which are lost: lines are handled or dropped as a
 * whole, the outbox never holds more than it can, a frame that is written as a line is read as the same
 * frame, and the robot's invariants hold. */
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

/* Send a frame of the node, after checking that its line is read as the same frame. */
static bool send(void *link, const mcp_asdf_frame_t *frame)
{
    char line[SLCAN_LINE_MAX];
    mcp_asdf_frame_t read;
    const uint8_t length = slcan_format_frame(line, frame);
    MUST(length == 26 && slcan_parse_frame(&read, line, length));
    MUST(same_frame(&read, frame));
    return slcan_send_frame(link, frame);
}

/* Check that a line which was read as a frame is what this frame is written as, but for small letters. */
static void check_line(const char *line, uint8_t length, const mcp_asdf_frame_t *frame)
{
    char again[SLCAN_LINE_MAX];
    const int id_bits = (frame->flags & MCP_ASDF_FRAME_STANDARD) != 0 ? 11 : 29;
    MUST(frame->id >> id_bits == 0);
    MUST(slcan_format_frame(again, frame) == length);
    for (uint8_t i = 0; i < length; ++i) {
        MUST(((line[i] ^ again[i]) & ~0x20) == 0); /* small letters have this bit more */
    }
}

/* Let the adapter handle a byte, or that one is lost, and the node what comes of it. Checks that a frame is
 * written for SLCAN_FRAME alone. */
static void receive_byte(slcan_link_t *link, node_t *node, int byte)
{
    const mcp_asdf_frame_t before = {.id = UINT32_C(0xA5A5A5A5), .length = 8};
    mcp_asdf_frame_t frame = before;
    const slcan_link_t link_before = *link;
    const slcan_event_t event = slcan_handle_byte(link, byte, &frame);
    MUST(link->line_length <= SLCAN_LINE_MAX && link->outbox.byte_count <= OUTBOX_SIZE);
    if (event == SLCAN_FRAME) {
        check_line(link_before.line, link_before.line_length, &frame);
        node_handle_frame(node, &frame);
        MUST(mcp_asdf_invariants_hold(&node->robot));
    } else if (event == SLCAN_OPENED) {
        node_start(node);
    }
    MUST(event == SLCAN_FRAME || !link_before.is_open || same_frame(&frame, &before));
}

/* Check that a frame made of the input, legal or not, is either refused or written as a line that is read as
 * the same frame. */
static void check_any_frame(input_t in)
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

/* Returns what port_get() returns for a byte of the input: two values stand for its special returns. */
static int byte_of_port(uint8_t byte)
{
    switch (byte) {
    case 0xFF:
        return PORT_LOST;
    case 0:
        return PORT_NOTHING;
    default:
        return byte;
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static slcan_link_t link;
    static node_t node;
    check_any_frame((input_t){data, size});
    slcan_start(&link);
    MUST(node_init(&node, &settings, (node_output_t){send, &link}) == MCP_ASDF_OK);
    for (size_t i = 0; i < size; ++i) {
        if (data[i] == 0xFE) { /* the host takes what has waited */
            while (link.outbox.byte_count > 0) {
                (void)outbox_take(&link.outbox);
            }
        } else {
            receive_byte(&link, &node, byte_of_port(data[i]));
        }
    }
    return 0;
}
