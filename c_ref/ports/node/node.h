/* A robot as a node of the bus, without bus, clock or operating system: frames in, frames out. docs/design.md
 * has the rules that it follows in lockstep; mcp_asdf_tools/robots/node.py is the same node in Python.
 *
 * In every control tick the node does these things. Every comms_period-th tick is a broadcast tick:
 *
 *     observe     the firmware counts the observation, if there is one
 *     broadcast   in a broadcast tick: the node sends its estimate
 *     receive     the node handles what its neighbours send until the tick ends
 *     settle      in a broadcast tick: the firmware closes the round
 *
 * A round therefore lasts from the end of one broadcast tick to the end of the next. Here all periods are in
 * ticks; only the firmware counts its filter_period in rounds. */
#ifndef MCP_ASDF_PORT_NODE_H
#define MCP_ASDF_PORT_NODE_H

#include "mcp_asdf.h"
#include "mcp_asdf_frame.h"

/* Settings of a node.
 *   table, memory, filter   as in mcp_asdf_config_t
 *   comms_period            ticks from one broadcast to the next, 1 or more
 *   filter_period           ticks from one run of the filter to the next, the paper's tau: a multiple of
 *                           comms_period
 *   ..._format              subject and priority of each kind of frame; three different subjects
 *   b_hat                   initial assumed accuracy, unit 2^-32
 *   ticks_per_second        a heartbeat is sent every so many ticks, 1 or more
 *   telemetry_period        ticks from one telemetry frame to the next; 0: none. Not used in lockstep
 *   id                      of the robot and of the node, 0 .. 127
 *   ignored_senders         set of ids whose estimates do not reach the firmware: bit id % 8 of byte id / 8.
 *                           The node's own id is never ignored
 *   lockstep                whether commands are the clock, and every settle is answered with telemetry */
typedef struct {
    const uint32_t *table;
    uint32_t comms_period, filter_period;
    uint32_t memory;
    mcp_asdf_frame_format_t estimate_format, telemetry_format, command_format;
    uint32_t b_hat;
    uint32_t ticks_per_second;
    uint32_t telemetry_period;
    uint8_t filter;
    uint8_t id;
    uint8_t ignored_senders[(MCP_ASDF_MAX_ID + 1) / 8];
    bool lockstep;
} node_settings_t;

/* Where the node's frames go. `send` gets `context` back, and returns whether the bus has accepted the frame.
 */
typedef struct {
    bool (*send)(void *context, const mcp_asdf_frame_t *frame);
    void *context;
} node_output_t;

/* Number of frames by what became of them, modulo 2^32.
 *   estimates, heartbeats, telemetry   frames made, whether or not the bus accepted them. They are also the
 *                                      next transfer ids, so that a repeated first heartbeat counts once
 *   unsent_frames        frames that the bus did not accept
 *   received_estimates   valid estimates passed to the firmware, whose own counters say what it did with them
 *   ignored_estimates    valid estimates of ignored senders, which are not passed to it
 *   alpha_jumps          valid estimates whose alpha is at least twice the sender's last one, after
 *                        NODE_WATCHED_AFTER of them. An honest alpha is nearly proportional to the number of
 *                        observations behind it: it doubles at once only after a re-estimate of b_hat, or if
 *                        as many broadcasts were lost as had been received
 *   id_collisions        received estimates with the node's own id: another node has the same id
 *   rejected_frames      frames of a subject that the node reads, but malformed
 *   other_frames         all other frames
 *   followed_commands, refused_commands   commands for this robot that were carried out, or that came in a
 *                                         wrong order
 *   unsettled_ticks      ticks that the next one ended, since no settle had come */
typedef struct {
    uint32_t estimates, heartbeats, telemetry, unsent_frames;
    uint32_t received_estimates, ignored_estimates, alpha_jumps, id_collisions, rejected_frames, other_frames;
    uint32_t followed_commands, refused_commands, unsettled_ticks;
} node_counts_t;

/* Estimates of a sender after which a doubled alpha counts as a jump. */
#define NODE_WATCHED_AFTER 32

/* What the node remembers of a sender to find jumps of its alpha.
 *   last_alpha       alpha word of its last estimate
 *   estimate_count   estimates since its first, or since its alpha halved; at most NODE_WATCHED_AFTER */
typedef struct {
    uint32_t last_alpha;
    uint8_t estimate_count;
} node_sender_t;

/* A node. The owner may write these members after node_init():
 *   health    mcp_asdf_health_t of the next heartbeat
 *   senders   NULL, as node_init() leaves it, or an array with one entry per id, at first all 0. With
 *             the array the node counts jumps of alpha */
typedef struct {
    mcp_asdf_t robot;
    mcp_asdf_config_t config; /* the robot's, derived from the settings */
    const node_settings_t *settings;
    node_output_t output;
    node_counts_t counts;
    node_sender_t *senders;
    uint32_t ticks;                 /* ticks begun so far, modulo 2^32 */
    uint32_t ticks_until_broadcast; /* ticks to begin before the next broadcast; 0 in a broadcast tick */
    uint32_t tick_of_command;       /* tick number in the last observe command */
    uint8_t health;
    bool is_settled; /* whether the last tick has ended */
} node_t;

/* Make a node whose robot has observed nothing yet. The settings must outlive the node, and the node must not
 * be moved, as its robot points to its config. Returns the status of mcp_asdf_init(), and ERR_CONFIG if
 * comms_period is 0 or filter_period no multiple of it. */
mcp_asdf_status_t node_init(node_t *node, const node_settings_t *settings, node_output_t output);

/* Announce the node: send its first heartbeat. May be repeated until the first tick. */
void node_start(node_t *node);

/* Begin a tick: send a heartbeat if a second has passed, count the observation, and send the estimate in a
 * broadcast tick. A tick that is still open ends first, without telemetry, and counts as unsettled.
 * `observation` is a white or black tile, or MCP_ASDF_OBSERVE_NONE. */
void node_observe(node_t *node, mcp_asdf_action_t observation);

/* End the tick: in a broadcast tick the firmware closes its round. Sends telemetry if its period has passed,
 * in lockstep always. */
void node_settle(node_t *node);

/* Handle a frame that has arrived, of any kind or malformed, but none that this node has sent itself. Counts
 * it; an estimate goes to the firmware, and in lockstep a command is carried out. */
void node_handle_frame(node_t *node, const mcp_asdf_frame_t *frame);

#endif
