/* Black box: a node between a bus that keeps what it says and one that says anything. What a tick does when
 * is node.h's promise; tests/targets compares whole runs with a node in Python. */
#include "node/node.h"

#include "check.h"

#define OWN_ID 3
#define FRAMES 64

static node_settings_t settings;
static node_t node;

/* What the node has sent, and whether the bus takes more. */
static struct {
    mcp_asdf_frame_t frames[FRAMES];
    uint32_t sent;
    bool is_full;
} bus;

static bool take(void *context, const mcp_asdf_frame_t *frame)
{
    CHECK(context == &bus);
    if (bus.is_full || bus.sent == FRAMES) {
        return false;
    }
    bus.frames[bus.sent++] = *frame;
    return true;
}

static const node_output_t output = {take, &bus};

/* A broadcast in every second tick, telemetry in every third, a heartbeat in every fourth. */
static void set_usual(void)
{
    settings = (node_settings_t){.comms_period = 2,
                                 .filter_period = 6,
                                 .memory = MCP_ASDF_MEMORY_MAX,
                                 .estimate_format = MCP_ASDF_FORMAT_ESTIMATE,
                                 .telemetry_format = MCP_ASDF_FORMAT_TELEMETRY,
                                 .command_format = MCP_ASDF_FORMAT_COMMAND,
                                 .b_hat = 0xC0000000,
                                 .ticks_per_second = 4,
                                 .telemetry_period = 3,
                                 .filter = MCP_ASDF_ALWAYS,
                                 .id = OWN_ID};
}

static void make(void)
{
    bus.sent = 0;
    bus.is_full = false;
    CHECK_EQUAL(node_init(&node, &settings, output), MCP_ASDF_OK);
}

static void make_usual(void)
{
    set_usual();
    make();
}

/* Frames of a subject among those sent. */
static uint32_t sent_on(uint32_t subject)
{
    uint32_t found = 0;
    for (uint32_t i = 0; i < bus.sent; ++i) {
        found += (bus.frames[i].id & MCP_ASDF_FRAME_MASK) == MCP_ASDF_FRAME_FILTER(subject);
    }
    return found;
}

/* ---- Ticks ---- */

static void periods_must_fit_together(void)
{
    static const uint32_t periods[][2] = {{0, 6}, {4, 6}, {2, 0}};
    for (size_t i = 0; i < COUNT(periods); ++i) {
        set_usual();
        settings.comms_period = periods[i][0];
        settings.filter_period = periods[i][1];
        CHECK_EQUAL(-node_init(&node, &settings, output), -MCP_ASDF_ERR_CONFIG);
    }
    set_usual();
    settings.id = 128;
    CHECK_EQUAL(-node_init(&node, &settings, output), -MCP_ASDF_ERR_ID);
}

/* 24 ticks with white, black and no tiles. */
static void run_24_ticks(void)
{
    static const mcp_asdf_action_t seen[] = {MCP_ASDF_OBSERVE_NONE, MCP_ASDF_OBSERVE_BLACK,
                                             MCP_ASDF_OBSERVE_WHITE};
    make();
    node_start(&node);
    for (uint32_t i = 0; i < 24; ++i) {
        node_observe(&node, seen[i % 3]);
        node_settle(&node);
    }
}

static void everything_is_said_when_it_is_due(void)
{
    set_usual();
    run_24_ticks();
    CHECK(bus.frames[0].data[0] == 0 && bus.frames[0].data[7] == 0xE0); /* uptime and transfer id */
    CHECK(sent_on(3000) == 12 && sent_on(MCP_ASDF_SUBJECT_HEARTBEAT) == 6 && sent_on(3001) == 8);
    CHECK(mcp_asdf_t_count(&node.robot) == 16 && mcp_asdf_n_count(&node.robot) == 8);
    settings.telemetry_period = 0;
    run_24_ticks();
    CHECK(sent_on(3000) == 12 && sent_on(3001) == 0);
}

/* What the bus refuses is unsent; what cannot be encoded is made, and neither sent nor unsent. */
static void what_is_not_sent_is_counted(void)
{
    make_usual();
    bus.is_full = true;
    node_start(&node);
    node_observe(&node, MCP_ASDF_OBSERVE_WHITE);
    node_observe(&node, MCP_ASDF_OBSERVE_WHITE);
    CHECK(node.counts.unsent_frames == 2 && node.counts.heartbeats == 1 && node.counts.estimates == 1);
    settings.estimate_format.subject = settings.telemetry_format.subject = MCP_ASDF_SUBJECT_MAX + 1;
    make();
    node.health = MCP_ASDF_HEALTH_WARNING + 1;
    for (uint32_t i = 0; i < 6; ++i) {
        node_observe(&node, MCP_ASDF_OBSERVE_WHITE);
        node_settle(&node);
    }
    CHECK(bus.sent == 0 && node.counts.unsent_frames == 0);
    CHECK(node.counts.estimates == 3 && node.counts.telemetry == 2 && node.counts.heartbeats == 1);
}

/* ---- Frames of others ---- */

static mcp_asdf_frame_t estimate_of(uint8_t sender)
{
    const mcp_asdf_frame_t frame = {
        MCP_ASDF_FRAME_FILTER(3000) | sender, 0, 8, {0, 0, 64, 0, 0, 0, 63, 0xE0}};
    return frame;
}

static mcp_asdf_frame_t command_to(uint8_t target, mcp_asdf_action_t action, uint8_t number)
{
    const mcp_asdf_frame_t frame = {
        MCP_ASDF_FRAME_FILTER(3002) | 126, 0, 8, {number, 0, 0, 0, target, (uint8_t)action, 0, 0xE0}};
    return frame;
}

/* Commands are other frames to a node that is not in lockstep, and damaged ones refused by one that is. */
static void frames_are_taken_or_counted(void)
{
    mcp_asdf_frame_t of_other = estimate_of(9), own = estimate_of(OWN_ID);
    mcp_asdf_frame_t command = command_to(OWN_ID, MCP_ASDF_OBSERVE_BLACK, 0);
    make_usual();
    node_handle_frame(&node, &of_other);
    CHECK(node.counts.received_estimates == 1 && node.counts.id_collisions == 0);
    node_handle_frame(&node, &own);
    CHECK(node.counts.received_estimates == 2 && node.counts.id_collisions == 1);
    CHECK(mcp_asdf_counters(&node.robot).accepted == 1 && mcp_asdf_counters(&node.robot).rejected == 1);
    node_handle_frame(&node, &command);
    CHECK(node.counts.other_frames == 1 && node.counts.rejected_frames == 0 && node.ticks == 0);
    of_other.data[2] = 0xFF; /* an x_hat above 1 */
    node_handle_frame(&node, &of_other);
    CHECK(node.counts.other_frames == 1 && node.counts.rejected_frames == 1 &&
          node.counts.received_estimates == 2);
    settings.lockstep = true;
    make();
    command.length = 7;
    node_handle_frame(&node, &command);
    CHECK(node.counts.other_frames == 0 && node.counts.rejected_frames == 1 && node.ticks == 0);
}

static void commands_are_followed_in_their_order(void)
{
    static const struct {
        uint8_t target;
        mcp_asdf_action_t action;
        uint8_t number;
        uint32_t obeyed, disobeyed, ticks; /* after it */
    } orders[] = {
        {OWN_ID, MCP_ASDF_SETTLE, 0, 0, 1, 0}, /* nothing to settle yet */
        {OWN_ID, MCP_ASDF_OBSERVE_BLACK, 7, 1, 1, 1},
        {OWN_ID, MCP_ASDF_OBSERVE_BLACK, 7, 1, 2, 1}, /* the same again */
        {OWN_ID + 1, MCP_ASDF_SETTLE, 7, 1, 2, 1},    /* not meant */
        {OWN_ID, MCP_ASDF_SETTLE, 8, 1, 3, 1},        /* of another tick */
        {MCP_ASDF_EVERY_ROBOT, MCP_ASDF_SETTLE, 7, 2, 3, 1},
        {OWN_ID, MCP_ASDF_SETTLE, 7, 2, 4, 1}, /* settled already */
        {MCP_ASDF_EVERY_ROBOT, MCP_ASDF_OBSERVE_WHITE, 8, 3, 4, 2},
        {OWN_ID, MCP_ASDF_OBSERVE_NONE, 9, 4, 4, 3}, /* without a settle between */
    };
    set_usual();
    settings.lockstep = true;
    make();
    for (size_t i = 0; i < COUNT(orders); ++i) {
        const mcp_asdf_frame_t frame = command_to(orders[i].target, orders[i].action, orders[i].number);
        GIVEN(i, node.counts.followed_commands, node.counts.refused_commands);
        node_handle_frame(&node, &frame);
        CHECK_EQUAL(node.counts.followed_commands, orders[i].obeyed);
        CHECK_EQUAL(node.counts.refused_commands, orders[i].disobeyed);
        CHECK_EQUAL(node.ticks, orders[i].ticks);
    }
    CHECK(node.counts.unsettled_ticks == 1 && mcp_asdf_t_count(&node.robot) == 2);
    CHECK_EQUAL(sent_on(3001), 1); /* every settle is answered */
}

/* Ids to ignore are counted, but the own id collides in any case. */
static void ids_to_ignore_do_not_reach_the_firmware(void)
{
    mcp_asdf_frame_t of_last = estimate_of(127), of_9 = estimate_of(9), own = estimate_of(OWN_ID);
    set_usual();
    for (int i = 0; i < 16; ++i) {
        settings.ignored_senders[i] = i == 1 ? 0xFD : 0xFF; /* all but 9 */
    }
    make();
    node_handle_frame(&node, &of_9);
    CHECK(node.counts.received_estimates == 1 && node.counts.ignored_estimates == 0);
    node_handle_frame(&node, &of_last);
    CHECK(node.counts.received_estimates == 1 && node.counts.ignored_estimates == 1);
    node_handle_frame(&node, &own);
    CHECK(node.counts.received_estimates == 2 && node.counts.ignored_estimates == 1 &&
          node.counts.id_collisions == 1);
    CHECK(mcp_asdf_counters(&node.robot).accepted == 1 && mcp_asdf_counters(&node.robot).rejected == 1);
}

/* Hear alpha = 0.5 so many times, then one with these upper bytes; returns how many were jumps. */
static uint32_t jumps_after(uint32_t times, uint8_t exponent, uint8_t rest)
{
    static node_sender_t senders[128];
    mcp_asdf_frame_t frame = estimate_of(9);
    make_usual();
    senders[9] = (node_sender_t){0};
    node.senders = senders;
    for (uint32_t i = 0; i < times; ++i) {
        node_handle_frame(&node, &frame);
    }
    frame.data[6] = exponent;
    frame.data[5] = rest;
    node_handle_frame(&node, &frame);
    return node.counts.alpha_jumps;
}

static void an_alpha_that_doubles_late_is_a_jump(void)
{
    mcp_asdf_frame_t frame = estimate_of(9);
    const uint32_t enough = NODE_WATCHED_AFTER;
    CHECK_EQUAL(jumps_after(enough, 63, 128), 1);     /* 0.5 to 1 */
    CHECK_EQUAL(jumps_after(enough - 1, 63, 128), 0); /* too early */
    CHECK_EQUAL(jumps_after(enough, 63, 127), 0);     /* 0.998 */
    CHECK_EQUAL(jumps_after(enough, 127, 127), 1);    /* the largest */
    CHECK_EQUAL(jumps_after(enough, 62, 128), 0);     /* half as much: anew */
    node_handle_frame(&node, &frame);                 /* twice as much again */
    CHECK_EQUAL(node.counts.alpha_jumps, 0);
    CHECK_EQUAL(jumps_after(3 * enough, 0, 0), 0);
}

int main(void)
{
    periods_must_fit_together();
    everything_is_said_when_it_is_due();
    what_is_not_sent_is_counted();
    frames_are_taken_or_counted();
    ids_to_ignore_do_not_reach_the_firmware();
    an_alpha_that_doubles_late_is_a_jump();
    commands_are_followed_in_their_order();
    return check_report();
}
