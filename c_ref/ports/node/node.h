/* A robot as a node of the bus, without bus, clock or operating system: frames in, frames out. docs/frame.md
 * has the rules that it follows in lockstep; mcp_asdf_tools/robots/node.py is the same node in Python.
 *
 * A control tick, of which every comms_period-th is due:
 *
 *     observe     the firmware counts the observation, if there is one
 *     broadcast   in a due tick
 *     receive     what neighbours send until the tick ends
 *     settle      in a due tick: the firmware closes the round
 *
 * A round therefore lasts from the end of one due tick to the end of the next. Here all periods are in ticks;
 * only the firmware counts its filter_period in rounds. */
#ifndef MCP_ASDF_PORT_NODE_H
#define MCP_ASDF_PORT_NODE_H

#include "mcp_asdf.h"
#include "mcp_asdf_frame.h"

/* Settings of a node.
 *   table, memory, filter   as in mcp_asdf_config_t
 *   comms_period       ticks between broadcasts, 1 or more
 *   filter_period      ticks between runs of the filter, the paper's tau: a multiple of comms_period
 *   estimate ... command   where messages are; three different subjects
 *   b_hat              initial assumed accuracy, unit 2^-32
 *   ticks_per_second   a heartbeat is due every so many ticks, 1 or more
 *   telemetry_period   ticks between telemetry frames; 0: none. Not used in lockstep
 *   id                 robot and node, 0 .. 127
 *   ignore             ids whose estimates the firmware does not get, but for its own: bit id % 8 of byte
 *                      id / 8
 *   lockstep           whether commands are the clock, and every settle is answered */
typedef struct {
    const uint32_t *table;
    uint32_t comms_period, filter_period;
    uint32_t memory;
    mcp_asdf_frame_format_t estimate, telemetry, command;
    uint32_t b_hat;
    uint32_t ticks_per_second;
    uint32_t telemetry_period;
    uint8_t filter;
    uint8_t id;
    uint8_t ignore[(MCP_ASDF_MAX_ID + 1) / 8];
    bool lockstep;
} node_settings_t;

/* Where frames go: returns whether the bus took the frame. */
typedef struct {
    bool (*send)(void *context, const mcp_asdf_frame_t *frame);
    void *context;
} node_output_t;

/* Frames by what became of them.
 *   estimates, heartbeats, telemetry   made, the first heartbeat counted once, whether or not the bus
 *                                      took them; the next transfer ids, too
 *   unsent       those that the bus did not take
 *   heard        legal estimates given to the firmware, whose counters tell what it made of them
 *   unknown      those of ids to ignore, which it did not get
 *   jumps        legal estimates with twice the alpha of the sender's last one, or more, after
 *                NODE_WATCHED_AFTER of them. An honest alpha is nearly proportional to the observations
 *                behind it: it doubles at once after a re-estimate, or if as many were missed as came before
 *   collisions   heard ones with the node's own id: another node has it, too
 *   refused      estimates and commands that are not legal
 *   others       all other frames
 *   obeyed, disobeyed   commands for this robot that the rules let it follow, or not
 *   unsettled    ticks that the next one ended, since no settle had come */
typedef struct {
    uint32_t estimates, heartbeats, telemetry, unsent;
    uint32_t heard, unknown, jumps, collisions, refused, others;
    uint32_t obeyed, disobeyed, unsettled;
} node_counts_t;

#define NODE_WATCHED_AFTER 32

/* What is known of a sender: its last alpha, a word, and how often it was heard since it began, up to
 * NODE_WATCHED_AFTER. */
typedef struct {
    uint32_t alpha;
    uint8_t heard;
} node_sender_t;

/*   senders    what jumps are found with, one for each id, at first all 0. NULL, as node_init() leaves it:
 *              none are counted */
typedef struct {
    mcp_asdf_t robot;
    mcp_asdf_config_t config; /* the robot's, made of the settings */
    const node_settings_t *settings;
    node_output_t output;
    node_counts_t counts;
    node_sender_t *senders;
    uint32_t ticks;      /* begun; modulo 2^32 */
    uint32_t comms_left; /* ticks still to begin until one is due; 0 in a due tick */
    uint32_t number;     /* of the last observe command */
    uint8_t health;      /* mcp_asdf_health_t for the next heartbeat; the owner may write it */
    bool is_settled;     /* whether the last tick is over */
} node_t;

/* Make a node with a robot that has done nothing yet. Settings must outlive it, and it must stay where it is,
 * as its robot refers to its config. Returns what mcp_asdf_init does, and ERR_CONFIG for periods that do not
 * fit together. */
mcp_asdf_status_t node_init(node_t *node, const node_settings_t *settings, node_output_t output);

/* Say that the node is there: its first heartbeat, which may be repeated until the first tick. */
void node_start(node_t *node);

/* Begin a tick: a heartbeat if due, the observation, a broadcast if due. Ends one that is open, unanswered.
 * `seen` is a white or a black tile, or MCP_ASDF_OBSERVE_NONE. */
void node_observe(node_t *node, mcp_asdf_action_t seen);

/* End the tick: the round if due; telemetry if due, in lockstep always. */
void node_settle(node_t *node);

/* Take in any frame whatever, but none that this node has sent itself. */
void node_hear(node_t *node, const mcp_asdf_frame_t *frame);

#endif
