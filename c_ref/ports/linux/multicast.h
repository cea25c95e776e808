/* A multicast group of IPv4 or IPv6 that robots without CAN share like a bus, each frame in a datagram as
 * python-can's udp_multicast packs it: a msgpack map from the names of a message's fields to their values. */
#ifndef MCP_ASDF_LINUX_MULTICAST_H
#define MCP_ASDF_LINUX_MULTICAST_H

#include <linux/can.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/socket.h>

/* Size of the longest datagram that is read; a longer one is refused. python-can's have 164 bytes, and the
 * name of a channel. mcp_asdf_tools/bus/datagrams.py has the same limit. */
#define MULTICAST_SIZE 400

/*   network    interface that leads to the group, such as wlan0; NULL: the one of the kernel's route
 *   hops       networks that a datagram may cross; 0: it stays in this computer, 1: in its network
 *   in, out    sockets to hear and to send on; -1 while there is none
 *   own        where this node's datagrams come from; the kernel hands them back with the others' */
typedef struct {
    const char *network;
    int hops, in, out;
    struct sockaddr_storage own;
} multicast_t;

/* Join the group `name`: "239.74.163.2:43113" or "[ff15::6173]:43113". Returns 0, or what went wrong as an
 * errno, EINVAL for a name that is none of these; then there are no sockets. */
int multicast_open(multicast_t *group, const char *name);

void multicast_close(multicast_t *group);

/* Pack a data frame with a 29-bit id of 2^16 or more, sent `time` seconds after 1970. Returns the size, at
 * most 164. */
size_t multicast_pack(uint8_t datagram[MULTICAST_SIZE], const struct can_frame *frame, double time);

/* Read a datagram; returns whether it is one classic data frame as python-can writes it, field by field in
 * its order, and nothing else. If not, *frame is of no use. mcp_asdf_tools/bus/datagrams.py accepts and
 * refuses the same datagrams. */
bool multicast_unpack(struct canfd_frame *frame, const uint8_t *datagram, size_t size);

#endif
