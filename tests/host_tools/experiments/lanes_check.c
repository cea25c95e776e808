/* The engine's lanes against the firmware compiled as usual, which divides by hardware: differences that an
 * experiment shows once in a million steps. */
#define mcp_asdf_init usual_init
#define mcp_asdf_observe usual_observe
#define mcp_asdf_receive usual_receive
#define mcp_asdf_settle usual_settle
#define mcp_asdf_step usual_step
#define mcp_asdf_x_bar usual_x_bar
#define mcp_asdf_x usual_x

#include "../../c_ref/white_box.h"

#include "lanes.h"

#define NEIGHBOUR 1
#define ALL_COUNTS 400 /* every n of every t up to it */
#define ROUNDS 1000

static mcp_asdf_t robots[LANES];
static lanes_t lanes;
static lanes_sums_t sums;
static uint32_t black[LANES], x[LANES];

/* Count the observations black[] of lanes that have lanes.n[] before them, as their t-th. */
static void check_observations(uint32_t count, uint32_t t)
{
    static uint32_t before[LANES];
    memcpy(before, lanes.n, sizeof before);
    lanes_observe(&lanes, count, t, black);
    for (uint32_t l = 0; l < count; ++l) {
        const uint32_t n = before[l] + black[l];
        const message_t expected = estimate(t, n, &robots[l].accuracy);
        GIVEN(robots[l].accuracy.b_hat, t, n);
        CHECK_EQUAL(lanes.n[l], n);
        CHECK_EQUAL(lanes.x_hat[l], expected.x_hat);
        CHECK_EQUAL(lanes.alpha[l], expected.alpha);
    }
}

static void new_robot(uint32_t l, uint32_t b_hat)
{
    robots[l] = robot_with(&white_box_config, 0, b_hat);
    lanes_load(&lanes, l, &robots[l]);
}

static void check_all_counts(uint32_t b_hat)
{
    for (uint32_t l = 0; l <= ALL_COUNTS; ++l) {
        new_robot(l, b_hat);
    }
    for (uint32_t t = 1; t <= ALL_COUNTS; ++t) {
        for (uint32_t n = 0; n <= t; ++n) {
            black[n] = n == t || (n > 0 && n % 2 != 0);
            lanes.n[n] = n - black[n];
        }
        check_observations(t + 1, t);
    }
}

static uint32_t any_b_hat(void)
{
    const uint32_t b_hat = check_random_word(),
                   near = (check_random() & 1) != 0 ? 0 - b_hat : ONE_HALF + b_hat;
    const uint32_t chosen = (check_random() & 1) != 0 ? b_hat : near;
    return chosen < MCP_ASDF_B_HAT_MIN   ? MCP_ASDF_B_HAT_MIN
           : chosen > MCP_ASDF_B_HAT_MAX ? MCP_ASDF_B_HAT_MAX
                                         : chosen;
}

/* Accuracies that have fractions n / t at the ends of the scale, their neighbours, and others. */
static void every_count_gives_what_the_firmware_does(void)
{
    check_all_counts(MCP_ASDF_B_HAT_MIN);
    check_all_counts(MCP_ASDF_B_HAT_MAX);
    for (uint32_t twentieths = 1; twentieths < 20; ++twentieths) {
        const uint32_t b_hat = (uint32_t)((UINT64_C(1) << 32) * twentieths / 20);
        check_all_counts(b_hat - 1);
        check_all_counts(b_hat);
        check_all_counts(b_hat + 1);
    }
    for (uint32_t i = 0; i < 20; ++i) {
        check_all_counts(any_b_hat());
    }
}

/* A count of black ones among t observations, often about where x_hat reaches an end of the scale. */
static uint32_t any_n(uint32_t t, uint32_t b_hat)
{
    const uint32_t edge = multiply_high(t, (check_random() & 1) != 0 ? b_hat : 0 - b_hat);
    const uint32_t n = edge + (uint32_t)(check_random() & 7) - 4;
    return n <= t && (check_random() & 3) != 0 ? n : random_below(t + 1);
}

static void large_counts_give_what_the_firmware_does(void)
{
    for (uint32_t round = 0; round < ROUNDS; ++round) {
        const uint32_t t = 1 + random_below(MCP_ASDF_MEMORY_MAX - 1);
        for (uint32_t l = 0; l < LANES; ++l) {
            if (round % 16 == 0) {
                new_robot(l, any_b_hat());
            }
            const uint32_t n = any_n(t, robots[l].accuracy.b_hat);
            black[l] = n == t || (n > 0 && (l & 1) != 0);
            lanes.n[l] = n - black[l];
        }
        check_observations(LANES, t);
    }
}

static void messages_have_the_sums_that_the_firmware_receives(void)
{
    for (uint32_t l = 0; l < LANES; ++l) {
        new_robot(l, MCP_ASDF_B_HAT_MAX);
    }
    for (uint32_t round = 0; round < ROUNDS / 4; ++round) {
        for (uint32_t l = 0; l < LANES; ++l) {
            lanes.x_hat[l] = random_below(MCP_ASDF_ONE + 1);
            lanes.alpha[l] = check_random_word() << (check_random() & 31) | (uint32_t)(check_random() & 31);
        }
        lanes_say(&lanes, LANES, &sums);
        for (uint32_t l = 0; l < LANES; ++l) {
            (void)mcp_asdf_receive(&robots[l], NEIGHBOUR, lanes.x_hat[l], lanes.alpha[l]);
            GIVEN(lanes.x_hat[l], lanes.alpha[l], 0);
            CHECK_EQUAL(sums.alpha[l], robots[l].open.alpha);
            CHECK_EQUAL(sums.alpha_x_low[l], robots[l].open.alpha_x_low);
            CHECK_EQUAL(sums.alpha_x_high[l], robots[l].open.alpha_x_high);
            (void)mcp_asdf_settle(&robots[l]);
        }
    }
}

/* A round of up to 127 messages, with confidences that differ much or little, or without any. */
static void receive_messages(mcp_asdf_t *robot)
{
    const uint32_t messages = random_below(MOST + 1) >> (check_random() & 7);
    const uint32_t largest = (uint32_t)(check_random() & 31), differ = (uint32_t)(check_random() & 31);
    for (uint8_t sender = 1; sender <= messages; ++sender) {
        const uint32_t shift = largest - (largest < differ ? largest : (uint32_t)(check_random() & differ));
        (void)mcp_asdf_receive(robot, sender, random_below(MCP_ASDF_ONE + 1),
                               (check_random_word() & ~UINT32_C(0xFF)) | shift);
    }
}

static void rounds_inform_as_in_the_firmware(void)
{
    for (uint32_t round = 0; round < 20; ++round) {
        for (uint32_t l = 0; l < LANES; ++l) {
            mcp_asdf_t *const robot = &robots[l];
            receive_messages(robot);
            (void)mcp_asdf_settle(robot);
            robot->x_hat = random_below(MCP_ASDF_ONE + 1);
            robot->alpha = (check_random() & 3) != 0 ? check_random_word() & ~UINT32_C(0xE0) : 0;
            lanes_load(&lanes, l, robot);
            sums.alpha[l] = robot->closed.alpha;
            sums.alpha_x_low[l] = robot->closed.alpha_x_low;
            sums.alpha_x_high[l] = robot->closed.alpha_x_high;
        }
        lanes_inform(&lanes, LANES, &sums, x);
        for (uint32_t l = 0; l < LANES; ++l) {
            GIVEN(sums.alpha[l], robots[l].x_hat, robots[l].alpha);
            CHECK_EQUAL(x[l], mcp_asdf_x(&robots[l]));
        }
    }
}

int main(void)
{
    every_count_gives_what_the_firmware_does();
    large_counts_give_what_the_firmware_does();
    messages_have_the_sums_that_the_firmware_receives();
    rounds_inform_as_in_the_firmware();
    return check_report();
}
