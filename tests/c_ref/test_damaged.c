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

static void fill(void *memory, size_t size, uint32_t kind)
{
    uint8_t *const bytes = memory;
    for (size_t i = 0; i < size; ++i) {
        bytes[i] = kind == 0 ? 0 : kind == 1 ? 0xFF : (uint8_t)(check_random() >> 32);
    }
}

static mcp_asdf_status_t any_message(mcp_asdf_t *robot)
{
    return mcp_asdf_receive(robot, (uint8_t)check_random(), random_below(MCP_ASDF_ONE + 100),
                            (uint32_t)check_random());
}

/* A sound robot with a few observations and messages behind it. */
static mcp_asdf_t sound_robot(const mcp_asdf_config_t *config)
{
    mcp_asdf_t robot = robot_with(config, (uint8_t)random_below(128), C_MIN + random_below(0 - 2 * C_MIN));
    for (uint32_t i = random_below(20); i > 0; --i) {
        (void)any_message(&robot);
        (void)mcp_asdf_step(&robot, (mcp_asdf_observation_t)(check_random() & 1));
        (void)any_message(&robot);
    }
    CHECK(mcp_asdf_invariants_hold(&robot));
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

/* An image of a damaged robot has a right checksum all the same: it comes back only if the robot is sound. */
static void check_image(const mcp_asdf_t *robot)
{
    uint8_t image[MCP_ASDF_IMAGE_SIZE], again[MCP_ASDF_IMAGE_SIZE];
    mcp_asdf_t copy;
    mcp_asdf_save(robot, image);
    if (mcp_asdf_restore(&copy, robot->config, image) == MCP_ASDF_OK) {
        mcp_asdf_save(&copy, again);
        CHECK(mcp_asdf_invariants_hold(&copy) && memcmp(image, again, sizeof image) == 0);
    } else {
        CHECK(!mcp_asdf_invariants_hold(robot));
    }
}

static void check_call(mcp_asdf_t *robot)
{
    static const mcp_asdf_open_t nothing = {0, 0, 0, 0, 0, 0};
    const uint32_t z = random_below(4);
    mcp_asdf_status_t status;
    switch (check_random() % 6) {
    case 0:
        status = mcp_asdf_step(robot, (mcp_asdf_observation_t)z);
        CHECK(z > 1 ? status == MCP_ASDF_ERR_OBSERVATION
                    : status == MCP_ASDF_OK || status == MCP_ASDF_UPDATED);
        break;
    case 1:
        status = mcp_asdf_settle(robot);
        CHECK(status == MCP_ASDF_OK || status == MCP_ASDF_UPDATED);
        CHECK(memcmp(&robot->open, &nothing, sizeof nothing) == 0); /* forgotten, whatever it was */
        CHECK(robot->heard.all[0] == 0 && robot->heard.all[1] == 0);
        break;
    case 2:
        check_image(robot);
        break;
    case 3:
        (void)mcp_asdf_x(robot);
        (void)mcp_asdf_x_bar(robot);
        break;
    default:
        status = any_message(robot);
        CHECK(status == MCP_ASDF_OK || status == MCP_ASDF_REPEATED || status == MCP_ASDF_ERR_SENDER ||
              status == MCP_ASDF_ERR_X_HAT);
    }
}

int main(void)
{
    guarded_t guarded, filled;
    table[4] = HASH_START;
    for (size_t i = 0; i < 4; ++i) {
        table[4] = (uint32_t)((table[4] ^ table[i]) * UINT64_C(0x01000193) & UINT32_MAX);
    }
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
    return check_report();
}
