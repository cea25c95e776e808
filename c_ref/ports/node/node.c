/* The node; node.h is its manual. */
#include "node.h"

#include <stddef.h>

#define HEARTBEAT_PRIORITY 4

/* Initialise the node and its robot. The robot's filter period is the period of the settings, in rounds.
 * Returns the status of mcp_asdf_init(); or ERR_CONFIG, and leaves *node as it was, if comms_period is 0 or
 * filter_period no multiple of it. */
mcp_asdf_status_t node_init(node_t *node, const node_settings_t *settings, node_output_t output)
{
    const uint32_t comms_period = settings->comms_period, filter_period = settings->filter_period;
    if (comms_period == 0 || filter_period % comms_period != 0) {
        return MCP_ASDF_ERR_CONFIG;
    }
    *node = (node_t){
        .settings = settings, .output = output, .ticks_until_broadcast = comms_period, .is_settled = true};
    /* The firmware counts rounds, each of which lasts comms_period ticks. */
    node->config = (mcp_asdf_config_t){.table = settings->table,
                                       .filter_period = filter_period / comms_period,
                                       .memory = settings->memory,
                                       .filter = settings->filter};
    return mcp_asdf_init(&node->robot, &node->config, settings->id, settings->b_hat);
}

/* ---- Sending ---------------------------------------------------------------------------------------- */

/* Send a frame to the node's output. Counts it as unsent if the bus does not accept it. */
static void send_frame(node_t *node, const mcp_asdf_frame_t *frame)
{
    if (!node->output.send(node->output.context, frame)) {
        ++node->counts.unsent_frames;
    }
}

/* Send a heartbeat with the present health, and count it: its transfer id is the number of those before it,
 * modulo 2^8. */
static void send_heartbeat(node_t *node)
{
    const uint8_t transfer_id = (uint8_t)node->counts.heartbeats;
    ++node->counts.heartbeats;
    const mcp_asdf_heartbeat_t heartbeat = {.node = node->settings->id,
                                            .transfer_id = transfer_id,
                                            .health = node->health,
                                            .mode = MCP_ASDF_MODE_OPERATIONAL,
                                            .uptime = node->ticks / node->settings->ticks_per_second};
    mcp_asdf_frame_t frame;
    if (mcp_asdf_encode_heartbeat(&frame, HEARTBEAT_PRIORITY, &heartbeat) == MCP_ASDF_FRAME_OK) {
        send_frame(node, &frame);
    }
}

/* Send x_hat and alpha to the neighbours, and count the estimate. Its transfer id is the number of those
 * before it, modulo 2^8. */
static void send_estimate(node_t *node)
{
    const uint8_t transfer_id = (uint8_t)node->counts.estimates;
    ++node->counts.estimates;
    const mcp_asdf_estimate_t estimate = {.node = node->settings->id,
                                          .transfer_id = transfer_id,
                                          .x_hat = mcp_asdf_x_hat(&node->robot),
                                          .alpha = mcp_asdf_alpha(&node->robot)};
    mcp_asdf_frame_t frame;
    if (mcp_asdf_encode_estimate(&frame, &node->settings->estimate_format, &estimate) == MCP_ASDF_FRAME_OK) {
        send_frame(node, &frame);
    }
}

/* Send x, b_hat and the number of updates modulo 2^8 to observers of the bus, and count the telemetry. Its
 * transfer id is the number of telemetry frames before it, modulo 2^8. */
static void send_telemetry(node_t *node)
{
    const uint8_t transfer_id = (uint8_t)node->counts.telemetry;
    ++node->counts.telemetry;
    const mcp_asdf_telemetry_t telemetry = {.node = node->settings->id,
                                            .transfer_id = transfer_id,
                                            .updates = (uint8_t)mcp_asdf_counters(&node->robot).updates,
                                            .x = mcp_asdf_x(&node->robot),
                                            .b_hat = mcp_asdf_b_hat(&node->robot) >> 8}; /* Q32 to Q24 */
    mcp_asdf_frame_t frame;
    if (mcp_asdf_encode_telemetry(&frame, &node->settings->telemetry_format, &telemetry) ==
        MCP_ASDF_FRAME_OK) {
        send_frame(node, &frame);
    }
}

/* Send the first heartbeat. */
void node_start(node_t *node)
{
    node->counts.heartbeats = 0; /* a repeated first heartbeat has the same transfer id */
    send_heartbeat(node);
}

/* ---- Ticks ------------------------------------------------------------------------------------------ */

/* End the open tick: `is_settled` then says that no tick is open. If the tick is a broadcast tick, which is
 * one in which ticks_until_broadcast has come to 0, mcp_asdf_settle() also ends the firmware's round, in
 * which the robot has received estimates since the last broadcast tick, and forms its informed estimate of
 * them; and the count down to the next broadcast begins. */
static void end_tick(node_t *node)
{
    const bool is_broadcast_tick = node->ticks_until_broadcast == 0;
    if (is_broadcast_tick) {
        (void)mcp_asdf_settle(&node->robot);
        node->ticks_until_broadcast = node->settings->comms_period;
    }
    node->is_settled = true;
}

/* Begin a tick: send a heartbeat at the beginning of a second, pass the observation to the firmware, and send
 * the estimate in a broadcast tick. Ends a tick that is still open, and counts it as unsettled. */
void node_observe(node_t *node, mcp_asdf_action_t observation)
{
    if (!node->is_settled) {
        ++node->counts.unsettled_ticks; /* no settle has come for the tick before */
        end_tick(node);
    }
    /* node_start() has sent the heartbeat that belongs to the first tick. */
    if (node->ticks != 0 && node->ticks % node->settings->ticks_per_second == 0) {
        send_heartbeat(node);
    }
    if (observation != MCP_ASDF_OBSERVE_NONE) {
        (void)mcp_asdf_observe(&node->robot, (mcp_asdf_observation_t)observation);
    }
    --node->ticks_until_broadcast;
    if (node->ticks_until_broadcast == 0) { /* a broadcast tick; end_tick() starts the count again */
        send_estimate(node);
    }
    ++node->ticks;
    node->is_settled = false;
}

/* End the open tick, as end_tick() does, and then send telemetry if its period has passed. In lockstep
 * telemetry is sent at the end of every tick. */
void node_settle(node_t *node)
{
    const uint32_t telemetry_period = node->settings->lockstep ? 1 : node->settings->telemetry_period;
    end_tick(node);
    if (telemetry_period != 0 && node->ticks % telemetry_period == 0) {
        send_telemetry(node);
    }
}

/* ---- Receiving -------------------------------------------------------------------------------------- */

/* Carry out a command of the lockstep clock, and count it in followed_commands. A command for another robot
 * changes nothing, and one in a wrong order is only counted, in refused_commands:
 *
 *                        for the open tick      for any other tick, or if none is open
 *     observe command    refused: a repeat      begins that tick; one that is open ends, as unsettled
 *     settle command     ends the tick          refused
 *
 * So an observe command for the tick that was settled last begins a tick of this number again. */
static void handle_command(node_t *node, const mcp_asdf_command_t *command)
{
    const bool is_for_this_robot =
        command->target == node->settings->id || command->target == MCP_ASDF_EVERY_ROBOT;
    if (!is_for_this_robot) {
        return;
    }
    const bool is_settle = command->action == MCP_ASDF_SETTLE;
    const bool is_for_open_tick = !node->is_settled && command->tick == node->tick_of_command;
    /* An observe command may be for any other tick: numbers of ticks may go back, as after a restart of the
     * simulator. */
    const bool is_in_order = is_settle ? is_for_open_tick : !is_for_open_tick;
    if (!is_in_order) {
        ++node->counts.refused_commands;
        return;
    }
    ++node->counts.followed_commands;
    if (is_settle) {
        node_settle(node);
    } else {
        node->tick_of_command = command->tick;
        node_observe(node, (mcp_asdf_action_t)command->action);
    }
}

/* Returns the value of an alpha word (mantissa in bits 8 to 31, shift in bits 0 to 4) in units of 2^-24,
 * below 2^55. */
static uint64_t alpha_to_units(uint32_t alpha_word)
{
    const uint64_t mantissa = alpha_word >> 8;
    const uint32_t shift = alpha_word & 31U;
    return mantissa << shift;
}

/* Compare an estimate's alpha with the sender's last one, and remember it as the last one. Counts a jump if
 * the sender is watched and alpha has at least doubled; a sender whose alpha has halved is watched anew. */
static void check_alpha_jump(node_t *node, const mcp_asdf_estimate_t *estimate)
{
    node_sender_t *sender = &node->senders[estimate->node];
    const uint64_t last_alpha = alpha_to_units(sender->last_alpha), alpha = alpha_to_units(estimate->alpha);
    const bool is_watched = sender->estimate_count == NODE_WATCHED_AFTER;
    /* The last alpha of a watched sender is not 0: an alpha of 0 ends the watch below. */
    if (is_watched && alpha >= 2 * last_alpha) {
        ++node->counts.alpha_jumps;
    }
    if (2 * alpha <= last_alpha) {
        sender->estimate_count = 0; /* the sender has started again, with few observations */
    } else if (!is_watched) {
        ++sender->estimate_count;
    }
    sender->last_alpha = estimate->alpha;
}

/* Pass an estimate to the firmware, unless its sender is ignored. Counts it as received or ignored, and as an
 * id collision if another node sent it with this node's id. If the node has a list of senders, jumps of alpha
 * are counted there, also those of ignored senders. */
static void receive_estimate(node_t *node, const mcp_asdf_estimate_t *estimate)
{
    const uint8_t sender = estimate->node;
    const bool has_own_id = sender == node->settings->id;
    const uint8_t ignored_of_eight = node->settings->ignored_senders[sender / 8]; /* a bit for each id */
    const bool is_ignored = ((ignored_of_eight >> (sender % 8)) & 1) != 0;
    if (node->senders != NULL) {
        check_alpha_jump(node, estimate);
    }
    if (is_ignored && !has_own_id) { /* an id collision is counted below even if the own id is on the list */
        ++node->counts.ignored_estimates;
        return;
    }
    ++node->counts.received_estimates;
    if (has_own_id) {
        /* A node does not receive its own frames, so another node uses its id. The firmware rejects the
         * estimate. */
        ++node->counts.id_collisions;
    }
    (void)mcp_asdf_receive(&node->robot, sender, estimate->x_hat, estimate->alpha);
}

/* Whether a decoder refused a frame before it looked at the content: the frame is not of the decoder's kind.
 * A bus whose kernel filters frames does not deliver such frames. The errors of a decoder are negative
 * numbers that fall in the order of its checks, and the check of the subject is the last before those of the
 * content. */
static bool is_other_kind(mcp_asdf_frame_status_t status) { return status >= MCP_ASDF_FRAME_ERR_SUBJECT; }

/* Receive an estimate, or in lockstep carry out a command. Any other frame is counted: as rejected if it is
 * of a kind that is read here, but malformed, and else among the other frames. */
void node_handle_frame(node_t *node, const mcp_asdf_frame_t *frame)
{
    mcp_asdf_estimate_t estimate;
    mcp_asdf_command_t command;
    mcp_asdf_frame_status_t status =
        mcp_asdf_decode_estimate(&estimate, node->settings->estimate_format.subject, frame);
    if (status == MCP_ASDF_FRAME_OK) {
        receive_estimate(node, &estimate);
        return;
    }
    /* A sound frame of another subject may be a command. */
    if (status == MCP_ASDF_FRAME_ERR_SUBJECT && node->settings->lockstep) {
        status = mcp_asdf_decode_command(&command, node->settings->command_format.subject, frame);
        if (status == MCP_ASDF_FRAME_OK) {
            handle_command(node, &command);
            return;
        }
    }
    if (is_other_kind(status)) {
        ++node->counts.other_frames;
    } else {
        ++node->counts.rejected_frames;
    }
}
