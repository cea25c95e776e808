/* The node; node.h is its manual. */
#include "node.h"

#include <stddef.h>

#define HEARTBEAT_PRIORITY 4

/* Frames refused before their content is looked at: kernel filters keep those frames away. */
#define IS_OTHER(status) ((status) >= MCP_ASDF_FRAME_ERR_SUBJECT)

mcp_asdf_status_t node_init(node_t *node, const node_settings_t *settings, node_output_t output)
{
    const uint32_t period = settings->comms_period, tau = settings->filter_period;
    if (period == 0 || tau % period != 0) {
        return MCP_ASDF_ERR_CONFIG;
    }
    *node = (node_t){.settings = settings, .output = output, .comms_left = period, .is_settled = true};
    node->config = (mcp_asdf_config_t){settings->table, tau / period, settings->memory, settings->filter};
    return mcp_asdf_init(&node->robot, &node->config, settings->id, settings->b_hat);
}

/* ---- Saying how things are now ---------------------------------------------------------------------- */

static void send(node_t *node, const mcp_asdf_frame_t *frame)
{
    if (!node->output.send(node->output.context, frame)) {
        ++node->counts.unsent;
    }
}

static void send_heartbeat(node_t *node)
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

void node_start(node_t *node)
{
    node->counts.heartbeats = 0;
    send_heartbeat(node);
}

static void send_estimate(node_t *node)
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

static void send_telemetry(node_t *node)
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

/* ---- Ticking ---------------------------------------------------------------------------------------- */

static void end_tick(node_t *node)
{
    if (node->comms_left == 0) {
        (void)mcp_asdf_settle(&node->robot);
        node->comms_left = node->settings->comms_period;
    }
    node->is_settled = true;
}

void node_observe(node_t *node, mcp_asdf_action_t seen)
{
    if (!node->is_settled) {
        ++node->counts.unsettled;
        end_tick(node);
    }
    if (node->ticks != 0 && node->ticks % node->settings->ticks_per_second == 0) {
        send_heartbeat(node);
    }
    if (seen != MCP_ASDF_OBSERVE_NONE) {
        (void)mcp_asdf_observe(&node->robot, (mcp_asdf_observation_t)seen);
    }
    if (--node->comms_left == 0) {
        send_estimate(node);
    }
    ++node->ticks;
    node->is_settled = false;
}

void node_settle(node_t *node)
{
    const uint32_t period = node->settings->lockstep ? 1 : node->settings->telemetry_period;
    end_tick(node);
    if (period != 0 && node->ticks % period == 0) {
        send_telemetry(node);
    }
}

/* ---- Hearing ---------------------------------------------------------------------------------------- */

static void obey(node_t *node, const mcp_asdf_command_t *command)
{
    const bool settles = command->action == MCP_ASDF_SETTLE;
    const bool is_open = !node->is_settled && command->tick == node->number;
    if (command->target != node->settings->id && command->target != MCP_ASDF_EVERY_ROBOT) {
        return;
    }
    if (settles != is_open) {
        ++node->counts.disobeyed;
        return;
    }
    ++node->counts.obeyed;
    if (settles) {
        node_settle(node);
    } else {
        node->number = command->tick;
        node_observe(node, (mcp_asdf_action_t)command->action);
    }
}

/* The word alpha in units of 2^-24: below 2^24 2^31. */
static uint64_t units(uint32_t alpha) { return (uint64_t)(alpha >> 8) << (alpha & 31U); }

static void watch(node_t *node, const mcp_asdf_estimate_t *estimate)
{
    node_sender_t *sender = &node->senders[estimate->node];
    const uint64_t before = units(sender->alpha), now = units(estimate->alpha);
    const bool is_watched = sender->heard == NODE_WATCHED_AFTER;
    /* After an alpha of 0 nobody is watched. */
    node->counts.jumps += is_watched && now >= 2 * before;
    if (2 * now <= before) { /* it has begun anew */
        sender->heard = 0;
    } else if (!is_watched) {
        ++sender->heard;
    }
    sender->alpha = estimate->alpha;
}

static void take(node_t *node, const mcp_asdf_estimate_t *estimate)
{
    const uint8_t id = estimate->node;
    const bool is_own = id == node->settings->id;
    if (node->senders != NULL) {
        watch(node, estimate);
    }
    if (!is_own && (node->settings->ignore[id / 8] >> id % 8 & 1) != 0) {
        ++node->counts.unknown;
        return;
    }
    ++node->counts.heard;
    node->counts.collisions += is_own;
    (void)mcp_asdf_receive(&node->robot, id, estimate->x_hat, estimate->alpha);
}

void node_hear(node_t *node, const mcp_asdf_frame_t *frame)
{
    mcp_asdf_estimate_t estimate;
    mcp_asdf_command_t command;
    mcp_asdf_frame_status_t status =
        mcp_asdf_decode_estimate(&estimate, node->settings->estimate.subject, frame);
    if (status == MCP_ASDF_FRAME_OK) {
        take(node, &estimate);
        return;
    }
    if (status == MCP_ASDF_FRAME_ERR_SUBJECT && node->settings->lockstep) {
        status = mcp_asdf_decode_command(&command, node->settings->command.subject, frame);
        if (status == MCP_ASDF_FRAME_OK) {
            obey(node, &command);
            return;
        }
    }
    node->counts.others += IS_OTHER(status);
    node->counts.refused += !IS_OTHER(status);
}
