/* A robot as a node of the bus, without bus, clock or operating system: frames in, frames out. docs/frame.md
 * has the rules that it follows in lockstep; host_tools/node.py is the same node in Python. */
#ifndef MCP_ASDF_PORT_NODE_H
#define MCP_ASDF_PORT_NODE_H

#include "mcp_asdf.h"
#include "mcp_asdf_frame.h"

/* What a node is told at start.
 *   config             periods, memory, filter and table of the firmware
 *   estimate ... command   where messages are; three different subjects
 *   b_hat              initial assumed accuracy, unit 2^-32
 *   ticks_per_second   a heartbeat is due every so many ticks, 1 or more
 *   telemetry_period   ticks between telemetry frames; 0: none. Not used in lockstep
 *   id                 robot and node, 0 .. 127
 *   lockstep           whether commands are the clock, and every settle is answered */
typedef struct {
    mcp_asdf_config_t config;
    mcp_asdf_frame_format_t estimate, telemetry, command;
    uint32_t b_hat;
    uint32_t ticks_per_second;
    uint32_t telemetry_period;
    uint8_t id;
    bool lockstep;
} node_settings_t;

/* Where frames go: returns whether the bus took the frame. */
typedef struct {
    bool (*send)(void *context, const mcp_asdf_frame_t *frame);
    void *context;
} node_output_t;

/* Frames by what became of them.
 *   estimates, heartbeats, telemetry   made, whether or not the bus took them; the next transfer ids, too
 *   unsent       those that the bus did not take
 *   heard        legal estimates, all given to the firmware, whose counters tell what it made of them
 *   collisions   those among them with the node's own id: another node has it, too
 *   refused      estimates and commands that are not legal
 *   others       all other frames
 *   obeyed, disobeyed   commands for this robot that the rules let it follow, or not
 *   unsettled    ticks that the next one ended, since no settle had come */
typedef struct {
    uint32_t estimates, heartbeats, telemetry, unsent;
    uint32_t heard, collisions, refused, others;
    uint32_t obeyed, disobeyed, unsettled;
} node_counts_t;

typedef struct {
    mcp_asdf_t robot;
    const node_settings_t *settings;
    node_output_t output;
    node_counts_t counts;
    uint32_t ticks;  /* begun; modulo 2^32 */
    uint32_t number; /* of the last observe command */
    uint8_t health;  /* mcp_asdf_health_t for the next heartbeat; the owner may write it */
    bool is_settled; /* whether the last tick is over */
} node_t;

/* Make a node with a robot that has done nothing yet. Settings must outlive it. Returns what mcp_asdf_init
 * does. */
mcp_asdf_status_t node_init(node_t *node, const node_settings_t *settings, node_output_t output);

/* Say that the node is there: its first heartbeat. */
void node_start(node_t *node);

/* Begin a tick: a heartbeat if due, the observation, a broadcast if due. Ends one that is open, unanswered.
 * Ignores what is no observation. */
void node_observe(node_t *node, mcp_asdf_observation_t z);

/* End the tick: telemetry if due, in lockstep always. */
void node_settle(node_t *node);

/* Take in any frame whatever, but none that this node has sent itself. */
void node_hear(node_t *node, const mcp_asdf_frame_t *frame);

/* ---- Between node.c and node_messages.c: say how things are now ---- */

void node_send_heartbeat(node_t *node);
void node_send_estimate(node_t *node);
void node_send_telemetry(node_t *node);

#endif
