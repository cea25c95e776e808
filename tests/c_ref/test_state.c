/* White box: a member that is changed behind the robot's back is noticed where docs/invariants.md promises
 * it, and an image that was damaged, or is of no robot, is refused. */
#include "white_box.h"

#include "mcp_asdf_image.c"

#define WORDS (MCP_ASDF_IMAGE_SIZE / 4)

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

static void identity_counts_and_accuracy_have_ranges(void)
{
    KEEPS(robot.id = 41);
    BREAKS(robot.id = 128);
    BREAKS(robot.id = 255);
    BREAKS(robot.id = 7); /* its own message was heard */
    BREAKS_UPDATED(robot.t = robot.n - 1);
    KEEPS_UPDATED(robot.t = robot.n);
    KEEPS_UPDATED(robot.t = config.memory - 1);
    BREAKS_UPDATED(robot.t = config.memory);
    KEEPS_UPDATED(robot.n = robot.t);
    BREAKS_UPDATED(robot.n = robot.t + 1);
    BREAKS_UPDATED(robot.n = UINT32_MAX);
    KEEPS_UPDATED(set_b_hat(&robot, MCP_ASDF_B_HAT_MIN));
    KEEPS_UPDATED(set_b_hat(&robot, MCP_ASDF_B_HAT_MAX));
    BREAKS_UPDATED(set_b_hat(&robot, MCP_ASDF_B_HAT_MIN - 1));
    BREAKS_UPDATED(set_b_hat(&robot, MCP_ASDF_B_HAT_MAX + 1));
}

/* The longest memory there is: a t beyond it was never counted, whatever the configuration. */
static void no_memory_is_longer_than_the_longest(void)
{
    static const mcp_asdf_config_t longest = {0, 6, MCP_ASDF_MEMORY_MAX, MCP_ASDF_OFF};
    static const mcp_asdf_config_t damaged = {0, 6, UINT32_MAX, MCP_ASDF_OFF};
    KEEPS_UPDATED((robot.config = &longest, robot.t = MCP_ASDF_MEMORY_MAX - 1));
    BREAKS_UPDATED((robot.config = &longest, robot.t = MCP_ASDF_MEMORY_MAX));
    BREAKS_UPDATED((robot.config = &damaged, robot.t = MCP_ASDF_MEMORY_MAX));
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

/* x_hat and alpha are what t, n and b_hat give, in every bit, ... */
static void estimate_follows_from_t_n_and_b_hat(void)
{
    for (uint32_t bit = 0; bit < 32; ++bit) {
        const uint32_t flip = UINT32_C(1) << bit;
        GIVEN(bit, 0, 0);
        BREAKS(robot.x_hat ^= flip);
        BREAKS(robot.alpha ^= flip);
        BREAKS(robot.t ^= flip);
        BREAKS(robot.n ^= flip);
    }
    KEEPS((robot.t = 0, robot.n = 0, robot.x_hat = MCP_ASDF_HALF, robot.alpha = 0));
    BREAKS((robot.t = 0, robot.n = 0, robot.x_hat = MCP_ASDF_HALF));
    BREAKS((robot.t = 0, robot.n = 0, robot.x_hat = MCP_ASDF_HALF + 1, robot.alpha = 0));
    BREAKS((robot.t = 0, robot.n = 1, robot.x_hat = MCP_ASDF_HALF, robot.alpha = 0));
}

/* ... but after an update only in range, until the next observation. */
static void an_update_keeps_the_old_estimate(void)
{
    BREAKS(robot.updated = 2);
    BREAKS(robot.updated = 255);
    KEEPS_UPDATED((void)0);
    KEEPS_UPDATED(robot.x_hat = MCP_ASDF_ONE);
    BREAKS_UPDATED(robot.x_hat = MCP_ASDF_ONE + 1);
    BREAKS_UPDATED(robot.x_hat = UINT32_MAX);
    KEEPS_UPDATED(robot.alpha = ALPHA_MAX);
    KEEPS_UPDATED(robot.alpha = 0);
    KEEPS_UPDATED(robot.alpha = 0x7FFFFF00);
    KEEPS_UPDATED(robot.alpha = 0x80000001);
    BREAKS_UPDATED(robot.alpha = 0x7FFFFF01); /* not the smallest shift */
    BREAKS_UPDATED(robot.alpha = 0x1F);
    for (uint32_t bit = 5; bit < 8; ++bit) { /* bits that no robot sets */
        BREAKS_UPDATED(robot.alpha |= UINT32_C(1) << bit);
    }
    BREAKS_UPDATED((robot.t = 0, robot.n = 0, robot.x_hat = MCP_ASDF_HALF, robot.alpha = 0));
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

/* With one message in the open round, each sum one above what it can give; the count cannot lie. */
static void open_sums_are_those_of_messages(void)
{
    const uint64_t one = MCP_ASDF_ONE;
    KEEPS(robot.open.alpha = ALPHA_MAX_UNITS);
    BREAKS(robot.open.alpha = ALPHA_MAX_UNITS + 1);
    KEEPS((robot.open.x = MCP_ASDF_ONE, robot.open.x_squared = one * one));
    BREAKS((robot.open.x = MCP_ASDF_ONE + 1, robot.open.x_squared = one * one));
    KEEPS(robot.open.x_squared = robot.open.x * one);
    BREAKS(robot.open.x_squared = robot.open.x * one + 1);
    BREAKS(--robot.open.x_squared); /* a variance below 0 */
    KEEPS((robot.open.alpha = ALPHA_MAX_UNITS, robot.open.alpha_x_low = robot.open.x * (uint64_t)UINT32_MAX));
    BREAKS((robot.open.alpha = ALPHA_MAX_UNITS,
            robot.open.alpha_x_low = robot.open.x * (uint64_t)UINT32_MAX + 1));
    KEEPS((robot.open.alpha = ALPHA_MAX_UNITS, robot.open.alpha_x_high = (uint64_t)robot.open.x * 0x7FFFFF));
    BREAKS((robot.open.alpha = ALPHA_MAX_UNITS,
            robot.open.alpha_x_high = (uint64_t)robot.open.x * 0x7FFFFF + 1));
    BREAKS(robot.open.count = 0); /* the sums are too large for no message */
    BREAKS(robot.open.count = 128);
    BREAKS(robot.open.count = UINT32_MAX);
    BREAKS(robot.open.x = 0);
    BREAKS(robot.open.alpha = 1);                       /* a mean above 1.0 */
    BREAKS(robot.open.alpha_x_low = UINT64_C(1) << 53); /* the same */
}

/* Each message with confidence has at least one unit of it. */
static void confidence_is_at_least_a_unit_a_message(void)
{
    mcp_asdf_open_t open = {2, 0, 0, 0, 0, 2};
    KEEPS((robot.open = open, robot.heard.of[0] = 3, robot.heard.of[15] = 0));
    BREAKS((robot.open = open, robot.heard.of[0] = 1, robot.heard.of[15] = 0)); /* one sender for two */
    --open.alpha;
    BREAKS((robot.open = open, robot.heard.of[0] = 3));
    open.count = 0;
    BREAKS(robot.open = open);
    open.alpha = 0;
    KEEPS(robot.open = open);
    open.alpha = open.count = MOST; /* everyone else was heard */
    KEEPS((robot.open = open, memset(&robot.heard, 0xFF, sizeof robot.heard), robot.heard.of[5] = 0xFE));
}

/* A message with confidence has a sender, one without may have one, and the robot hears not itself. */
static void senders_are_counted(void)
{
    KEEPS(robot.heard.of[15] = 0); /* the silent message's */
    KEEPS(robot.heard.of[0] = 0);  /* a sender is left for the one message */
    BREAKS((robot.heard.of[0] = 0, robot.heard.of[15] = 0));
    for (uint32_t bit = 0; bit < 128; ++bit) {
        const uint8_t flip = (uint8_t)(1U << bit % 8);
        GIVEN(bit, 0, 0);
        if (bit == 40) {
            BREAKS(robot.heard.of[bit / 8] |= flip);
        } else {
            KEEPS(robot.heard.of[bit / 8] |= flip);
        }
        mcp_asdf_t robot = busy_robot();
        robot.heard.all[0] = robot.heard.all[1] = 0;
        robot.id = 126 - 40 * (bit == 126);
        robot.heard.of[bit / 8] = flip;
        CHECK(mcp_asdf_invariants_hold(&robot)); /* each bit is one sender */
    }
}

/* Checking it would take a time that grows with its length. */
static void the_table_is_not_looked_at(void)
{
    static const uint32_t nonsense[] = {1, 2, 3};
    static const mcp_asdf_config_t damaged = {nonsense, 6, 1000, MCP_ASDF_ADAPTIVE};
    static const mcp_asdf_config_t missing = {0, 6, 1000, MCP_ASDF_ADAPTIVE};
    KEEPS(robot.config = &damaged);
    KEEPS(robot.config = &missing);
}

static void rounds_left_stay_in_the_period(void)
{
    BREAKS(robot.filter_left = 0);
    KEEPS(robot.filter_left = 1);
    KEEPS(robot.filter_left = 6);
    BREAKS(robot.filter_left = 7);
    BREAKS(robot.filter_left = UINT32_MAX);
}

/* ---- Images ---- */

static uint32_t word_at(const uint8_t *bytes)
{
    return bytes[0] | (uint32_t)bytes[1] << 8 | (uint32_t)bytes[2] << 16 | (uint32_t)bytes[3] << 24;
}

/* Put the word into the image, and a right checksum at its end. */
static void set_word(uint8_t *image, uint32_t index, uint32_t value)
{
    uint32_t hash = HASH_START;
    for (uint32_t i = 0; i < 4; ++i) {
        image[4 * index + i] = (uint8_t)(value >> 8 * i);
    }
    for (uint32_t i = 0; i < WORDS - 1; ++i) {
        hash = (uint32_t)((hash ^ word_at(&image[4 * i])) * UINT64_C(0x01000193) & UINT32_MAX);
    }
    for (uint32_t i = 0; i < 4; ++i) {
        image[4 * (WORDS - 1) + i] = (uint8_t)(hash >> 8 * i);
    }
}

/* What the image gives; a refusal leaves the robot as it was. */
static mcp_asdf_status_t restored(const uint8_t *image)
{
    mcp_asdf_t target, before;
    memset(&target, 0xA5, sizeof target);
    memset(&before, 0xA5, sizeof before);
    const mcp_asdf_status_t status = mcp_asdf_restore(&target, &config, image);
    CHECK((memcmp(&target, &before, sizeof target) == 0) == (status != MCP_ASDF_OK));
    return status;
}

/* Every step of the checksum is one to one, so no single damaged word can pass. */
static void every_flipped_bit_is_refused(void)
{
    const mcp_asdf_t busy = busy_robot();
    uint8_t image[MCP_ASDF_IMAGE_SIZE];
    mcp_asdf_save(&busy, image);
    for (uint32_t bit = 0; bit < 8 * MCP_ASDF_IMAGE_SIZE; ++bit) {
        image[bit / 8] ^= (uint8_t)(1U << bit % 8);
        GIVEN(bit, 0, 0);
        CHECK_EQUAL(restored(image), MCP_ASDF_ERR_IMAGE);
        image[bit / 8] ^= (uint8_t)(1U << bit % 8);
    }
    CHECK_EQUAL(restored(image), MCP_ASDF_OK);
}

/* One bit of each number of the sums after the other: what is taken, the invariants hold for. */
static void restore_takes_what_the_invariants_allow(void)
{
    const mcp_asdf_t busy = busy_robot();
    uint32_t taken = 0;
    for (uint32_t bit = 32 * 7; bit < 32 * 27; ++bit) {
        uint8_t image[MCP_ASDF_IMAGE_SIZE];
        mcp_asdf_t robot;
        mcp_asdf_save(&busy, image);
        set_word(image, bit / 32, word_at(&image[bit / 32 * 4]) ^ UINT32_C(1) << bit % 32);
        GIVEN(bit, 0, 0);
        if (mcp_asdf_restore(&robot, &config, image) == MCP_ASDF_OK) {
            uint8_t again[MCP_ASDF_IMAGE_SIZE];
            mcp_asdf_save(&robot, again);
            CHECK(mcp_asdf_invariants_hold(&robot) && memcmp(image, again, sizeof again) == 0);
            ++taken;
        }
    }
    CHECK(taken > 100 && taken < 600);
}

int main(void)
{
    identity_counts_and_accuracy_have_ranges();
    no_memory_is_longer_than_the_longest();
    cache_follows_from_b_hat();
    estimate_follows_from_t_n_and_b_hat();
    an_update_keeps_the_old_estimate();
    closed_round_is_a_mean();
    open_sums_are_those_of_messages();
    confidence_is_at_least_a_unit_a_message();
    senders_are_counted();
    the_table_is_not_looked_at();
    rounds_left_stay_in_the_period();
    every_flipped_bit_is_refused();
    restore_takes_what_the_invariants_allow();
    return check_report();
}
