/* A connection to a bus: a SocketCAN interface such as "can0"; "udp:GROUP:PORT", a multicast group for robots
 * without CAN (multicast.h); or, as "unix:PATH", a stand-in where the kernel has no CAN: a listening Unix
 * socket (SOCK_SEQPACKET) whose owner passes frames on. Every packet is one struct can_frame there.
 *
 * Nothing here blocks except bus_send() while the bus's queue is full, and that for at most BUS_PATIENCE_MS.
 */
#ifndef MCP_ASDF_LINUX_BUS_H
#define MCP_ASDF_LINUX_BUS_H

#include "mcp_asdf_frame.h"
#include "multicast.h"

#include <stdbool.h>

#define BUS_PATIENCE_MS 20 /* how long a frame waits for room in the queue before it is dropped */

/* Events on the bus; all count from 0.
 *   received       frames that woke this program
 *   overflowed     frames that the kernel dropped because the receive buffer was full
 *   queue_full     waits for room in the send queue
 *   error_frames   reports of the controller, those of bus_off included
 *   bus_off        times the controller left the bus
 *   downs          times the interface went down or away, until a frame came or went again
 *   odd_packets    packets that are no frame, of a group's those that are no classic data frame */
typedef struct {
    uint32_t received, overflowed, queue_full, error_frames, bus_off, downs, odd_packets;
} bus_counts_t;

/*   name            as above
 *   subjects        what to hear: frames of these two subjects, which may be one
 *   receive_buffer  bytes that the kernel keeps for this program; 0: its default
 *   fd              to wait on; -1 while there is no interface
 *   group           the multicast group; its network and hops are the caller's choice
 *   is_multicast    whether the bus is one
 *   is_filtered     whether the kernel filters; the reader must do so in any case
 *   health          what the controller last said: a mcp_asdf_health_t */
typedef struct {
    const char *name;
    uint16_t subjects[2];
    int receive_buffer;
    int fd;
    multicast_t group;
    bool is_multicast, is_filtered;
    uint8_t health;
    bool is_down;
    uint32_t overflowed_before; /* on connections that are closed */
    bus_counts_t counts;
} bus_t;

/* BUS_OTHER: an error frame or a packet that is no frame, which are counted, or this node's own datagram. */
typedef enum { BUS_NOTHING, BUS_FRAME, BUS_OTHER, BUS_CLOSED } bus_event_t;

/* Join the bus `name`. Returns 0, or what went wrong as an errno; then fd is -1. */
int bus_open(bus_t *bus);

void bus_close(bus_t *bus);

/* Take the next packet, one at most, and write *frame if it is a frame. BUS_CLOSED: the owner of the Unix
 * socket has gone, for good. An interface that vanishes, or a group that cannot be reached, closes fd;
 * bus_open() may be tried again later. */
bus_event_t bus_receive(bus_t *bus, mcp_asdf_frame_t *frame);

/* Send a frame; returns whether the bus took it. `context` is a bus_t. */
bool bus_send(void *context, const mcp_asdf_frame_t *frame);

#endif
