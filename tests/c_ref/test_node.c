/* The node between a bus that keeps the frames it sends, and frames that the tests make. node.h says what a
 * tick does; tests/targets compares whole runs with a node in Python. */
#include "node/node.h"

#include "check.h"

#define OWN_ID 3
#define ESTIMATE_SUBJECT 3000
#define TELEMETRY_SUBJECT 3001
#define COMMAND_SUBJECT 3002
#define FRAMES_MAX 64

static node_settings_t settings;
static node_t node;

/* The frames that the node has sent, and whether the bus accepts no more. */
static struct {
    mcp_asdf_frame_t frames[FRAMES_MAX];
    uint32_t frame_count;
    bool is_full;
} bus;

static bool send_to_bus(void *context, const mcp_asdf_frame_t *frame)
{
    CHECK(context == &bus);
    if (bus.is_full || bus.frame_count == FRAMES_MAX) {
        return false;
    }
    bus.frames[bus.frame_count++] = *frame;
    return true;
}

static const node_output_t output = {send_to_bus, &bus};

/* Settings with a broadcast in every second tick, telemetry in every third, a heartbeat in every fourth. */
static node_settings_t usual_settings(void)
{
    return (node_settings_t){.comms_period = 2,
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

/* Make a new node with these settings, and empty the bus. */
static void make_node(node_settings_t new_settings)
{
    settings = new_settings;
    bus.frame_count = 0;
    bus.is_full = false;
    CHECK_EQUAL(node_init(&node, &settings, output), MCP_ASDF_OK);
}

static void make_usual_node(void) { make_node(usual_settings()); }

static void make_node_in_lockstep(void)
{
    node_settings_t in_lockstep = usual_settings();
    in_lockstep.lockstep = true;
    make_node(in_lockstep);
}

/* Number of frames of a subject among those sent. */
static uint32_t count_sent(uint32_t subject)
{
    uint32_t count = 0;
    for (uint32_t i = 0; i < bus.frame_count; ++i) {
        count += (bus.frames[i].id & MCP_ASDF_FRAME_MASK) == MCP_ASDF_FRAME_FILTER(subject);
    }
    return count;
}

/* ---- Settings ---- */

static void a_node_refuses_periods_that_do_not_fit_together(void)
{
    static const uint32_t periods[][2] = {{0, 6}, {4, 6}, {2, 0}};
    for (size_t i = 0; i < COUNT(periods); ++i) {
        settings = usual_settings();
        settings.comms_period = periods[i][0];
        settings.filter_period = periods[i][1];
        CHECK_EQUAL(-node_init(&node, &settings, output), -MCP_ASDF_ERR_CONFIG);
    }
}

static void a_node_refuses_what_its_firmware_refuses(void)
{
    settings = usual_settings();
    settings.id = 128;
    CHECK_EQUAL(-node_init(&node, &settings, output), -MCP_ASDF_ERR_ID);
}

/* ---- Ticks ---- */

/* 24 ticks with no tile, a black and a white one in turn. */
static void run_24_ticks(void)
{
    static const mcp_asdf_action_t observations[] = {MCP_ASDF_OBSERVE_NONE, MCP_ASDF_OBSERVE_BLACK,
                                                     MCP_ASDF_OBSERVE_WHITE};
    node_start(&node);
    for (uint32_t i = 0; i < 24; ++i) {
        node_observe(&node, observations[i % 3]);
        node_settle(&node);
    }
}

static void a_node_announces_itself_with_its_first_heartbeat(void)
{
    make_usual_node();
    node_start(&node);
    CHECK(bus.frame_count == 1 && count_sent(MCP_ASDF_SUBJECT_HEARTBEAT) == 1);
    CHECK(bus.frames[0].data[0] == 0 && bus.frames[0].data[7] == 0xE0); /* uptime and transfer id */
}

static void a_repeated_first_heartbeat_has_the_same_transfer_id(void)
{
    make_usual_node();
    node_start(&node);
    node_start(&node);
    CHECK(bus.frame_count == 2 && bus.frames[1].data[7] == 0xE0 && node.counts.heartbeats == 1);
}

static void each_kind_of_frame_is_sent_in_its_period(void)
{
    make_usual_node();
    run_24_ticks();
    CHECK_EQUAL(count_sent(ESTIMATE_SUBJECT), 12);
    CHECK_EQUAL(count_sent(TELEMETRY_SUBJECT), 8);
    CHECK_EQUAL(count_sent(MCP_ASDF_SUBJECT_HEARTBEAT), 6);
}

static void an_estimate_is_sent_in_the_last_tick_of_its_period(void)
{
    make_usual_node();
    node_observe(&node, MCP_ASDF_OBSERVE_WHITE);
    CHECK_EQUAL(count_sent(ESTIMATE_SUBJECT), 0);
    node_settle(&node);
    node_observe(&node, MCP_ASDF_OBSERVE_WHITE);
    CHECK_EQUAL(count_sent(ESTIMATE_SUBJECT), 1);
}

static void the_firmware_counts_black_and_white_tiles(void)
{
    make_usual_node();
    run_24_ticks();
    CHECK(mcp_asdf_t_count(&node.robot) == 16 && mcp_asdf_n_count(&node.robot) == 8);
}

static void no_telemetry_is_sent_without_a_period(void)
{
    node_settings_t silent = usual_settings();
    silent.telemetry_period = 0;
    make_node(silent);
    run_24_ticks();
    CHECK(count_sent(ESTIMATE_SUBJECT) == 12 && count_sent(TELEMETRY_SUBJECT) == 0);
}

static void frames_that_the_bus_does_not_accept_count_as_unsent(void)
{
    make_usual_node();
    bus.is_full = true;
    node_start(&node);
    node_observe(&node, MCP_ASDF_OBSERVE_WHITE);
    node_observe(&node, MCP_ASDF_OBSERVE_WHITE);
    CHECK(node.counts.unsent_frames == 2 && node.counts.heartbeats == 1 && node.counts.estimates == 1);
}

/* Neither sent nor unsent: there is no frame of a subject or health that is out of range. */
static void messages_that_cannot_be_encoded_are_not_sent(void)
{
    node_settings_t invalid = usual_settings();
    invalid.estimate_format.subject = invalid.telemetry_format.subject = MCP_ASDF_SUBJECT_MAX + 1;
    make_node(invalid);
    node.health = MCP_ASDF_HEALTH_WARNING + 1;
    for (uint32_t i = 0; i < 6; ++i) {
        node_observe(&node, MCP_ASDF_OBSERVE_WHITE);
        node_settle(&node);
    }
    CHECK(bus.frame_count == 0 && node.counts.unsent_frames == 0);
    CHECK(node.counts.estimates == 3 && node.counts.telemetry == 2 && node.counts.heartbeats == 1);
}

/* ---- Estimates ---- */

/* x_hat = 0.5, alpha = 0.5 */
static mcp_asdf_frame_t estimate_from(uint8_t sender)
{
    const mcp_asdf_frame_t frame = {
        MCP_ASDF_FRAME_FILTER(ESTIMATE_SUBJECT) | sender, 0, 8, {0, 0, 64, 0, 0, 0, 63, 0xE0}};
    return frame;
}

static void an_estimate_reaches_the_firmware(void)
{
    const mcp_asdf_frame_t estimate = estimate_from(9);
    make_usual_node();
    node_handle_frame(&node, &estimate);
    CHECK(node.counts.received_estimates == 1 && node.counts.id_collisions == 0);
    CHECK_EQUAL(mcp_asdf_counters(&node.robot).accepted, 1);
}

static void an_estimate_with_the_own_id_is_a_collision(void)
{
    const mcp_asdf_frame_t estimate = estimate_from(OWN_ID);
    make_usual_node();
    node_handle_frame(&node, &estimate);
    CHECK(node.counts.received_estimates == 1 && node.counts.id_collisions == 1);
    CHECK_EQUAL(mcp_asdf_counters(&node.robot).rejected, 1);
}

static void an_estimate_above_1_is_rejected(void)
{
    mcp_asdf_frame_t estimate = estimate_from(9);
    estimate.data[2] = 0xFF;
    make_usual_node();
    node_handle_frame(&node, &estimate);
    CHECK(node.counts.rejected_frames == 1 && node.counts.other_frames == 0);
    CHECK_EQUAL(node.counts.received_estimates, 0);
}

/* Ignore all senders but 9. */
static void make_node_that_ignores_all_but_9(void)
{
    node_settings_t ignoring = usual_settings();
    for (int i = 0; i < 16; ++i) {
        ignoring.ignored_senders[i] = i == 1 ? 0xFD : 0xFF;
    }
    make_node(ignoring);
}

static void estimates_of_ignored_senders_do_not_reach_the_firmware(void)
{
    const mcp_asdf_frame_t of_9 = estimate_from(9), of_127 = estimate_from(127);
    make_node_that_ignores_all_but_9();
    node_handle_frame(&node, &of_9);
    CHECK(node.counts.received_estimates == 1 && node.counts.ignored_estimates == 0);
    node_handle_frame(&node, &of_127);
    CHECK(node.counts.received_estimates == 1 && node.counts.ignored_estimates == 1);
    CHECK_EQUAL(mcp_asdf_counters(&node.robot).accepted, 1);
}

static void a_node_can_ignore_one_sender_alone(void)
{
    const mcp_asdf_frame_t of_9 = estimate_from(9), of_10 = estimate_from(10);
    node_settings_t ignoring = usual_settings();
    ignoring.ignored_senders[1] = 0x04;
    make_node(ignoring);
    node_handle_frame(&node, &of_9);
    node_handle_frame(&node, &of_10);
    CHECK(node.counts.received_estimates == 1 && node.counts.ignored_estimates == 1);
}

static void a_node_that_ignores_its_own_id_still_finds_collisions(void)
{
    const mcp_asdf_frame_t estimate = estimate_from(OWN_ID);
    make_node_that_ignores_all_but_9();
    node_handle_frame(&node, &estimate);
    CHECK(node.counts.received_estimates == 1 && node.counts.ignored_estimates == 0);
    CHECK_EQUAL(node.counts.id_collisions, 1);
}

/* ---- Jumps of alpha ---- */

static node_sender_t senders[128];

/* Receive alpha = 0.5 so many times, then an alpha whose binary32 number begins with these two bytes. Returns
 * the number of jumps. */
static uint32_t count_jumps(uint32_t repetitions, uint8_t highest_byte, uint8_t second_byte)
{
    mcp_asdf_frame_t estimate = estimate_from(9);
    make_usual_node();
    senders[9] = (node_sender_t){0};
    node.senders = senders;
    for (uint32_t i = 0; i < repetitions; ++i) {
        node_handle_frame(&node, &estimate);
    }
    estimate.data[6] = highest_byte;
    estimate.data[5] = second_byte;
    node_handle_frame(&node, &estimate);
    return node.counts.alpha_jumps;
}

static void an_alpha_that_doubles_is_a_jump(void)
{
    CHECK_EQUAL(count_jumps(NODE_WATCHED_AFTER, 63, 128), 1);  /* 1 */
    CHECK_EQUAL(count_jumps(NODE_WATCHED_AFTER, 63, 127), 0);  /* 0.998 */
    CHECK_EQUAL(count_jumps(NODE_WATCHED_AFTER, 127, 127), 1); /* the largest */
}

static void an_alpha_may_double_among_the_first_estimates_of_a_sender(void)
{
    CHECK_EQUAL(count_jumps(NODE_WATCHED_AFTER - 1, 63, 128), 0);
}

static void a_sender_whose_alpha_has_halved_is_watched_anew(void)
{
    const mcp_asdf_frame_t estimate = estimate_from(9);
    CHECK_EQUAL(count_jumps(NODE_WATCHED_AFTER, 62, 128), 0); /* 0.25 */
    node_handle_frame(&node, &estimate);
    CHECK_EQUAL(node.counts.alpha_jumps, 0);
}

static void an_alpha_of_0_is_no_jump(void) { CHECK_EQUAL(count_jumps(3 * NODE_WATCHED_AFTER, 0, 0), 0); }

/* ---- Commands ---- */

static mcp_asdf_frame_t command_to(uint8_t target, mcp_asdf_action_t action, uint8_t tick)
{
    const mcp_asdf_frame_t frame = {MCP_ASDF_FRAME_FILTER(COMMAND_SUBJECT) | 126,
                                    0,
                                    8,
                                    {tick, 0, 0, 0, target, (uint8_t)action, 0, 0xE0}};
    return frame;
}

static void a_node_out_of_lockstep_does_not_read_commands(void)
{
    const mcp_asdf_frame_t command = command_to(OWN_ID, MCP_ASDF_OBSERVE_BLACK, 0);
    make_usual_node();
    node_handle_frame(&node, &command);
    CHECK(node.counts.other_frames == 1 && node.counts.rejected_frames == 0 && node.ticks == 0);
}

static void a_malformed_command_is_rejected(void)
{
    mcp_asdf_frame_t command = command_to(OWN_ID, MCP_ASDF_OBSERVE_BLACK, 0);
    command.length = 7;
    make_node_in_lockstep();
    node_handle_frame(&node, &command);
    CHECK(node.counts.other_frames == 0 && node.counts.rejected_frames == 1 && node.ticks == 0);
}

static void commands_are_followed_in_their_order_only(void)
{
    static const struct {
        uint8_t target;
        mcp_asdf_action_t action;
        uint8_t tick;
        uint32_t followed, refused, ticks; /* of the node after the command */
    } commands[] = {
        {OWN_ID, MCP_ASDF_SETTLE, 0, 0, 1, 0}, /* no tick is open */
        {OWN_ID, MCP_ASDF_OBSERVE_BLACK, 7, 1, 1, 1},
        {OWN_ID, MCP_ASDF_OBSERVE_BLACK, 7, 1, 2, 1}, /* a repetition */
        {OWN_ID + 1, MCP_ASDF_SETTLE, 7, 1, 2, 1},    /* for another robot */
        {OWN_ID, MCP_ASDF_SETTLE, 8, 1, 3, 1},        /* of another tick */
        {MCP_ASDF_EVERY_ROBOT, MCP_ASDF_SETTLE, 7, 2, 3, 1},
        {OWN_ID, MCP_ASDF_SETTLE, 7, 2, 4, 1}, /* a repetition */
        {MCP_ASDF_EVERY_ROBOT, MCP_ASDF_OBSERVE_WHITE, 8, 3, 4, 2},
        {OWN_ID, MCP_ASDF_OBSERVE_NONE, 9, 4, 4, 3}, /* tick 8 has not been settled */
    };
    make_node_in_lockstep();
    for (size_t i = 0; i < COUNT(commands); ++i) {
        const mcp_asdf_frame_t frame = command_to(commands[i].target, commands[i].action, commands[i].tick);
        node_handle_frame(&node, &frame);
        GIVEN(i, 0, 0);
        CHECK_EQUAL(node.counts.followed_commands, commands[i].followed);
        CHECK_EQUAL(node.counts.refused_commands, commands[i].refused);
        CHECK_EQUAL(node.ticks, commands[i].ticks);
    }
    CHECK_EQUAL(node.counts.unsettled_ticks, 1);
    CHECK_EQUAL(mcp_asdf_t_count(&node.robot), 2);
}

static void every_settle_command_is_answered_with_telemetry(void)
{
    make_node_in_lockstep();
    for (uint8_t tick = 0; tick < 5; ++tick) {
        const mcp_asdf_frame_t observe = command_to(OWN_ID, MCP_ASDF_OBSERVE_BLACK, tick);
        const mcp_asdf_frame_t settle = command_to(OWN_ID, MCP_ASDF_SETTLE, tick);
        node_handle_frame(&node, &observe);
        CHECK_EQUAL(count_sent(TELEMETRY_SUBJECT), tick);
        node_handle_frame(&node, &settle);
        CHECK_EQUAL(count_sent(TELEMETRY_SUBJECT), tick + 1);
    }
}

int main(void)
{
    a_node_refuses_periods_that_do_not_fit_together();
    a_node_refuses_what_its_firmware_refuses();
    a_node_announces_itself_with_its_first_heartbeat();
    a_repeated_first_heartbeat_has_the_same_transfer_id();
    each_kind_of_frame_is_sent_in_its_period();
    an_estimate_is_sent_in_the_last_tick_of_its_period();
    the_firmware_counts_black_and_white_tiles();
    no_telemetry_is_sent_without_a_period();
    frames_that_the_bus_does_not_accept_count_as_unsent();
    messages_that_cannot_be_encoded_are_not_sent();
    an_estimate_reaches_the_firmware();
    an_estimate_with_the_own_id_is_a_collision();
    an_estimate_above_1_is_rejected();
    estimates_of_ignored_senders_do_not_reach_the_firmware();
    a_node_can_ignore_one_sender_alone();
    a_node_that_ignores_its_own_id_still_finds_collisions();
    an_alpha_that_doubles_is_a_jump();
    an_alpha_may_double_among_the_first_estimates_of_a_sender();
    a_sender_whose_alpha_has_halved_is_watched_anew();
    an_alpha_of_0_is_no_jump();
    a_node_out_of_lockstep_does_not_read_commands();
    a_malformed_command_is_rejected();
    commands_are_followed_in_their_order_only();
    every_settle_command_is_answered_with_telemetry();
    return check_report();
}
