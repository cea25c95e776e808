/* A whole robot without an operating system: in every tick it reads its ground sensor, sends its estimate to
 * its neighbours, and settles the round of what it has received from them. docs/porting.md builds it.
 */
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
#define B_HAT MCP_ASDF_PROBABILITY(95, 100) /* the sensor is taken to be right 95 times out of 100 */
#define TICKS_PER_SECOND 10

extern const uint32_t mcp_asdf_t_table_omega05_q30[33];
static const mcp_asdf_config_t config = DEMO_CONFIG;
static const mcp_asdf_frame_format_t estimate_format = MCP_ASDF_FORMAT_ESTIMATE,
                                     telemetry_format = MCP_ASDF_FORMAT_TELEMETRY;
static mcp_asdf_t robot;

/* Pass all estimates that have arrived to the firmware; other frames are ignored. */
static void receive(void)
{
    mcp_asdf_frame_t frame;
    mcp_asdf_estimate_t estimate;
    while (radio_next_frame(&frame)) {
        if (mcp_asdf_decode_estimate(&estimate, estimate_format.subject, &frame) == MCP_ASDF_FRAME_OK) {
            mcp_asdf_receive(&robot, estimate.node, estimate.x_hat, estimate.alpha);
        }
    }
}

/* Send x_hat and alpha to the neighbours. */
static void broadcast(void)
{
    static uint8_t transfer_id; /* the number of earlier estimates, modulo 256 */
    mcp_asdf_frame_t frame;
    const mcp_asdf_estimate_t estimate = {.node = DEMO_ID,
                                          .transfer_id = transfer_id,
                                          .x_hat = mcp_asdf_x_hat(&robot),
                                          .alpha = mcp_asdf_alpha(&robot)};
    ++transfer_id;
    if (mcp_asdf_encode_estimate(&frame, &estimate_format, &estimate) == MCP_ASDF_FRAME_OK) {
        radio_send(&frame);
    }
}

/* Send a heartbeat, with the seconds since the start, and the number of lost packets as its vendor status. */
static void send_heartbeat(uint32_t seconds, uint8_t transfer_id)
{
    const uint8_t health =
        mcp_asdf_invariants_hold(&robot) ? MCP_ASDF_HEALTH_NOMINAL : MCP_ASDF_HEALTH_WARNING;
    const mcp_asdf_heartbeat_t heartbeat = {.node = DEMO_ID,
                                            .transfer_id = transfer_id,
                                            .health = health,
                                            .mode = MCP_ASDF_MODE_OPERATIONAL,
                                            .vendor_status = radio_lost_packets(),
                                            .uptime = seconds};
    mcp_asdf_frame_t frame;
    if (mcp_asdf_encode_heartbeat(&frame, estimate_format.priority, &heartbeat) == MCP_ASDF_FRAME_OK) {
        radio_send(&frame);
    }
}

/* Send x, b_hat and the number of updates, modulo 256, for observers. */
static void send_telemetry(uint8_t transfer_id)
{
    const mcp_asdf_telemetry_t telemetry = {.node = DEMO_ID,
                                            .transfer_id = transfer_id,
                                            .updates = (uint8_t)mcp_asdf_counters(&robot).updates,
                                            .x = mcp_asdf_x(&robot),
                                            .b_hat = mcp_asdf_b_hat(&robot) >> 8}; /* Q32 to Q24 */
    mcp_asdf_frame_t frame;
    if (mcp_asdf_encode_telemetry(&frame, &telemetry_format, &telemetry) == MCP_ASDF_FRAME_OK) {
        radio_send(&frame);
    }
}

/* Send a heartbeat and telemetry. Called once a second. */
static void report(void)
{
    static uint32_t seconds;                      /* since the start, and so the number of reports */
    const uint8_t transfer_id = (uint8_t)seconds; /* the number of earlier reports, modulo 256 */
    ++seconds;
    send_heartbeat(seconds, transfer_id);
    send_telemetry(transfer_id);
}

/* Run a control tick: pass the colour of the tile to the firmware, if the sensor recognises it, send the
 * robot's estimate, receive those of its neighbours, and close the round. Reports once a second. */
static void tick(void)
{
    static uint8_t ticks; /* since the last report */
    mcp_asdf_observation_t tile;
    if (board_read_tile(&tile)) {
        mcp_asdf_observe(&robot, tile);
    }
    broadcast();
    receive();
    mcp_asdf_settle(&robot);
    ++ticks;
    if (ticks == TICKS_PER_SECOND) {
        ticks = 0;
        report();
    }
}

/* Run the robot for ever. Ends the program, with status 1, only if the firmware refuses its configuration. */
int main(void)
{
    if (mcp_asdf_init(&robot, &config, DEMO_ID, B_HAT) != MCP_ASDF_OK) {
        port_exit(1);
    }
    board_start();
    for (;;) {
        receive();
        if (board_has_tick_begun()) {
            tick();
        }
    }
}
