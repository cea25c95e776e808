/* This flips one bit in a running robot's memory, and finds the effect. It tries every bit of every member
 * but the pointer to the configuration. The robot is one of twenty, flawed, and filters. The messages of its
 * neighbours were recorded in a run without a flip, and do not depend on what it sends. A bit flips in some
 * phase of a tick: after the observation, a message, or settle. Then the robot goes on for 1800 ticks, and
 * checks its invariants before each observation and each settle.
 *
 * The program prints one line per member, with its counts. A call that traps ends it.
 * `bit_flips FLIPS FILTER` flips every bit FLIPS times in a robot with this filter, a mcp_asdf_filter_t, and
 * prints the same numbers on every machine. */
#include "mcp_asdf.c"

#include "mcp_asdf_image.c"

#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define NEIGHBOURS 19
#define WATCHED_TICKS 1800 /* ticks that are watched after a flip */
#define TICKS 5000         /* of the recorded run */
#define PHASE_AFTER_SETTLE (NEIGHBOURS + 1)
#define PHASE_COUNT (NEIGHBOURS + 2)
#define PER_CENT (MCP_ASDF_ONE / 100)

extern const uint32_t mcp_asdf_t_table_omega05_q30[];
static mcp_asdf_config_t config = {mcp_asdf_t_table_omega05_q30, 100, MCP_ASDF_MEMORY_MAX, 0};

/* The run without a flip, tick by tick.
 *   start         the robot as the tick begins
 *   x             its informed estimate as the tick ends, Q23
 *   messages      x_hat and alpha that each neighbour sends
 *   observation   what the robot observes, a mcp_asdf_observation_t */
static struct {
    mcp_asdf_t start;
    uint32_t x;
    uint32_t messages[NEIGHBOURS][2];
    uint8_t observation;
} run[TICKS + 1];

/* The bits of a robot that are flipped together: a member, or a part of a member. */
typedef struct {
    const char *name;
    size_t offset, size;
    bool is_flipped_with_asdf, is_flipped_with_robust; /* some memory has another use with the other filter */
} member_t;

#define MEMBER_OF(path, with_asdf, with_robust)                                                              \
    {#path, offsetof(mcp_asdf_t, path), sizeof(((mcp_asdf_t *)0)->path), with_asdf, with_robust}
#define MEMBER(path) MEMBER_OF(path, true, true)
#define SUM(path) MEMBER_OF(received.sums.path, true, false)
static const member_t members[] = {MEMBER(heard),
                                   MEMBER(id),
                                   MEMBER(updated),
                                   MEMBER(counters),
                                   MEMBER(accuracy.b_hat),
                                   MEMBER(accuracy.c),
                                   MEMBER(accuracy.common),
                                   MEMBER(accuracy.rare),
                                   MEMBER(accuracy.g_shift),
                                   MEMBER(accuracy.rare_shift),
                                   MEMBER(t),
                                   MEMBER(n),
                                   MEMBER(x_hat),
                                   MEMBER(alpha),
                                   MEMBER(filter_left),
                                   MEMBER(robust.centre),
                                   MEMBER(robust.spread),
                                   MEMBER(robust.initial_b_hat),
                                   MEMBER(robust.filled_slots),
                                   MEMBER(robust.batch_t),
                                   MEMBER(robust.batch_n),
                                   MEMBER(robust.votes),
                                   MEMBER(robust.dispersion),
                                   MEMBER(robust.turn),
                                   MEMBER_OF(received.estimates, false, true),
                                   SUM(open.alpha),
                                   SUM(open.alpha_x_low),
                                   SUM(open.alpha_x_high),
                                   SUM(open.x_squared),
                                   SUM(open.x),
                                   SUM(open.count),
                                   SUM(closed.alpha),
                                   SUM(closed.alpha_x_low),
                                   SUM(closed.alpha_x_high)};

/* Counts of flips by their effect. Every flip counts in FLIPS and in one of the next five.
 *   IN_TIME       an invariant fails before x is off by more than 1 %
 *   LATE          an invariant fails after that
 *   NO_EFFECT     no invariant fails, and x is what it would have been
 *   LESS          no invariant fails, and x is never off by more than 1 %
 *   MORE          no invariant fails, although x is off by more than 1 % at some time
 *   STILL         of MORE: x is off by more than 1 % after the last tick
 *   UNEXPLAINED   of STILL: although t, n and b_hat are what they would have been */
enum { FLIPS, IN_TIME, LATE, NO_EFFECT, LESS, MORE, STILL, UNEXPLAINED, KINDS };
static unsigned long counts[KINDS];

static uint64_t random_state;

/* Returns a random number below a limit, by splitmix64. */
static uint32_t random_below(uint32_t limit)
{
    random_state += UINT64_C(0x9E3779B97F4A7C15);
    uint64_t z = random_state;
    z = (z ^ (z >> 30)) * UINT64_C(0xBF58476D1CE4E5B9);
    z = (z ^ (z >> 27)) * UINT64_C(0x94D049BB133111EB);
    return (uint32_t)((z ^ (z >> 31)) >> 32) % limit;
}

/* Draw what a robot observes: 80 % of the tiles are black, and sensors are right in 95 % of observations. The
 * sensor of robot 0 is right in 75 %. */
static mcp_asdf_observation_t draw_observation(int robot)
{
    const bool is_tile_black = random_below(100) < 80;
    const bool is_sensor_right = random_below(100) < (robot == 0 ? 75 : 95);
    return is_tile_black == is_sensor_right ? MCP_ASDF_BLACK : MCP_ASDF_WHITE;
}

/* Run twenty robots that all receive from each other, and record what robot 0 observes and receives. */
static void record_run(void)
{
    static mcp_asdf_t robots[NEIGHBOURS + 1];
    for (int i = 0; i <= NEIGHBOURS; ++i) {
        const uint32_t b_hat = UINT32_C(4080218931); /* 0.95 as Q32 */
        (void)mcp_asdf_init(&robots[i], &config, (uint8_t)i, b_hat);
    }
    for (int tick = 0; tick < TICKS; ++tick) {
        run[tick].start = robots[0];
        for (int i = 0; i <= NEIGHBOURS; ++i) {
            const mcp_asdf_observation_t observation = draw_observation(i);
            (void)mcp_asdf_observe(&robots[i], observation);
            if (i == 0) {
                run[tick].observation = (uint8_t)observation;
            }
        }
        for (int i = 1; i <= NEIGHBOURS; ++i) {
            run[tick].messages[i - 1][0] = robots[i].x_hat;
            run[tick].messages[i - 1][1] = robots[i].alpha;
        }
        for (int i = 0; i <= NEIGHBOURS; ++i) {
            for (int j = 0; j <= NEIGHBOURS; ++j) {
                (void)mcp_asdf_receive(&robots[i], (uint8_t)j, robots[j].x_hat, robots[j].alpha);
            }
            robots[i].counters.rejected = 0; /* of its own message */
        }
        for (int i = 0; i <= NEIGHBOURS; ++i) {
            (void)mcp_asdf_settle(&robots[i]);
        }
        run[tick].x = mcp_asdf_x(&robots[0]);
    }
    run[TICKS].start = robots[0];
}

/* Whether x differs from what it was in the run without a flip by more than 1 %. */
static bool is_off(uint32_t x, uint32_t sound_x)
{
    return (x > sound_x ? x - sound_x : sound_x - x) > PER_CENT;
}

/* Flip a bit of the robot, by its number from the first byte on, if `is_now`. */
static void flip_bit(mcp_asdf_t *robot, bool is_now, size_t bit)
{
    if (is_now) {
        ((uint8_t *)robot)[bit / 8] ^= (uint8_t)(1U << (bit % 8));
    }
}

/* Let the robot repeat a tick of the recorded run, and check the invariants before observe and before settle.
 * Returns false, and ends the tick, when they do not hold. The bit flips in one phase: 0 after the
 * observation, i after the i-th message, PHASE_AFTER_SETTLE, or in none for -1. */
static bool repeat_tick(mcp_asdf_t *robot, int tick, int phase, size_t bit)
{
    if (!mcp_asdf_invariants_hold(robot)) {
        return false;
    }
    (void)mcp_asdf_observe(robot, (mcp_asdf_observation_t)run[tick].observation);
    flip_bit(robot, phase == 0, bit);
    for (int i = 0; i < NEIGHBOURS; ++i) {
        (void)mcp_asdf_receive(robot, (uint8_t)(i + 1), run[tick].messages[i][0], run[tick].messages[i][1]);
        flip_bit(robot, phase == i + 1, bit);
    }
    if (!mcp_asdf_invariants_hold(robot)) {
        return false;
    }
    (void)mcp_asdf_settle(robot);
    flip_bit(robot, phase == PHASE_AFTER_SETTLE, bit);
    return true;
}

/* Flip a bit in a phase of tick `begin`, let the robot go on, and count the flip by its effect. */
static void count_effect_of_flip(int begin, int phase, size_t bit)
{
    static mcp_asdf_t robot;
    const mcp_asdf_t *const sound = &run[begin + WATCHED_TICKS].start;
    bool has_differed = false, has_been_off = false, is_off_now = false;
    robot = run[begin].start;
    for (int tick = begin; tick < begin + WATCHED_TICKS; ++tick) {
        if (!repeat_tick(&robot, tick, tick == begin ? phase : -1, bit)) {
            ++counts[has_been_off ? LATE : IN_TIME];
            return;
        }
        const uint32_t x = mcp_asdf_x(&robot);
        is_off_now = is_off(x, run[tick].x);
        has_differed |= x != run[tick].x;
        has_been_off |= is_off_now;
    }
    if (has_been_off) {
        ++counts[MORE];
    } else {
        ++counts[has_differed ? LESS : NO_EFFECT];
    }
    if (is_off_now) {
        const bool has_other_data =
            robot.t != sound->t || robot.n != sound->n || mcp_asdf_b_hat(&robot) != mcp_asdf_b_hat(sound);
        ++counts[STILL];
        if (!has_other_data) {
            ++counts[UNEXPLAINED];
        }
    }
}

/* Flip every bit of every member, and print the counts of each member in a line. */
int main(int count, char **arguments)
{
    const unsigned long flips = count > 1 ? strtoul(arguments[1], 0, 10) : 1;
    config.filter = (uint8_t)(count > 2 ? strtoul(arguments[2], 0, 10) : MCP_ASDF_ADAPTIVE);
    const bool is_robust = config.filter == MCP_ASDF_ROBUST;
    record_run();
    for (size_t i = 0; i < sizeof members / sizeof *members; ++i) {
        if (is_robust ? !members[i].is_flipped_with_robust : !members[i].is_flipped_with_asdf) {
            continue;
        }
        memset(counts, 0, sizeof counts);
        random_state = i; /* each member by itself, whatever stands before it */
        for (unsigned long number = 0; number < flips * 8 * members[i].size; ++number) {
            const int begin = 1 + (int)random_below(TICKS - WATCHED_TICKS - 1);
            const int phase = (int)random_below(PHASE_COUNT);
            const size_t bit = 8 * members[i].offset + number % (8 * members[i].size);
            ++counts[FLIPS];
            count_effect_of_flip(begin, phase, bit);
        }
        printf("%s", members[i].name);
        for (int kind = 0; kind < KINDS; ++kind) {
            printf(" %lu", counts[kind]);
        }
        printf("\n");
    }
    return 0;
}
