/* White box: a member that is changed behind the robot's back is noticed where docs/invariants.md says so,
 * and an image that was damaged is refused. */
#include "white_box.h"

static mcp_asdf_config_t config = {0, 2, 6, 1000, MCP_ASDF_OFF};

/* A robot in the middle of things: observations, a closed round, an open round with a silent message. */
static mcp_asdf_t busy_robot(void)
{
    mcp_asdf_t robot;
    memset(&robot, 0x5A, sizeof robot);
    CHECK_EQUAL(mcp_asdf_init(&robot, &config, 40, 0xC0000000), MCP_ASDF_OK);
    for (uint32_t tick = 0; tick < 38; ++tick) {
        for (uint8_t sender = 0; sender < 5; ++sender) {
            (void)mcp_asdf_receive(&robot, sender, 0x200000 + sender, sender == 2 ? 0 : 0x42000000);
        }
        (void)mcp_asdf_step(&robot, tick % 3 == 0 ? MCP_ASDF_BLACK : MCP_ASDF_WHITE);
    }
    (void)mcp_asdf_receive(&robot, 7, 0x200000, 0x42000000);
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

/* I1, I2, I3 */
static void identity_counts_and_accuracy_have_ranges(void)
{
    BREAKS(robot.id = 128);
    BREAKS(robot.id = 255);
    BREAKS(robot.id = 7); /* its own message was heard: I8 */
    BREAKS(robot.t = robot.n - 1);
    BREAKS(robot.t = config.memory);
    KEEPS(robot.t = config.memory - 1);
    KEEPS(robot.n = robot.t);
    BREAKS(robot.n = robot.t + 1);
    BREAKS(set_b_hat(&robot, MCP_ASDF_B_HAT_MIN - 1));
    BREAKS(set_b_hat(&robot, MCP_ASDF_B_HAT_MAX + 1));
    KEEPS(set_b_hat(&robot, MCP_ASDF_B_HAT_MIN));
    KEEPS(set_b_hat(&robot, MCP_ASDF_B_HAT_MAX));
}

/* I4: every member of the cache, and b_hat under it, bit by bit */
static void cache_follows_from_b_hat(void)
{
    for (uint32_t bit = 0; bit < 32; ++bit) {
        const uint32_t flip = UINT32_C(1) << bit;
        GIVEN(bit, 0, 0);
        BREAKS(robot.b_hat ^= flip);
        BREAKS(robot.accuracy.c ^= flip);
        BREAKS(robot.accuracy.inverse_g ^= flip);
        BREAKS(robot.accuracy.g_squared ^= flip);
        BREAKS(robot.accuracy.edge ^= flip);
        BREAKS(robot.accuracy.odds ^= flip);
    }
    for (uint32_t bit = 0; bit < 8; ++bit) {
        const uint8_t flip = (uint8_t)(1U << bit);
        BREAKS(robot.accuracy.inverted ^= flip);
        BREAKS(robot.accuracy.g_shift ^= flip);
        BREAKS(robot.accuracy.g_squared_shift ^= flip);
        BREAKS(robot.accuracy.edge_shift ^= flip);
        BREAKS(robot.accuracy.odds_left ^= flip);
        BREAKS(robot.accuracy.odds_right ^= flip);
    }
}

/* I5, for the last observation's values and the settled ones alike */
static void estimates_are_on_their_grids(void)
{
    static const uint32_t wrong[] = {
        MCP_ASDF_ALPHA_MAX + 1, 0x7F800000, 0xBF800000, 0x33000000, 0x33800001, 0x3EFFFFFF, 1, 0};
    static const uint32_t right[] = {MCP_ASDF_ALPHA_MAX, 0x33800000, 0x34400000,
                                     0x3EFFFFFE,         0x3F000001, 0x4E800000};
    for (size_t i = 0; i < COUNT(wrong); ++i) {
        GIVEN(wrong[i], 0, 0);
        BREAKS(robot.alpha = wrong[i]);
        BREAKS(robot.settled_alpha = wrong[i]);
    }
    for (size_t i = 0; i < COUNT(right); ++i) {
        GIVEN(right[i], 0, 0);
        KEEPS(robot.alpha = right[i]);
        KEEPS(robot.settled_alpha = right[i]);
    }
    BREAKS(robot.x_hat = MCP_ASDF_ONE + 1);
    BREAKS(robot.settled_x_hat = MCP_ASDF_ONE + 1);
    KEEPS(robot.x_hat = MCP_ASDF_ONE);
    KEEPS((robot.x_hat = MCP_ASDF_HALF, robot.alpha = 0));
    BREAKS((robot.settled_x_hat = MCP_ASDF_HALF + 1, robot.settled_alpha = 0));
}

/* I6: the closed round's mean is at most 1.0, and its confidence what 127 messages can have */
static void closed_round_is_a_mean(void)
{
    const uint64_t most = 127 * ((UINT64_C(1) << 55) - (UINT64_C(1) << 31));
    KEEPS((robot.closed_alpha = 5, robot.closed_alpha_x_high = 0,
           robot.closed_alpha_x_low = 5 * (uint64_t)MCP_ASDF_ONE));
    BREAKS((robot.closed_alpha = 5, robot.closed_alpha_x_high = 0,
            robot.closed_alpha_x_low = 5 * (uint64_t)MCP_ASDF_ONE + 1));
    BREAKS((robot.closed_alpha = 0, robot.closed_alpha_x_high = 0, robot.closed_alpha_x_low = 1));
    BREAKS((robot.closed_alpha = 0, robot.closed_alpha_x_high = 1, robot.closed_alpha_x_low = 0));
    KEEPS((robot.closed_alpha = 512, robot.closed_alpha_x_high = 1, robot.closed_alpha_x_low = 0));
    BREAKS((robot.closed_alpha = 511, robot.closed_alpha_x_high = 1, robot.closed_alpha_x_low = 0));
    KEEPS(robot.closed_alpha = most);
    BREAKS(robot.closed_alpha = most + 1);
    BREAKS((robot.closed_alpha = most, robot.closed_alpha_x_high = UINT64_C(1) << 53));
    BREAKS((robot.closed_alpha = most, robot.closed_alpha_x_low = UINT64_C(1) << 62));
    BREAKS(robot.closed_alpha_x_high = UINT64_MAX);
    BREAKS(robot.closed_alpha_x_low = UINT64_MAX);
}

/* I7: with one message in the open round, each sum one above what it can give */
static void open_sums_are_those_of_messages(void)
{
    const uint64_t largest = (UINT64_C(1) << 55) - (UINT64_C(1) << 31);
    BREAKS(robot.open.alpha = largest + 1);
    BREAKS(robot.open.x = MCP_ASDF_ONE + 1);
    BREAKS(robot.open.x_squared = (uint64_t)robot.open.x * MCP_ASDF_ONE + 1);
    BREAKS(robot.open.alpha_x_low = (uint64_t)robot.open.x * UINT32_MAX + 1);
    BREAKS(robot.open.alpha_x_high = (uint64_t)robot.open.x * 0x7FFFFF + 1);
    BREAKS(robot.open.count = 0); /* the sums are too large for no message */
    BREAKS(robot.open.count = 128);
    BREAKS(robot.open.count = UINT32_MAX);
    BREAKS(
        (robot.open.count = UINT32_MAX, robot.heard.of[0] = 0, robot.heard.of[15] = 0)); /* with silent: 0 */
    BREAKS(robot.open.x = 0);
    BREAKS(--robot.open.x_squared);                     /* a variance below 0 */
    BREAKS(robot.open.alpha = 1);                       /* a mean above 1.0 */
    BREAKS(robot.open.alpha_x_low = UINT64_C(1) << 53); /* the same */
}

/* I8 */
static void senders_are_counted(void)
{
    BREAKS(robot.silent = 0);  /* two senders were heard */
    KEEPS(robot.silent = 129); /* 127 in sums added at once, and the two senders */
    BREAKS(robot.silent = 130);
    BREAKS(robot.heard.of[5] = 1); /* the own id, 40 */
    for (uint32_t i = 0; i < 16; ++i) {
        GIVEN(i, 0, 0);
        BREAKS(robot.heard.of[i] |= 0x0E);
    }
    KEEPS(robot.heard.of[0] = 0); /* messages of add_round have no sender */
}

/* I9, I10: comms_period is 2, filter_period 6 */
static void counters_down_stay_in_their_periods(void)
{
    KEEPS(robot.comms_left = 0);
    KEEPS(robot.comms_left = 2);
    BREAKS(robot.comms_left = 3);
    BREAKS(robot.filter_left = 0);
    BREAKS(robot.filter_left = 1);
    KEEPS(robot.filter_left = 2);
    KEEPS(robot.filter_left = 6);
    BREAKS(robot.filter_left = 8);
    BREAKS(robot.filter_left = UINT32_MAX);
}

/* ---- Images ---- */

static bool same_image(const mcp_asdf_t *robot, const uint8_t *image)
{
    uint8_t now[MCP_ASDF_IMAGE_SIZE];
    mcp_asdf_save(robot, now);
    return memcmp(now, image, sizeof now) == 0;
}

/* I17: every step of the checksum is one to one, so no single damaged word can pass. The target stays as it
 * is. */
static void every_flipped_bit_is_refused(void)
{
    const mcp_asdf_t busy = busy_robot();
    mcp_asdf_t target, before;
    uint8_t image[MCP_ASDF_IMAGE_SIZE];
    memset(&target, 0xA5, sizeof target);
    memset(&before, 0xA5, sizeof before);
    mcp_asdf_save(&busy, image);
    for (uint32_t bit = 0; bit < 8 * MCP_ASDF_IMAGE_SIZE; ++bit) {
        image[bit / 8] ^= (uint8_t)(1U << (bit % 8));
        GIVEN(bit, 0, 0);
        CHECK_EQUAL(mcp_asdf_restore(&target, &config, image), MCP_ASDF_ERR_IMAGE);
        CHECK(memcmp(&target, &before, sizeof target) == 0);
        image[bit / 8] ^= (uint8_t)(1U << (bit % 8));
    }
    CHECK_EQUAL(mcp_asdf_restore(&target, &config, image), MCP_ASDF_OK);
    CHECK(same_image(&target, image));
}

/* The image's checksum is right, but the state in it is none. */
static void impossible_states_are_refused(void)
{
    static const struct {
        uint32_t word, value;
    } wrong[] = {{0, 0},  {0, IMAGE_MAGIC + 1}, {1, 1000},        {2, 39},         {3, 0xFFF},
                 {3, 0},  {3, 0xFFFFF001},      {4, 0x800001},    {5, 0x4F000000}, {6, 0x800001},
                 {7, 1},  {9, 0x80000000},      {15, 0x80000000}, {23, 128},       {28, 3},
                 {29, 5}, {32, 0x80000000}};
    const mcp_asdf_t busy = busy_robot();
    for (size_t i = 0; i < COUNT(wrong); ++i) {
        uint8_t image[MCP_ASDF_IMAGE_SIZE];
        uint32_t hash = HASH_START;
        mcp_asdf_t target, before;
        memset(&target, 0xA5, sizeof target);
        memset(&before, 0xA5, sizeof before);
        mcp_asdf_save(&busy, image);
        for (uint32_t word = 0; word < MCP_ASDF_IMAGE_SIZE / 4 - 1; ++word) {
            uint8_t *const at = &image[4 * word];
            for (uint32_t byte = 0; word == wrong[i].word && byte < 4; ++byte) {
                at[byte] = (uint8_t)(wrong[i].value >> 8 * byte);
            }
            hash = hash_word(hash, (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 |
                                       (uint32_t)at[3] << 24);
        }
        for (uint32_t byte = 0; byte < 4; ++byte) {
            image[MCP_ASDF_IMAGE_SIZE - 4 + byte] = (uint8_t)(hash >> 8 * byte);
        }
        GIVEN(wrong[i].word, wrong[i].value, 0);
        CHECK_EQUAL(mcp_asdf_restore(&target, &config, image), MCP_ASDF_ERR_IMAGE);
        CHECK(memcmp(&target, &before, sizeof target) == 0);
    }
}

int main(void)
{
    identity_counts_and_accuracy_have_ranges();
    cache_follows_from_b_hat();
    estimates_are_on_their_grids();
    closed_round_is_a_mean();
    open_sums_are_those_of_messages();
    senders_are_counted();
    counters_down_stay_in_their_periods();
    every_flipped_bit_is_refused();
    impossible_states_are_refused();
    return check_report();
}
