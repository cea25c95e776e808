/* A robot that speaks CAN over its serial line, by the protocol of Lawicel's adapters, and takes its clock
 * and its observations from command frames: the firmware in the loop of docs/platforms/serial.md. */
#include "slcan.h"

#include "../node/node.h"
#include "../port.h"

/* Settings of the build: id of robot and node, 0 .. 125; assumed accuracy at the start, 2^-20 .. 1 - 2^-20,
 * which the compiler converts, so that the robot needs no floating point; a mcp_asdf_filter_t; the filter's
 * period tau in ticks. */
#ifndef ROBOT_ID
#define ROBOT_ID 0
#endif
#ifndef ROBOT_B_HAT
#define ROBOT_B_HAT 0.55
#endif
#ifndef ROBOT_FILTER
#define ROBOT_FILTER MCP_ASDF_ADAPTIVE
#endif
#ifndef ROBOT_FILTER_PERIOD
#define ROBOT_FILTER_PERIOD 1000
#endif
#if ROBOT_ID < 0 || ROBOT_ID > 125
#error "ROBOT_ID has to be 0 to 125: Cyphal's tools keep 126 and 127 for themselves"
#endif
#if ROBOT_FILTER_PERIOD < 1 || ROBOT_FILTER_PERIOD > 0xFFFFFFFF
#error "ROBOT_FILTER_PERIOD has to be 1 to 4294967295 ticks"
#endif

extern const uint32_t mcp_asdf_t_table_omega05_q30[33];

static const node_settings_t settings = {
    .table = mcp_asdf_t_table_omega05_q30,
    .comms_period = 1,
    .filter_period = ROBOT_FILTER_PERIOD,
    .memory = MCP_ASDF_MEMORY_MAX,
    .filter = ROBOT_FILTER,
    .estimate_format = MCP_ASDF_FORMAT_ESTIMATE,
    .telemetry_format = MCP_ASDF_FORMAT_TELEMETRY,
    .command_format = MCP_ASDF_FORMAT_COMMAND,
    .b_hat = (uint32_t)(ROBOT_B_HAT * 4294967296.0 + 0.5), /* times 2^32, to nearest */
    .ticks_per_second = 10,
    .id = ROBOT_ID,
    .lockstep = true,
};

static slcan_link_t serial;
static node_t node;

/* Send a frame of the node over the serial line. Returns whether it is on its way. */
static bool send_to_serial(void *context, const mcp_asdf_frame_t *frame)
{
    return slcan_send_frame(context, frame);
}

static const node_output_t output = {.send = send_to_serial, .context = &serial};

/* Set the node's health, which its next heartbeat carries, and pass a frame to the node. The health is
 * nominal if up to now no line was lost, in either direction of the serial line, and every tick had a settle
 * command; else it is advisory. */
static void handle_frame(const mcp_asdf_frame_t *frame)
{
    const bool is_nominal =
        serial.dropped_lines == 0 && serial.unsent_lines == 0 && node.counts.unsettled_ticks == 0;
    node.health = is_nominal ? MCP_ASDF_HEALTH_NOMINAL : MCP_ASDF_HEALTH_ADVISORY;
    node_handle_frame(&node, frame);
}

/* Send one byte of the outbox if the serial line has room, or else receive one; sleep if there is nothing to
 * send or receive. Returns what a received byte brought, and writes *frame if it completes a frame; otherwise
 * returns SLCAN_NOTHING. */
static slcan_event_t exchange_byte(mcp_asdf_frame_t *frame)
{
    if (serial.outbox.byte_count > 0 && port_has_room()) {
        port_put(outbox_take(&serial.outbox));
        return SLCAN_NOTHING;
    }
    const int byte = port_get();
    if (byte == PORT_NOTHING && serial.outbox.byte_count == 0) {
        port_sleep();
    }
    return slcan_handle_byte(&serial, byte, frame);
}

/* Run the robot for ever. A host that opens the bus finds a robot that has just been switched on. Ends, with
 * status 1, only if the firmware refuses the settings of the build. */
int main(void)
{
    slcan_start(&serial);
    bool is_running = node_init(&node, &settings, output) == MCP_ASDF_OK;
    while (is_running) {
        mcp_asdf_frame_t frame;
        const slcan_event_t event = exchange_byte(&frame);
        if (event == SLCAN_OPENED) {
            is_running = node_init(&node, &settings, output) == MCP_ASDF_OK;
            node_start(&node);
        } else if (event == SLCAN_FRAME) {
            handle_frame(&frame);
        }
    }
    return 1;
}
