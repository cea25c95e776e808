/* A connection to a bus, of one of three kinds: a SocketCAN interface such as "can0"; "udp:GROUP:PORT", a
 * multicast group for robots without CAN (multicast.h); or "unix:PATH", a stand-in where the kernel has no
 * CAN: a listening Unix socket (SOCK_SEQPACKET) whose owner passes frames on, one struct can_frame a packet.
 *
 * Nothing here blocks except bus_send() while the send queue is full, and that for at most
 * BUS_SEND_TIMEOUT_MS.
 */
#ifndef MCP_ASDF_LINUX_BUS_H
#define MCP_ASDF_LINUX_BUS_H

#include "mcp_asdf_frame.h"
#include "multicast.h"

#include <stdbool.h>

#define BUS_SEND_TIMEOUT_MS 20 /* how long a frame waits for room in the send queue before it is dropped */

/* Number of events on the bus since the start of the program.
 *   received       packets that this program has read, but its own datagrams
 *   overflowed     frames that the kernel dropped because the receive buffer was full
 *   queue_full     waits for room in the send queue
 *   error_frames   reports of the CAN controller, those of bus_off included
 *   bus_off        times the controller left the bus
 *   downs          times the interface went down or vanished; a frame that is received or sent ends the time
 *   odd_packets    packets that are no frame; those of a multicast group that are no classic data frame */
typedef struct {
    uint32_t received, overflowed, queue_full, error_frames, bus_off, downs, odd_packets;
} bus_counts_t;

/* A bus. The caller sets the first three members, and of `group` the network and the hop limit, and 0 for all
 * else; then it calls bus_open().
 *   name                as above
 *   subjects            the two subjects whose frames are received, which may be equal
 *   receive_buffer      bytes that the kernel keeps for this program; 0: its default
 *   fd                  socket on which to wait for frames; -1 while the bus is closed
 *   group               the multicast group, if is_multicast
 *   is_filtered         whether the kernel filters the subjects; the reader must check them in any case
 *   health              what the controller last reported: a mcp_asdf_health_t
 *   is_down             whether the interface has gone down or vanished, and no frame has passed since
 *   overflowed_before   frames that the kernel dropped on earlier sockets of this bus */
typedef struct {
    const char *name;
    uint16_t subjects[2];
    int receive_buffer;
    int fd;
    multicast_t group;
    bool is_multicast, is_filtered;
    uint8_t health;
    bool is_down;
    uint32_t overflowed_before;
    bus_counts_t counts;
} bus_t;

typedef enum {
    BUS_NOTHING, /* no packet was waiting, or the bus failed */
    BUS_FRAME,   /* a frame was read */
    BUS_OTHER,   /* an error frame or a packet that is no frame, which are counted, or an own datagram */
    BUS_CLOSED   /* the owner of the Unix socket has closed it, for good */
} bus_event_t;

/* Open the bus. Returns 0, or an errno; then fd is -1. */
int bus_open(bus_t *bus);

/* Close the bus, if it is open, and set fd to -1. */
void bus_close(bus_t *bus);

/* Read one packet if one is waiting, and write *frame if it is a frame. Returns what was read. If the
 * interface has vanished, the bus is closed; bus_open() may be tried again later. */
bus_event_t bus_receive(bus_t *bus, mcp_asdf_frame_t *frame);

/* Send a frame on the bus that `context` points to, a bus_t. Returns whether the bus accepted it. If a
 * multicast group cannot be reached, the bus is closed; bus_open() may be tried again later. */
bool bus_send(void *context, const mcp_asdf_frame_t *frame);

#endif
