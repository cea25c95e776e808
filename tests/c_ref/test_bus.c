/* The Linux node's bus: one packet a call, whatever it is, so that no flood keeps the node from its tick. */
#include "linux/bus.h"

#include "check.h"

#include <linux/can.h>
#include <linux/can/error.h>
#include <sys/socket.h>
#include <unistd.h>

static void check_that_a_call_takes_one_packet(void)
{
    int ends[2];
    mcp_asdf_frame_t frame;
    const char packet[20] = {0};
    bus_t bus = {.name = "test"};
    CHECK(socketpair(AF_UNIX, SOCK_SEQPACKET, 0, ends) == 0);
    bus.fd = ends[0];
    for (int i = 0; i < 5; ++i) {
        CHECK(send(ends[1], packet, sizeof packet, 0) == (ssize_t)sizeof packet);
    }
    for (uint32_t taken = 1; taken <= 5; ++taken) {
        CHECK(bus_receive(&bus, &frame) == BUS_OTHER);
        CHECK(bus.counts.received == taken && bus.counts.odd_packets == taken);
    }
    const struct can_frame error = {.can_id = CAN_ERR_FLAG | CAN_ERR_BUSOFF, .can_dlc = CAN_ERR_DLC};
    for (int i = 0; i < 3; ++i) {
        CHECK(send(ends[1], &error, sizeof error, 0) == (ssize_t)sizeof error);
    }
    for (uint32_t taken = 1; taken <= 3; ++taken) {
        CHECK(bus_receive(&bus, &frame) == BUS_OTHER);
        CHECK(bus.counts.received == 5 + taken && bus.counts.error_frames == taken);
    }
    CHECK(bus_receive(&bus, &frame) == BUS_NOTHING);
    (void)close(ends[1]);
    CHECK(bus_receive(&bus, &frame) == BUS_CLOSED);
    (void)close(ends[0]);
}

int main(void)
{
    check_that_a_call_takes_one_packet();
    return check_report();
}
