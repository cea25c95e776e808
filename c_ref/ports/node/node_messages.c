/* Frames that a node sends; node.h is its manual. */
#include "node.h"

#define HEARTBEAT_PRIORITY 4

static void send(node_t *node, const mcp_asdf_frame_t *frame)
{
    if (!node->output.send(node->output.context, frame)) {
        ++node->counts.unsent;
    }
}

void node_send_heartbeat(node_t *node)
{
    const mcp_asdf_heartbeat_t message = {.node = node->settings->id,
                                          .transfer_id = (uint8_t)node->counts.heartbeats++,
                                          .health = node->health,
                                          .mode = MCP_ASDF_MODE_OPERATIONAL,
                                          .uptime = node->ticks / node->settings->ticks_per_second};
    mcp_asdf_frame_t frame;
    if (mcp_asdf_encode_heartbeat(&frame, HEARTBEAT_PRIORITY, &message) == MCP_ASDF_FRAME_OK) {
        send(node, &frame);
    }
}

void node_start(node_t *node) { node_send_heartbeat(node); }

void node_send_estimate(node_t *node)
{
    const mcp_asdf_estimate_t message = {.node = node->settings->id,
                                         .transfer_id = (uint8_t)node->counts.estimates++,
                                         .x_hat = mcp_asdf_x_hat(&node->robot),
                                         .alpha = mcp_asdf_alpha(&node->robot)};
    mcp_asdf_frame_t frame;
    if (mcp_asdf_encode_estimate(&frame, &node->settings->estimate, &message) == MCP_ASDF_FRAME_OK) {
        send(node, &frame);
    }
}

void node_send_telemetry(node_t *node)
{
    const mcp_asdf_telemetry_t message = {.node = node->settings->id,
                                          .transfer_id = (uint8_t)node->counts.telemetry++,
                                          .updates = (uint8_t)mcp_asdf_counters(&node->robot).updates,
                                          .x = mcp_asdf_x(&node->robot),
                                          .b_hat = mcp_asdf_b_hat(&node->robot) >> 8};
    mcp_asdf_frame_t frame;
    if (mcp_asdf_encode_telemetry(&frame, &node->settings->telemetry, &message) == MCP_ASDF_FRAME_OK) {
        send(node, &frame);
    }
}
