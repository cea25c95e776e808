/* A multicast group of IPv4 or IPv6 that robots without CAN share like a bus, each frame in a datagram as
 * python-can's udp_multicast packs it: a msgpack map from the names of a message's fields to their values. */
#ifndef MCP_ASDF_LINUX_MULTICAST_H
#define MCP_ASDF_LINUX_MULTICAST_H

#include <linux/can.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/socket.h>

/* Size in bytes of the longest datagram that is read; a longer one is refused. python-can's have 164 bytes,
 * and the name of a channel. mcp_asdf_tools/bus/datagrams.py has the same limit. */
#define MULTICAST_SIZE 400

/* A multicast group. The caller sets the first two members.
 *   network       name of the interface that leads to the group, such as wlan0; NULL: the kernel's route
 *   hop_limit     number of networks that a datagram may cross; 0: it stays in this computer, 1: in its
 *                 network
 *   receive_fd    socket to receive datagrams; -1 while the group is not joined
 *   send_fd       socket to send datagrams; -1 likewise
 *   own_address   sender of this node's datagrams. The kernel delivers them to the node, too */
typedef struct {
    const char *network;
    int hop_limit, receive_fd, send_fd;
    struct sockaddr_storage own_address;
} multicast_t;

/* Join the group `name`: "239.74.163.2:43113" or "[ff15::6173]:43113". Returns 0, or an errno, which is
 * EINVAL for any other name; then both sockets are -1. */
int multicast_open(multicast_t *group, const char *name);

/* Leave the group: close its sockets, if they are open. */
void multicast_close(multicast_t *group);

/* Pack a data frame with a 29-bit id of 2^16 or more, sent `time` seconds after 1970. Returns the size of the
 * datagram in bytes, at most 164. */
size_t multicast_pack(uint8_t datagram[MULTICAST_SIZE], const struct can_frame *frame, double time);

/* Read a frame from a datagram. Returns whether the datagram is one classic data frame as python-can writes
 * it, field by field in its order, and nothing else. If not, *frame is of no use.
 * mcp_asdf_tools/bus/datagrams.py reads the same frames. */
bool multicast_unpack(struct canfd_frame *frame, const uint8_t *datagram, size_t size);

#endif
