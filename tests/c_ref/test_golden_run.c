/* Black box: a recorded run of the integer mirror, to the last bit. golden_run.h is generated from the mirror
 * and checked against it by test_golden_run.py. */
#include "check.h"
#include "mcp_asdf_image.h"

#include <string.h>

/* A message as `receive` takes it. */
typedef struct {
    uint8_t sender;
    uint32_t x_hat, alpha;
} message_t;

/* A tick: z is an observation, or 2 if there is none; messages come in before settle; the values are those
 * after it. */
typedef struct {
    uint8_t z, status, messages;
    message_t message[4];
    uint32_t x_hat, alpha, x_bar;
    uint64_t beta;
    uint32_t x, b_hat;
} tick_t;

#include "golden_run.h"

static void check_tick(mcp_asdf_t *robot, const tick_t *tick)
{
    if (tick->z <= MCP_ASDF_BLACK) {
        CHECK_EQUAL(mcp_asdf_observe(robot, (mcp_asdf_observation_t)tick->z), MCP_ASDF_OK);
    }
    for (uint8_t i = 0; i < tick->messages; ++i) {
        const message_t *const message = &tick->message[i];
        (void)mcp_asdf_receive(robot, message->sender, message->x_hat, message->alpha);
    }
    CHECK_EQUAL(mcp_asdf_settle(robot), tick->status);
    CHECK_EQUAL(mcp_asdf_x_hat(robot), tick->x_hat);
    CHECK_EQUAL(mcp_asdf_alpha(robot), tick->alpha);
    CHECK_EQUAL(mcp_asdf_x_bar(robot), tick->x_bar);
    CHECK_EQUAL(mcp_asdf_beta(robot), tick->beta);
    CHECK_EQUAL(mcp_asdf_x(robot), tick->x);
    CHECK_EQUAL(mcp_asdf_b_hat(robot), tick->b_hat);
    CHECK(mcp_asdf_invariants_hold(robot));
}

int main(void)
{
    static const mcp_asdf_config_t config = {golden_table, 4, 64, MCP_ASDF_ADAPTIVE};
    uint8_t image[MCP_ASDF_IMAGE_SIZE];
    mcp_asdf_t robot;
    memset(&robot, 0xA5, sizeof robot);
    CHECK_EQUAL(mcp_asdf_init(&robot, &config, GOLDEN_ID, GOLDEN_B_HAT), MCP_ASDF_OK);
    for (size_t i = 0; i < COUNT(golden_ticks); ++i) {
        GIVEN(i, 0, 0);
        check_tick(&robot, &golden_ticks[i]);
    }
    mcp_asdf_save(&robot, image);
    for (size_t i = 0; i < sizeof image; ++i) {
        GIVEN(i, 0, 0);
        CHECK_EQUAL(image[i], golden_image[i]);
    }
    return check_report();
}
