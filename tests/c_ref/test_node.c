/* Black box: a node between a bus that keeps what it says and one that says anything. What a tick does when
 * is node.h's promise; what the frames hold is read with the codec, which has a test of its own. */
#include "node/node.h"

#include "check.h"

#define OWN_ID 3
#define FRAMES 64
#define TELEMETRY_SUBJECT 3001
#define COMMAND_SUBJECT 3002
#define ESTIMATE_SUBJECT 3000

/* What the node has sent, and whether the bus takes more. */
typedef struct {
    mcp_asdf_frame_t frames[FRAMES];
    uint32_t sent;
    bool is_full;
} bus_t;

static bool take(void *context, const mcp_asdf_frame_t *frame)
{
    bus_t *const bus = context;
    if (bus->is_full || bus->sent == FRAMES) {
        return false;
    }
    bus->frames[bus->sent++] = *frame;
    return true;
}

static node_settings_t usual_settings(void)
{
    const node_settings_t settings = {.comms_period = 2,
                                      .filter_period = 6,
                                      .memory = MCP_ASDF_MEMORY_MAX,
                                      .estimate = MCP_ASDF_FORMAT_ESTIMATE,
                                      .telemetry = MCP_ASDF_FORMAT_TELEMETRY,
                                      .command = MCP_ASDF_FORMAT_COMMAND,
                                      .b_hat = 0xC0000000,
                                      .ticks_per_second = 4,
                                      .telemetry_period = 3,
                                      .filter = MCP_ASDF_ALWAYS,
                                      .id = OWN_ID};
    return settings;
}

static void make(node_t *node, const node_settings_t *settings, bus_t *bus)
{
    const node_output_t output = {take, bus};
    bus->sent = 0;
    bus->is_full = false;
    CHECK_EQUAL(node_init(node, settings, output), MCP_ASDF_OK);
}

static void tick(node_t *node, mcp_asdf_action_t seen)
{
    node_observe(node, seen);
    node_settle(node);
}

/* Frames of a subject among those sent. */
static uint32_t sent_on(const bus_t *bus, uint32_t subject)
{
    uint32_t found = 0;
    for (uint32_t i = 0; i < bus->sent; ++i) {
        found += (bus->frames[i].id & MCP_ASDF_FRAME_MASK) == MCP_ASDF_FRAME_FILTER(subject);
    }
    return found;
}

/* ---- Start ---- */

static void periods_must_fit_together(void)
{
    static const uint32_t periods[][2] = {{0, 6}, {4, 6}, {2, 0}};
    node_settings_t settings = usual_settings();
    const node_output_t output = {take, 0};
    node_t node;
    for (size_t i = 0; i < COUNT(periods); ++i) {
        settings.comms_period = periods[i][0];
        settings.filter_period = periods[i][1];
        CHECK_EQUAL(-node_init(&node, &settings, output), -MCP_ASDF_ERR_CONFIG);
    }
    settings = usual_settings();
    settings.id = 128;
    CHECK_EQUAL(-node_init(&node, &settings, output), -MCP_ASDF_ERR_ID);
}

static void a_started_node_says_so(void)
{
    const node_settings_t settings = usual_settings();
    bus_t bus;
    node_t node;
    make(&node, &settings, &bus);
    node_start(&node);
    CHECK(bus.sent == 1 && sent_on(&bus, MCP_ASDF_SUBJECT_HEARTBEAT) == 1);
    CHECK(bus.frames[0].data[0] == 0 && bus.frames[0].data[7] == 0xE0); /* of uptime and transfer id */
}

/* ---- Ticks ---- */

/* 24 ticks: broadcasts in every second, heartbeats in the first of every second but the first, telemetry
 * after every third; the robot counts what was seen. */
static void everything_is_said_when_it_is_due(void)
{
    const node_settings_t settings = usual_settings();
    bus_t bus;
    node_t node;
    make(&node, &settings, &bus);
    for (uint32_t i = 0; i < 24; ++i) {
        tick(&node, i % 3 == 0   ? MCP_ASDF_OBSERVE_NONE
                    : i % 3 == 1 ? MCP_ASDF_OBSERVE_BLACK
                                 : MCP_ASDF_OBSERVE_WHITE);
    }
    CHECK_EQUAL(sent_on(&bus, ESTIMATE_SUBJECT), 12);
    CHECK_EQUAL(sent_on(&bus, MCP_ASDF_SUBJECT_HEARTBEAT), 5);
    CHECK_EQUAL(sent_on(&bus, TELEMETRY_SUBJECT), 8);
    CHECK_EQUAL(mcp_asdf_t_count(&node.robot), 16);
    CHECK_EQUAL(mcp_asdf_n_count(&node.robot), 8);
}

static void without_a_telemetry_period_there_is_none(void)
{
    node_settings_t settings = usual_settings();
    bus_t bus;
    node_t node;
    settings.telemetry_period = 0;
    make(&node, &settings, &bus);
    for (uint32_t i = 0; i < 6; ++i) {
        tick(&node, MCP_ASDF_OBSERVE_WHITE);
    }
    CHECK_EQUAL(sent_on(&bus, TELEMETRY_SUBJECT), 0);
}

/* A round ends with every second tick: a message of the first is in the sums after the second. */
static void a_round_is_closed_when_due(void)
{
    const node_settings_t settings = usual_settings();
    bus_t bus;
    node_t node;
    make(&node, &settings, &bus);
    node_observe(&node, MCP_ASDF_OBSERVE_WHITE);
    CHECK_EQUAL(mcp_asdf_receive(&node.robot, 9, 0, 0x100), MCP_ASDF_OK);
    node_settle(&node);
    CHECK_EQUAL(mcp_asdf_beta(&node.robot), 0);
    node_observe(&node, MCP_ASDF_OBSERVE_WHITE);
    CHECK_EQUAL(mcp_asdf_beta(&node.robot), 0);
    node_settle(&node);
    CHECK_EQUAL(mcp_asdf_beta(&node.robot), 1);
}

static void a_tick_left_open_is_ended_by_the_next(void)
{
    const node_settings_t settings = usual_settings();
    bus_t bus;
    node_t node;
    make(&node, &settings, &bus);
    for (uint32_t i = 0; i < 3; ++i) {
        node_observe(&node, MCP_ASDF_OBSERVE_WHITE);
        (void)mcp_asdf_receive(&node.robot, 9, 0, 0x100);
    }
    CHECK_EQUAL(node.counts.unsettled, 2);
    CHECK_EQUAL(mcp_asdf_beta(&node.robot), 1);
    CHECK_EQUAL(sent_on(&bus, TELEMETRY_SUBJECT), 0);
}

static void what_the_bus_refuses_is_counted(void)
{
    node_settings_t settings = usual_settings();
    bus_t bus;
    node_t node;
    make(&node, &settings, &bus);
    bus.is_full = true;
    node_start(&node);
    tick(&node, MCP_ASDF_OBSERVE_WHITE);
    tick(&node, MCP_ASDF_OBSERVE_WHITE);
    CHECK_EQUAL(node.counts.unsent, 2);
    CHECK(bus.sent == 0 && node.counts.heartbeats == 1 && node.counts.estimates == 1);
}

/* What cannot be encoded is made, and neither sent nor unsent. */
static void what_no_frame_can_hold_is_not_sent(void)
{
    node_settings_t settings = usual_settings();
    bus_t bus;
    node_t node;
    settings.estimate.subject = settings.telemetry.subject = MCP_ASDF_SUBJECT_MAX + 1;
    make(&node, &settings, &bus);
    node.health = MCP_ASDF_HEALTH_WARNING + 1;
    for (uint32_t i = 0; i < 6; ++i) {
        tick(&node, MCP_ASDF_OBSERVE_WHITE);
    }
    CHECK(bus.sent == 0 && node.counts.unsent == 0);
    CHECK(node.counts.estimates == 3 && node.counts.telemetry == 2 && node.counts.heartbeats == 1);
}

/* ---- Frames of others ---- */

static mcp_asdf_frame_t estimate_of(uint8_t sender)
{
    const mcp_asdf_frame_format_t format = MCP_ASDF_FORMAT_ESTIMATE;
    const mcp_asdf_estimate_t message = {.node = sender, .x_hat = MCP_ASDF_HALF, .alpha = 0x100};
    mcp_asdf_frame_t frame;
    CHECK_EQUAL(mcp_asdf_encode_estimate(&frame, &format, &message), MCP_ASDF_FRAME_OK);
    return frame;
}

static mcp_asdf_frame_t command_to(uint8_t target, mcp_asdf_action_t action, uint32_t number)
{
    const mcp_asdf_frame_t frame = {
        .id = MCP_ASDF_FRAME_FILTER(COMMAND_SUBJECT) | 126,
        .length = 8,
        .data = {(uint8_t)number, (uint8_t)(number >> 8), 0, 0, target, (uint8_t)action, 0, 0xE0}};
    return frame;
}

static void estimates_reach_the_robot(void)
{
    const node_settings_t settings = usual_settings();
    mcp_asdf_frame_t frame = estimate_of(9);
    bus_t bus;
    node_t node;
    make(&node, &settings, &bus);
    node_hear(&node, &frame);
    CHECK(node.counts.heard == 1 && node.counts.collisions == 0);
    CHECK_EQUAL(mcp_asdf_counters(&node.robot).accepted, 1);
    frame = estimate_of(OWN_ID);
    node_hear(&node, &frame);
    CHECK(node.counts.heard == 2 && node.counts.collisions == 1);
    CHECK_EQUAL(mcp_asdf_counters(&node.robot).rejected, 1);
}

/* Commands are other frames to a node that is not in lockstep, and damaged ones refused by one that is. */
static void other_frames_are_counted(void)
{
    node_settings_t settings = usual_settings();
    mcp_asdf_frame_t command = command_to(OWN_ID, MCP_ASDF_OBSERVE_BLACK, 0), damaged = estimate_of(9);
    bus_t bus;
    node_t node;
    damaged.data[2] = 0xFF; /* an x_hat above 1 */
    make(&node, &settings, &bus);
    node_hear(&node, &command);
    CHECK(node.counts.others == 1 && node.counts.refused == 0 && node.ticks == 0);
    node_hear(&node, &damaged);
    CHECK(node.counts.others == 1 && node.counts.refused == 1 && node.counts.heard == 0);
    settings.lockstep = true;
    make(&node, &settings, &bus);
    command.length = 7;
    node_hear(&node, &command);
    CHECK(node.counts.others == 0 && node.counts.refused == 1 && node.ticks == 0);
}

/* ---- Lockstep ---- */

typedef struct {
    uint8_t target;
    mcp_asdf_action_t action;
    uint32_t number;
    uint32_t obeyed, disobeyed, ticks; /* after it */
} order_t;

static void commands_are_followed_in_their_order(void)
{
    static const order_t orders[] = {
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
    node_settings_t settings = usual_settings();
    bus_t bus;
    node_t node;
    settings.lockstep = true;
    make(&node, &settings, &bus);
    for (size_t i = 0; i < COUNT(orders); ++i) {
        const mcp_asdf_frame_t frame = command_to(orders[i].target, orders[i].action, orders[i].number);
        GIVEN(i, node.counts.obeyed, node.counts.disobeyed);
        node_hear(&node, &frame);
        CHECK_EQUAL(node.counts.obeyed, orders[i].obeyed);
        CHECK_EQUAL(node.counts.disobeyed, orders[i].disobeyed);
        CHECK_EQUAL(node.ticks, orders[i].ticks);
    }
    CHECK_EQUAL(node.counts.unsettled, 1);
    CHECK_EQUAL(sent_on(&bus, TELEMETRY_SUBJECT), 1); /* every settle is answered */
    CHECK_EQUAL(mcp_asdf_t_count(&node.robot), 2);
}

int main(void)
{
    periods_must_fit_together();
    a_started_node_says_so();
    everything_is_said_when_it_is_due();
    without_a_telemetry_period_there_is_none();
    a_round_is_closed_when_due();
    a_tick_left_open_is_ended_by_the_next();
    what_the_bus_refuses_is_counted();
    what_no_frame_can_hold_is_not_sent();
    estimates_reach_the_robot();
    other_frames_are_counted();
    commands_are_followed_in_their_order();
    return check_report();
}
