/* White box: a member that is changed behind the robot's back is noticed where docs/invariants.md promises
 * it. Here are members that an image does not hold, configurations, and the ends of ranges; images of all
 * kinds are compared with the independent implementation (tests/third). */
#include "white_box.h"

#include "mcp_asdf_image.c"

#define MOST UINT64_C(127) /* messages in a round */

static const mcp_asdf_config_t config = {0, 6, 1000, MCP_ASDF_OFF};
static const mcp_asdf_config_t robust = {0, 6, 1000, MCP_ASDF_ROBUST};

/* A robot in the middle of things: observations, a closed round, an open round with a silent message. */
static mcp_asdf_t busy_robot(const mcp_asdf_config_t *its_config)
{
    mcp_asdf_t robot;
    CHECK_EQUAL(mcp_asdf_init(&robot, its_config, 40, 0xC1000000), MCP_ASDF_OK);
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

/* Whether the invariants hold after `change` of a busy robot. */
#define IS_SOUND(change, expected) IS_SOUND_WITH(&config, change, expected)
#define IS_SOUND_WITH(config, change, expected)                                                              \
    do {                                                                                                     \
        mcp_asdf_t robot = busy_robot(config);                                                               \
        change;                                                                                              \
        CHECK_EQUAL(mcp_asdf_invariants_hold(&robot), expected);                                             \
    } while (0)

/* The same once b_hat was updated, which leaves x_hat and alpha as they were formed under the old one. */
#define IS_SOUND_UPDATED(change, expected) IS_SOUND((robot.updated = 1, change), expected)

/* The longest memory there is: a t beyond it was never counted, whatever the configuration. The table is not
 * looked at, which would take a time that grows with its length. */
static void configurations_may_be_damaged(void)
{
    static const uint32_t nonsense[] = {1, 2, 3};
    static const mcp_asdf_config_t longest = {0, 6, MCP_ASDF_MEMORY_MAX, MCP_ASDF_OFF};
    static const mcp_asdf_config_t damaged = {0, 6, UINT32_MAX, MCP_ASDF_OFF};
    static const mcp_asdf_config_t bad_table = {nonsense, 6, 1000, MCP_ASDF_ADAPTIVE};
    IS_SOUND_UPDATED((robot.config = &longest, robot.t = MCP_ASDF_MEMORY_MAX - 1), true);
    IS_SOUND_UPDATED((robot.config = &longest, robot.t = MCP_ASDF_MEMORY_MAX), false);
    IS_SOUND_UPDATED((robot.config = &damaged, robot.t = MCP_ASDF_MEMORY_MAX), false);
    IS_SOUND(robot.config = &bad_table, true);
}

/* Every member of the cache, and b_hat under it, bit by bit. */
/* design: R17, R32 */
static void cache_follows_from_b_hat(void)
{
    for (uint32_t bit = 0; bit < 32; ++bit) {
        const uint32_t flip = UINT32_C(1) << bit;
        GIVEN(bit, 0, 0);
        IS_SOUND_UPDATED(robot.accuracy.b_hat ^= flip, false);
        IS_SOUND_UPDATED(robot.accuracy.c ^= flip, false);
        IS_SOUND_UPDATED(robot.accuracy.common ^= flip, false);
        IS_SOUND_UPDATED(robot.accuracy.rare ^= flip, false);
        IS_SOUND_UPDATED(robot.accuracy.g_shift ^= flip, false);
        IS_SOUND_UPDATED(robot.accuracy.rare_shift ^= flip, false);
    }
    IS_SOUND(set_b_hat(&robot, 0xC1000000 - 4096), false); /* sound in itself, but x_hat is of another */
}

/* After an update alpha is only a word that a robot forms, until the next observation. */
/* design: R10, R29 */
static void an_update_keeps_the_old_estimate(void)
{
    IS_SOUND_UPDATED(robot.alpha = 0x7FFFFF00, true);
    IS_SOUND_UPDATED(robot.alpha = 0x80000001, true);
    IS_SOUND_UPDATED(robot.alpha = 0x7FFFFF01, false); /* not the smallest shift */
    IS_SOUND_UPDATED(robot.alpha = 0x1F, false);
}

/* The closed round's mean is at most 1.0, and its confidence what 127 messages can have. */
/* design: R8 */
static void closed_round_is_a_mean(void)
{
    const uint64_t most = MOST * ((UINT64_C(1) << 55) - (UINT64_C(1) << 31)), one = MCP_ASDF_ONE;
    const struct {
        mcp_asdf_closed_t closed; /* sums of alpha, and of alpha x_hat: low, high */
        bool is_sound;
    } rounds[] = {
        {{0, 0, 0}, true},
        {{0, 1, 0}, false},
        {{0, 0, 1}, false},
        {{5, 5 * one, 0}, true},
        {{5, 5 * one + 1, 0}, false},
        {{511, 0, 1}, false},
        {{512, 0, 1}, true},
        {{512, 1, 1}, false},
        {{512, UINT64_C(1) << 32, 0}, true},
        {{512, UINT64_C(1) << 33, 0}, false},
        {{most, 0, MOST * UINT64_C(0x7FFFFF) * one}, true},
        {{most, 0, UINT64_C(1) << 53}, false},
        {{most, (UINT64_C(1) << 62) - 1, 0}, true},
        {{most, UINT64_C(1) << 62, 0}, false},
        {{most + 1, 0, 0}, false},
        {{5, UINT64_MAX, UINT64_MAX}, false},
    };
    for (size_t i = 0; i < COUNT(rounds); ++i) {
        GIVEN(i, 0, 0);
        IS_SOUND(robot.closed = rounds[i].closed, rounds[i].is_sound);
    }
}

/* Rounds of a robust robot are empty, and another robot's crowd is as in a new robot; images hold neither. */
static void only_one_filter_has_a_memory(void)
{
    mcp_asdf_open_t open = {1, 0, 0, 0, 0, 1};
    IS_SOUND_WITH(&robust, (void)robot, true);
    IS_SOUND_WITH(&robust, robot.open = open, false);
    IS_SOUND_WITH(&robust, robot.closed.alpha = 1, false);
    IS_SOUND_WITH(&robust, robot.config = &config, false);
    IS_SOUND(robot.config = &robust, false);
    IS_SOUND(robot.crowd.first = robot.accuracy.b_hat, false);
    IS_SOUND(++robot.crowd.votes, false);
    IS_SOUND(robot.crowd.voices = 1, false);
    IS_SOUND(++robot.crowd.centre, false);
    IS_SOUND(--robot.crowd.spread, false);
    IS_SOUND(++robot.crowd.trend, false);
}

int main(void)
{
    configurations_may_be_damaged();
    cache_follows_from_b_hat();
    an_update_keeps_the_old_estimate();
    closed_round_is_a_mean();
    only_one_filter_has_a_memory();
    return check_report();
}
