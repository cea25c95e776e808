/* A robot that speaks CAN over its serial line, by the protocol of Lawicel's adapters, and takes its clock
 * and its observations from command frames: the firmware in the loop of docs/firmware_in_the_loop.md. */
#include "slcan.h"

#include "../node/node.h"
#include "../port.h"

/* Chosen when it is built: robot and node, 0 .. 125; assumed accuracy at the start, 2^-20 .. 1 - 2^-20, a
 * fraction that only the compiler sees; a mcp_asdf_filter_t; tau in ticks. */
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
    .estimate = MCP_ASDF_FORMAT_ESTIMATE,
    .telemetry = MCP_ASDF_FORMAT_TELEMETRY,
    .command = MCP_ASDF_FORMAT_COMMAND,
    .b_hat = (uint32_t)(ROBOT_B_HAT * 4294967296.0 + 0.5),
    .ticks_per_second = 10,
    .id = ROBOT_ID,
    .lockstep = true,
};

static slcan_link_t serial;
static node_t node;

static bool send(void *context, const mcp_asdf_frame_t *frame) { return slcan_send(context, frame); }

static const node_output_t output = {.send = send, .context = &serial};

static void hear(const mcp_asdf_frame_t *frame)
{
    const bool is_well = serial.dropped == 0 && serial.unsent == 0 && node.counts.unsettled == 0;
    node.health = is_well ? MCP_ASDF_HEALTH_NOMINAL : MCP_ASDF_HEALTH_ADVISORY;
    node_hear(&node, frame);
}

/* One byte goes out, or one comes in. */
static slcan_event_t turn(mcp_asdf_frame_t *frame)
{
    if (serial.outbox.waiting > 0 && port_has_room()) {
        port_put(outbox_take(&serial.outbox));
        return SLCAN_NOTHING;
    }
    const int byte = port_get();
    if (byte == PORT_NOTHING && serial.outbox.waiting == 0) {
        port_sleep();
    }
    return slcan_take(&serial, byte, frame);
}

/* A host that opens the bus finds a robot that has just been switched on. Ends, with status 1, only if it was
 * built with settings that the firmware refuses. */
int main(void)
{
    slcan_start(&serial);
    bool runs = node_init(&node, &settings, output) == MCP_ASDF_OK;
    while (runs) {
        mcp_asdf_frame_t frame;
        const slcan_event_t event = turn(&frame);
        if (event == SLCAN_OPENED) {
            runs = node_init(&node, &settings, output) == MCP_ASDF_OK;
            node_start(&node);
        } else if (event == SLCAN_FRAME) {
            hear(&frame);
        }
    }
    return 1;
}
