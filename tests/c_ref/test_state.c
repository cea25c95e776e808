/* White box: a member that is changed behind the robot's back is noticed where docs/invariants.md promises
 * it. Here are members that an image does not hold, configurations, and the ends of ranges; images of all
 * kinds are compared with the independent implementation (tests/third). */
#include "white_box.h"

#include "mcp_asdf_image.c"

static const mcp_asdf_config_t config = {0, 6, 1000, MCP_ASDF_OFF};

/* A robot in the middle of things: observations, a closed round, an open round with a silent message. */
static mcp_asdf_t busy_robot(void)
{
    mcp_asdf_t robot = robot_with(&config, 40, 0xC1000000);
    for (uint32_t tick = 0; tick < 38; ++tick) {
        for (uint8_t sender = 0; sender < 5; ++sender) {
            (void)mcp_asdf_receive(&robot, sender, 0x200000 + sender, sender == 2 ? 0 : 0x8123450A);
        }
        (void)mcp_asdf_step(&robot, tick % 3 == 0 ? MCP_ASDF_BLACK : MCP_ASDF_WHITE);
    }
    (void)mcp_asdf_receive(&robot, 7, 0x200000, 0x8000000A);
    (void)mcp_asdf_receive(&robot, 126, 0x300000, 0);
    CHECK(mcp_asdf_invariants_hold(&robot));
    return robot;
}

/* After `change`, the invariants do not hold; without it they do. */
#define BREAKS(change)                                                                                       \
    do {                                                                                                     \
        mcp_asdf_t robot = busy_robot();                                                                     \
        change;                                                                                              \
        CHECK(!mcp_asdf_invariants_hold(&robot));                                                            \
    } while (0)

#define KEEPS(change)                                                                                        \
    do {                                                                                                     \
        mcp_asdf_t robot = busy_robot();                                                                     \
        change;                                                                                              \
        CHECK(mcp_asdf_invariants_hold(&robot));                                                             \
    } while (0)

/* The same once b_hat was updated, which leaves x_hat and alpha as they were formed under the old one. */
#define BREAKS_UPDATED(change) BREAKS((robot.updated = 1, change))
#define KEEPS_UPDATED(change) KEEPS((robot.updated = 1, change))

/* The longest memory there is: a t beyond it was never counted, whatever the configuration. The table is not
 * looked at, which would take a time that grows with its length. */
static void configurations_may_be_damaged(void)
{
    static const uint32_t nonsense[] = {1, 2, 3};
    static const mcp_asdf_config_t longest = {0, 6, MCP_ASDF_MEMORY_MAX, MCP_ASDF_OFF};
    static const mcp_asdf_config_t damaged = {0, 6, UINT32_MAX, MCP_ASDF_OFF};
    static const mcp_asdf_config_t bad_table = {nonsense, 6, 1000, MCP_ASDF_ADAPTIVE};
    static const mcp_asdf_config_t no_table = {0, 6, 1000, MCP_ASDF_ADAPTIVE};
    KEEPS_UPDATED((robot.config = &longest, robot.t = MCP_ASDF_MEMORY_MAX - 1));
    BREAKS_UPDATED((robot.config = &longest, robot.t = MCP_ASDF_MEMORY_MAX));
    BREAKS_UPDATED((robot.config = &damaged, robot.t = MCP_ASDF_MEMORY_MAX));
    KEEPS(robot.config = &bad_table);
    KEEPS(robot.config = &no_table);
}

/* Every member of the cache, and b_hat under it, bit by bit, updated or not. */
static void cache_follows_from_b_hat(void)
{
    for (uint32_t bit = 0; bit < 32; ++bit) {
        const uint32_t flip = UINT32_C(1) << bit;
        GIVEN(bit, 0, 0);
        BREAKS_UPDATED(robot.accuracy.b_hat ^= flip);
        BREAKS_UPDATED(robot.accuracy.c ^= flip);
        BREAKS_UPDATED(robot.accuracy.common ^= flip);
        BREAKS_UPDATED(robot.accuracy.rare ^= flip);
        BREAKS_UPDATED(robot.accuracy.g_shift ^= flip);
        BREAKS_UPDATED(robot.accuracy.rare_shift ^= flip);
    }
    BREAKS(set_b_hat(&robot, 0xC1000000 - 4096)); /* sound in itself, but x_hat is of another */
}

/* After an update x_hat and alpha are only in range, until the next observation. */
static void an_update_keeps_the_old_estimate(void)
{
    KEEPS_UPDATED(robot.alpha = 0x7FFFFF00);
    KEEPS_UPDATED(robot.alpha = 0x80000001);
    BREAKS_UPDATED(robot.alpha = 0x7FFFFF01); /* not the smallest shift */
    BREAKS_UPDATED(robot.alpha = 0x1F);
    BREAKS_UPDATED(robot.id = 128);
    mcp_asdf_t robot = busy_robot();
    set_b_hat(&robot, 0x30000000);
    robot.updated = 1;
    CHECK(mcp_asdf_invariants_hold(&robot));
    CHECK_EQUAL(mcp_asdf_observe(&robot, MCP_ASDF_WHITE), MCP_ASDF_OK);
    CHECK(robot.updated == 0 && mcp_asdf_invariants_hold(&robot));
    ++robot.x_hat;
    CHECK(!mcp_asdf_invariants_hold(&robot));
}

/* The closed round's mean is at most 1.0, and its confidence what 127 messages can have. */
static void closed_round_is_a_mean(void)
{
    const uint64_t most = MOST * ALPHA_MAX_UNITS, one = MCP_ASDF_ONE;
    mcp_asdf_closed_t closed = {5, 5 * one, 0};
    KEEPS(robot.closed = closed);
    ++closed.alpha_x_low;
    BREAKS(robot.closed = closed);
    KEEPS((robot.closed.alpha = 0, robot.closed.alpha_x_high = 0, robot.closed.alpha_x_low = 0));
    BREAKS((robot.closed.alpha = 0, robot.closed.alpha_x_high = 0, robot.closed.alpha_x_low = 1));
    BREAKS((robot.closed.alpha = 0, robot.closed.alpha_x_high = 1, robot.closed.alpha_x_low = 0));
    KEEPS((robot.closed.alpha = 512, robot.closed.alpha_x_high = 1, robot.closed.alpha_x_low = 0));
    BREAKS((robot.closed.alpha = 512, robot.closed.alpha_x_high = 1, robot.closed.alpha_x_low = 1));
    BREAKS((robot.closed.alpha = 511, robot.closed.alpha_x_high = 1, robot.closed.alpha_x_low = 0));
    KEEPS((robot.closed.alpha = 512, robot.closed.alpha_x_high = 0,
           robot.closed.alpha_x_low = UINT64_C(1) << 32));
    BREAKS((robot.closed.alpha = 512, robot.closed.alpha_x_high = 0,
            robot.closed.alpha_x_low = UINT64_C(1) << 33));
    KEEPS((robot.closed.alpha = most, robot.closed.alpha_x_high = MOST * UINT64_C(0x7FFFFF) * one));
    KEEPS(robot.closed.alpha = most);
    BREAKS(robot.closed.alpha = most + 1);
    KEEPS((robot.closed.alpha = most, robot.closed.alpha_x_low = (UINT64_C(1) << 62) - 1));
    BREAKS((robot.closed.alpha = most, robot.closed.alpha_x_low = UINT64_C(1) << 62));
    BREAKS((robot.closed.alpha = most, robot.closed.alpha_x_high = UINT64_C(1) << 53));
    BREAKS(robot.closed.alpha_x_high = UINT64_MAX);
    BREAKS(robot.closed.alpha_x_low = UINT64_MAX);
}

/* Each message with confidence has at least one unit of it, and a sender. */
static void confidence_is_at_least_a_unit_a_message(void)
{
    mcp_asdf_open_t open = {2, 0, 0, 0, 0, 2};
    KEEPS((robot.open = open, robot.heard.of[0] = 3, robot.heard.of[15] = 0));
    BREAKS((robot.open = open, robot.heard.of[0] = 1, robot.heard.of[15] = 0)); /* one sender for two */
    --open.alpha;
    BREAKS((robot.open = open, robot.heard.of[0] = 3));
    open.alpha = open.count = MOST; /* everyone else was heard */
    KEEPS((robot.open = open, memset(&robot.heard, 0xFF, sizeof robot.heard), robot.heard.of[5] = 0xFE));
    BREAKS((robot.open = open, memset(&robot.heard, 0xFF, sizeof robot.heard)));
    BREAKS(robot.open.count = UINT32_MAX);
}

int main(void)
{
    configurations_may_be_damaged();
    cache_follows_from_b_hat();
    an_update_keeps_the_old_estimate();
    closed_round_is_a_mean();
    confidence_is_at_least_a_unit_a_message();
    return check_report();
}
