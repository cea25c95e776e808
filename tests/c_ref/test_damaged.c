/* White box, so that each variant is tried: robots of any memory contents but for the config pointer. Every
 * call returns one of its statuses, without undefined behaviour and without a touch beyond the robot; most of
 * that shows under the preset "sanitizers". */
#include "white_box.h"

#include "mcp_asdf_image.c"

#define CASES 8000
#define CALLS 8

/* A robot between bytes that must not be touched. */
typedef struct {
    uint8_t before[32];
    mcp_asdf_t robot;
    uint8_t after[32];
} guarded_t;

static uint32_t table[] = {TABLE_MAGIC | 2, 1, 3 * K_ONE, 2 * K_ONE, 0};
static const mcp_asdf_config_t configs[] = {{table, 1, MCP_ASDF_MEMORY_MAX, MCP_ASDF_ADAPTIVE},
                                            {table, 5, MCP_ASDF_MEMORY_MIN, MCP_ASDF_ADAPTIVE},
                                            {0, 1, 1000, MCP_ASDF_ALWAYS},
                                            {0, UINT32_MAX, MCP_ASDF_MEMORY_MAX, MCP_ASDF_OFF}};

static void seal_table(void)
{
    uint32_t hash = HASH_START;
    for (size_t i = 0; i < COUNT(table) - 1; ++i) {
        hash = (uint32_t)((hash ^ table[i]) * UINT64_C(0x01000193) & UINT32_MAX);
    }
    table[COUNT(table) - 1] = hash;
    CHECK(table_valid(table));
}

static void fill(void *memory, size_t size, uint32_t kind)
{
    uint8_t *const bytes = memory;
    for (size_t i = 0; i < size; ++i) {
        bytes[i] = kind == 0 ? 0 : kind == 1 ? 0xFF : (uint8_t)(check_random() >> 32);
    }
}

/* A sound robot with a few observations and messages behind it. */
static mcp_asdf_t sound_robot(const mcp_asdf_config_t *config)
{
    mcp_asdf_t robot = robot_with(config, (uint8_t)random_below(128), C_MIN + random_below(0 - 2 * C_MIN));
    for (uint32_t i = random_below(20); i > 0; --i) {
        (void)mcp_asdf_receive(&robot, (uint8_t)(check_random() & 127), random_below(MCP_ASDF_ONE + 1),
                               (uint32_t)check_random());
        (void)mcp_asdf_step(&robot, (mcp_asdf_observation_t)(check_random() & 1));
        (void)mcp_asdf_receive(&robot, (uint8_t)(check_random() & 127), random_below(MCP_ASDF_ONE + 1),
                               (uint32_t)check_random());
    }
    return robot;
}

/* All bytes alike or at random, or a sound robot with one bit, byte or aligned word that is not. */
static mcp_asdf_t damaged_robot(const mcp_asdf_config_t *config, uint32_t kind)
{
    mcp_asdf_t robot = sound_robot(config);
    uint8_t *const bytes = (uint8_t *)&robot;
    const size_t at = (size_t)(check_random() % sizeof robot);
    if (kind < 4) {
        fill(&robot, sizeof robot, kind);
    } else if (kind < 7) {
        bytes[at] ^= (uint8_t)(1U << check_random() % 8);
    } else if (kind < 9) {
        fill(&bytes[at], 1, 1 + kind % 2);
    } else {
        fill(&bytes[at / 4 * 4], 4, kind - 9);
    }
    if (kind % 2 == 1) {
        robot.filter_left = 1;
    }
    robot.config = config;
    return robot;
}

static void check_observation(mcp_asdf_t *robot)
{
    const uint32_t z = random_below(4);
    const mcp_asdf_status_t status = check_random() % 2 == 0
                                         ? mcp_asdf_observe(robot, (mcp_asdf_observation_t)z)
                                         : mcp_asdf_step(robot, (mcp_asdf_observation_t)z);
    if (z > MCP_ASDF_BLACK) {
        CHECK_EQUAL(-status, -MCP_ASDF_ERR_OBSERVATION);
    } else {
        CHECK(status == MCP_ASDF_OK || status == MCP_ASDF_UPDATED);
    }
}

static void check_message(mcp_asdf_t *robot)
{
    const uint8_t sender = (uint8_t)check_random();
    const uint32_t x_hat = random_below(MCP_ASDF_ONE + 100), alpha = (uint32_t)check_random();
    const mcp_asdf_status_t status = mcp_asdf_receive(robot, sender, x_hat, alpha);
    if (status == MCP_ASDF_OK || status == MCP_ASDF_REPEATED) {
        CHECK(x_hat <= MCP_ASDF_ONE && sender != robot->id);
        CHECK_EQUAL(mcp_asdf_receive(robot, sender, x_hat, alpha), MCP_ASDF_REPEATED);
    } else {
        CHECK(status == MCP_ASDF_ERR_SENDER || status == MCP_ASDF_ERR_X_HAT);
    }
}

/* A settled round is forgotten, whatever it was. */
static void check_settle(mcp_asdf_t *robot)
{
    static const mcp_asdf_open_t nothing = {0, 0, 0, 0, 0, 0};
    const mcp_asdf_status_t status = mcp_asdf_settle(robot);
    CHECK(status == MCP_ASDF_OK || status == MCP_ASDF_UPDATED);
    CHECK(memcmp(&robot->open, &nothing, sizeof nothing) == 0);
    CHECK(robot->heard.all[0] == 0 && robot->heard.all[1] == 0);
}

/* An image of a damaged robot has a right checksum all the same: it comes back only if the robot is sound. */
static void check_image(const mcp_asdf_t *robot)
{
    uint8_t image[MCP_ASDF_IMAGE_SIZE], again[MCP_ASDF_IMAGE_SIZE];
    mcp_asdf_t copy;
    mcp_asdf_save(robot, image);
    const mcp_asdf_status_t status = mcp_asdf_restore(&copy, robot->config, image);
    if (status == MCP_ASDF_OK) {
        CHECK(mcp_asdf_invariants_hold(&copy));
        mcp_asdf_save(&copy, again);
        CHECK(memcmp(image, again, sizeof image) == 0);
    } else {
        CHECK_EQUAL(-status, -MCP_ASDF_ERR_IMAGE);
        CHECK(!mcp_asdf_invariants_hold(robot));
    }
}

static void check_call(mcp_asdf_t *robot)
{
    switch (check_random() % 6) {
    case 0:
        check_observation(robot);
        break;
    case 1:
        check_settle(robot);
        break;
    case 2:
        check_image(robot);
        break;
    case 3:
        (void)mcp_asdf_x(robot);
        (void)mcp_asdf_x_bar(robot);
        break;
    default:
        check_message(robot);
    }
}

static void any_memory_contents(void)
{
    guarded_t guarded, filled;
    fill(&filled, sizeof filled, 2);
    memcpy(&guarded, &filled, sizeof guarded);
    for (uint32_t i = 0; i < CASES; ++i) {
        const mcp_asdf_config_t *const config = &configs[i % COUNT(configs)];
        guarded.robot = damaged_robot(config, i / COUNT(configs) % 12);
        for (uint32_t call = 0; call < CALLS; ++call) {
            GIVEN(i, call, 0);
            check_call(&guarded.robot);
        }
        CHECK(guarded.robot.config == config);
        CHECK(memcmp(guarded.before, filled.before, sizeof filled.before) == 0);
        CHECK(memcmp(guarded.after, filled.after, sizeof filled.after) == 0);
    }
}

/* A sound robot with one damaged bit: the invariants miss it, or it is refused. Both happen. */
static void one_damaged_bit(void)
{
    uint32_t missed = 0;
    for (uint32_t bit = 0; bit < 8 * sizeof(mcp_asdf_t); ++bit) {
        mcp_asdf_t robot = sound_robot(&configs[0]);
        CHECK(mcp_asdf_invariants_hold(&robot));
        ((uint8_t *)&robot)[bit / 8] ^= (uint8_t)(1U << bit % 8);
        if (robot.config == &configs[0]) {
            missed += mcp_asdf_invariants_hold(&robot);
            check_image(&robot);
        }
    }
    CHECK(missed > 80 && missed < 800); /* 80 bits of counters, of which any value is possible */
}

int main(void)
{
    seal_table();
    any_memory_contents();
    one_damaged_bit();
    return check_report();
}
