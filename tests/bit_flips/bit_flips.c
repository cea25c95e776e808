/* What one flipped bit in a running robot's memory comes to, for every bit of every member but the pointer to
 * the configuration. The robot is one of twenty, flawed, and filters; its neighbours' messages were recorded,
 * and do not answer to what it says. A bit flips at any place in a tick: after the observation, a message, or
 * settle. Then the robot goes on for 600 ticks, and checks its invariants before each observation and each
 * settle.
 *
 * Prints a line of counts for each member; a call that traps ends the program. `bit_flips FLIPS FILTER` tries
 * every bit so many times with a robot of this filter, a number; the same numbers everywhere. */
#include "mcp_asdf.c"

#include "mcp_asdf_image.c"

#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define NEIGHBOURS 19
#define AFTER 600  /* ticks that are watched after a flip */
#define TICKS 3000 /* of the recorded run */
#define AT_REST_PHASE (NEIGHBOURS + 1)
#define PHASES (NEIGHBOURS + 2)
#define PER_CENT (MCP_ASDF_ONE / 100)

extern const uint32_t mcp_asdf_t_table_omega05_q30[];
static mcp_asdf_config_t config = {mcp_asdf_t_table_omega05_q30, 100, MCP_ASDF_MEMORY_MAX, 0};

/* The sound run: the robot as each tick begins, and what it saw and heard. */
static struct {
    mcp_asdf_t start;
    uint32_t x; /* as the tick ends */
    uint32_t said[NEIGHBOURS][2];
    uint8_t seen;
} run[TICKS + 1];

typedef struct {
    const char *name;
    size_t offset, size;
} member_t;

#define MEMBER(path) {#path, offsetof(mcp_asdf_t, path), sizeof(((mcp_asdf_t *)0)->path)}
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
                                   MEMBER(crowd.centre),
                                   MEMBER(crowd.spread),
                                   MEMBER(crowd.voices),
                                   MEMBER(crowd.first),
                                   MEMBER(crowd.votes),
                                   MEMBER(crowd.trend),
                                   MEMBER(open.alpha),
                                   MEMBER(open.alpha_x_low),
                                   MEMBER(open.alpha_x_high),
                                   MEMBER(open.x_squared),
                                   MEMBER(open.x),
                                   MEMBER(open.count),
                                   MEMBER(closed.alpha),
                                   MEMBER(closed.alpha_x_low),
                                   MEMBER(closed.alpha_x_high)};

/* What can come of a flip; the first that holds counts, but for the last two.
 *   IN_TIME, LATE    the invariants fail before x is 1 % off; after that
 *   NO_EFFECT, LESS, MORE   nothing sees it: x is what it would have been; always less than 1 % off; not so
 *   STILL            of MORE: x is off by 1 % after the last tick
 *   UNEXPLAINED      of STILL: although t, n and b_hat are what they would have been */
enum { FLIPS, IN_TIME, LATE, NO_EFFECT, LESS, MORE, STILL, UNEXPLAINED, KINDS };
static unsigned long counts[KINDS];

static uint64_t state;

/* splitmix64 */
static uint32_t any(uint32_t limit)
{
    uint64_t z = state += UINT64_C(0x9E3779B97F4A7C15);
    z = (z ^ z >> 30) * UINT64_C(0xBF58476D1CE4E5B9);
    z = (z ^ z >> 27) * UINT64_C(0x94D049BB133111EB);
    return (uint32_t)((z ^ z >> 31) >> 32) % limit;
}

/* Black in 80 % of tiles; sensors are right in 95 %, that of robot 0 in 75 %. */
static mcp_asdf_observation_t look(int robot)
{
    const bool black = any(100) < 80, right = any(100) < (robot == 0 ? 75 : 95);
    return black == right ? MCP_ASDF_BLACK : MCP_ASDF_WHITE;
}

static void record(void)
{
    static mcp_asdf_t robots[NEIGHBOURS + 1];
    for (int i = 0; i <= NEIGHBOURS; ++i) {
        (void)mcp_asdf_init(&robots[i], &config, (uint8_t)i,
                            UINT32_C(4080218931)); /* takes itself for 95 % */
    }
    for (int tick = 0; tick < TICKS; ++tick) {
        run[tick].start = robots[0];
        for (int i = 0; i <= NEIGHBOURS; ++i) {
            const mcp_asdf_observation_t seen = look(i);
            (void)mcp_asdf_observe(&robots[i], seen);
            run[tick].seen = i == 0 ? (uint8_t)seen : run[tick].seen;
        }
        for (int i = 1; i <= NEIGHBOURS; ++i) {
            run[tick].said[i - 1][0] = robots[i].x_hat;
            run[tick].said[i - 1][1] = robots[i].alpha;
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

static bool is_off(uint32_t is, uint32_t was) { return (is > was ? is - was : was - is) > PER_CENT; }

static void strike(mcp_asdf_t *robot, bool now, size_t bit)
{
    if (now) {
        ((uint8_t *)robot)[bit / 8] ^= (uint8_t)(1U << bit % 8);
    }
}

/* A tick of the recorded run, with the invariants checked before observe and before settle; false once they
 * do not hold. The bit flips after the observation, a message, or settle, or not in this tick. */
static bool relive(mcp_asdf_t *robot, int tick, int phase, size_t bit)
{
    if (!mcp_asdf_invariants_hold(robot)) {
        return false;
    }
    (void)mcp_asdf_observe(robot, (mcp_asdf_observation_t)run[tick].seen);
    strike(robot, phase == 0, bit);
    for (int i = 0; i < NEIGHBOURS; ++i) {
        (void)mcp_asdf_receive(robot, (uint8_t)(i + 1), run[tick].said[i][0], run[tick].said[i][1]);
        strike(robot, phase == i + 1, bit);
    }
    if (!mcp_asdf_invariants_hold(robot)) {
        return false;
    }
    (void)mcp_asdf_settle(robot);
    strike(robot, phase == AT_REST_PHASE, bit);
    return true;
}

/* From the flip on: what sees it, and if nothing does, what it does to x. */
static void watch(int begin, int phase, size_t bit)
{
    static mcp_asdf_t robot;
    const mcp_asdf_t *const sound = &run[begin + AFTER].start;
    bool differs = false, more = false, last = false;
    robot = run[begin].start;
    for (int tick = begin; tick < begin + AFTER; ++tick) {
        if (!relive(&robot, tick, tick == begin ? phase : -1, bit)) {
            ++counts[more ? LATE : IN_TIME];
            return;
        }
        const uint32_t x = mcp_asdf_x(&robot);
        last = is_off(x, run[tick].x);
        differs |= x != run[tick].x;
        more |= last;
    }
    const bool is_data =
        robot.t != sound->t || robot.n != sound->n || mcp_asdf_b_hat(&robot) != mcp_asdf_b_hat(sound);
    ++counts[more ? MORE : differs ? LESS : NO_EFFECT];
    counts[STILL] += last;
    counts[UNEXPLAINED] += last && !is_data;
}

int main(int count, char **arguments)
{
    const unsigned long flips = count > 1 ? strtoul(arguments[1], 0, 10) : 1;
    config.filter = (uint8_t)(count > 2 ? strtoul(arguments[2], 0, 10) : MCP_ASDF_ADAPTIVE);
    record();
    for (size_t i = 0; i < sizeof members / sizeof *members; ++i) {
        memset(counts, 0, sizeof counts);
        state = i; /* each member by itself, whatever stands before it */
        for (unsigned long number = 0; number < flips * 8 * members[i].size; ++number) {
            const int begin = 1 + (int)any(TICKS - AFTER - 1), phase = (int)any(PHASES);
            ++counts[FLIPS];
            watch(begin, phase, 8 * members[i].offset + number % (8 * members[i].size));
        }
        printf("%s", members[i].name);
        for (int kind = 0; kind < KINDS; ++kind) {
            printf(" %lu", counts[kind]);
        }
        printf("\n");
    }
    return 0;
}
