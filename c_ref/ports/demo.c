/* A whole robot without an operating system: in every tick it looks at the floor, tells its neighbours what
 * it thinks, and settles what it has heard from them. docs/porting.md goes through it. */
#include "demo.h"

#include "mcp_asdf_image.h"
#include "port.h"
#include "radio.h"

#ifndef DEMO_ID
#define DEMO_ID 7 /* every robot has its own */
#endif
#if DEMO_ID < 0 || DEMO_ID > 125
#error "DEMO_ID has to be 0 to 125: CAN tools of Cyphal keep 126 and 127 for themselves"
#endif
#ifndef DEMO_CONFIG
/* The filter, which docs/advice.md helps to choose. MCP_ASDF_CONFIG_ASDF(mcp_asdf_t_table_omega05_q30) is for
 * robots whose sensors you doubt, MCP_ASDF_CONFIG_OFF for robots whose sensors are calibrated. */
#define DEMO_CONFIG MCP_ASDF_CONFIG_ROBUST
#endif
#define B_HAT MCP_ASDF_PROBABILITY(95, 100) /* we believe that the sensor is right 95 times out of 100 */
#define TICKS_PER_SECOND 10

extern const uint32_t mcp_asdf_t_table_omega05_q30[33];
static const mcp_asdf_config_t config = DEMO_CONFIG;
static const mcp_asdf_frame_format_t estimates = MCP_ASDF_FORMAT_ESTIMATE,
                                     reports = MCP_ASDF_FORMAT_TELEMETRY;
static mcp_asdf_t robot;

static void listen(void)
{
    mcp_asdf_frame_t frame;
    mcp_asdf_estimate_t heard;
    while (radio_take(&frame)) {
        if (mcp_asdf_decode_estimate(&heard, estimates.subject, &frame) == MCP_ASDF_FRAME_OK) {
            mcp_asdf_receive(&robot, heard.node, heard.x_hat, heard.alpha);
        }
    }
}

static void broadcast(void)
{
    static uint8_t count;
    mcp_asdf_frame_t frame;
    const mcp_asdf_estimate_t own = {DEMO_ID, count++, mcp_asdf_x_hat(&robot), mcp_asdf_alpha(&robot)};
    if (mcp_asdf_encode_estimate(&frame, &estimates, &own) == MCP_ASDF_FRAME_OK) {
        radio_send(&frame);
    }
}

/* Once a second: a sign of life, with the number of lost packets as its status, and what is worth a log. */
static void report(void)
{
    static uint32_t seconds;
    const uint8_t count = (uint8_t)seconds++;
    const uint8_t health =
        mcp_asdf_invariants_hold(&robot) ? MCP_ASDF_HEALTH_NOMINAL : MCP_ASDF_HEALTH_WARNING;
    const uint8_t updates = (uint8_t)mcp_asdf_counters(&robot).updates;
    const mcp_asdf_heartbeat_t beat = {DEMO_ID,      count,  health, MCP_ASDF_MODE_OPERATIONAL,
                                       radio_lost(), seconds};
    const mcp_asdf_telemetry_t state = {DEMO_ID, count, updates, mcp_asdf_x(&robot),
                                        mcp_asdf_b_hat(&robot) >> 8};
    mcp_asdf_frame_t frame;
    if (mcp_asdf_encode_heartbeat(&frame, estimates.priority, &beat) == MCP_ASDF_FRAME_OK) {
        radio_send(&frame);
    }
    if (mcp_asdf_encode_telemetry(&frame, &reports, &state) == MCP_ASDF_FRAME_OK) {
        radio_send(&frame);
    }
}

static void tick(void)
{
    static uint8_t ticks;
    mcp_asdf_observation_t tile;
    if (board_sees(&tile)) {
        mcp_asdf_observe(&robot, tile);
    }
    broadcast();
    listen();
    mcp_asdf_settle(&robot);
    if (++ticks == TICKS_PER_SECOND) {
        ticks = 0;
        report();
    }
}

int main(void)
{
    if (mcp_asdf_init(&robot, &config, DEMO_ID, B_HAT) != MCP_ASDF_OK) {
        port_exit(1);
    }
    board_start();
    for (;;) {
        listen();
        if (board_tick()) {
            tick();
        }
    }
}
