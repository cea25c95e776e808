/* Frames to and from a bus; bus.h is the manual. */
#include "bus.h"

#include <errno.h>
#include <linux/can.h>
#include <linux/can/error.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <netinet/in.h>
#include <stddef.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

#define UNIX_PREFIX "unix:"
#define MULTICAST_PREFIX "udp:"
/* Bytes in which addresses of senders are compared: an IPv6 address without its scope, an IPv4 one as a
 * whole. */
#define COMPARED_ADDRESS_SIZE offsetof(struct sockaddr_in6, sin6_scope_id)
/* Errors that the controller reports. */
#define REPORTED_ERRORS                                                                                      \
    (CAN_ERR_TX_TIMEOUT | CAN_ERR_CRTL | CAN_ERR_BUSOFF | CAN_ERR_BUSERROR | CAN_ERR_RESTARTED)
/* States of the controller in a report of CAN_ERR_CRTL. */
#define ERROR_PASSIVE (CAN_ERR_CRTL_RX_PASSIVE | CAN_ERR_CRTL_TX_PASSIVE)
#define ERROR_WARNING (CAN_ERR_CRTL_RX_WARNING | CAN_ERR_CRTL_TX_WARNING)

/* ---- Opening ---------------------------------------------------------------------------------------- */

/* Whether the name of the bus begins with a prefix. */
static bool has_prefix(const bus_t *bus, const char *prefix)
{
    return strncmp(bus->name, prefix, strlen(prefix)) == 0;
}

/* Give the socket a receive buffer of bus->receive_buffer bytes, or if that is 0 leave it as the kernel's
 * default, and ask the kernel to count the frames for which it has no room (read_overflow_count()).
 *
 * Here and in set_filters() a refusal is ignored: without these options the node works, but misses counts or
 * wakes up more often. User-mode emulation of another processor knows none of them. */
static void set_receive_buffer(const bus_t *bus)
{
    const int on = 1;
    const int size = bus->receive_buffer / 2; /* the kernel doubles it */
    (void)setsockopt(bus->fd, SOL_SOCKET, SO_RXQ_OVFL, &on, sizeof on);
    if (size != 0) {
        (void)setsockopt(bus->fd, SOL_SOCKET, SO_RCVBUF, &size, sizeof size);
    }
}

/* Ask the kernel to deliver only frames of the two bus->subjects, and reports of REPORTED_ERRORS. Stores in
 * bus->is_filtered whether it filters: if it refuses, all frames arrive, and the node refuses the others. */
static void set_filters(bus_t *bus)
{
    struct can_filter filters[2];
    const can_err_mask_t errors = REPORTED_ERRORS;
    for (int i = 0; i < 2; ++i) {
        filters[i].can_id = MCP_ASDF_FRAME_FILTER(bus->subjects[i]) | CAN_EFF_FLAG;
        filters[i].can_mask = MCP_ASDF_FRAME_MASK | CAN_EFF_FLAG | CAN_RTR_FLAG;
    }
    bus->is_filtered = setsockopt(bus->fd, SOL_CAN_RAW, CAN_RAW_FILTER, filters, sizeof filters) == 0;
    (void)setsockopt(bus->fd, SOL_CAN_RAW, CAN_RAW_ERR_FILTER, &errors, sizeof errors);
}

/* Open a socket on the CAN interface, bus->fd. Returns 0 or an errno; the socket may then be open, and
 * bus_open() closes it. */
static int open_can(bus_t *bus)
{
    struct sockaddr_can address = {.can_family = AF_CAN, .can_ifindex = (int)if_nametoindex(bus->name)};
    if (address.can_ifindex == 0) {
        return errno;
    }
    bus->fd = socket(AF_CAN, SOCK_RAW | SOCK_CLOEXEC | SOCK_NONBLOCK, CAN_RAW);
    if (bus->fd < 0) {
        return errno;
    }
    /* Filters are set before bind(), so that no other frame can be queued in between. */
    set_filters(bus);
    set_receive_buffer(bus);
    return bind(bus->fd, (const struct sockaddr *)&address, sizeof address) == 0 ? 0 : errno;
}

/* Connect a socket, bus->fd, to the Unix socket of that path. Returns 0 or an errno; the socket may then be
 * open, and bus_open() closes it. */
static int open_unix(bus_t *bus)
{
    const char *path = bus->name + strlen(UNIX_PREFIX);
    struct sockaddr_un address = {.sun_family = AF_UNIX};
    if (strlen(path) >= sizeof address.sun_path) {
        return ENAMETOOLONG;
    }
    memcpy(address.sun_path, path, strlen(path) + 1);
    bus->fd = socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0);
    if (bus->fd < 0) {
        return errno;
    }
    return connect(bus->fd, (const struct sockaddr *)&address, sizeof address) == 0 ? 0 : errno;
}

/* Join the multicast group; bus->fd becomes its socket that receives. Returns 0, or an errno with the group
 * closed. */
static int open_multicast(bus_t *bus)
{
    const int error = multicast_open(&bus->group, bus->name + strlen(MULTICAST_PREFIX));
    bus->fd = bus->group.receive_fd;
    if (error == 0) {
        set_receive_buffer(bus);
    }
    return error;
}

/* Open the socket of the kind that the name asks for, a CAN interface, a Unix socket or a multicast group,
 * and store it in bus->fd. Returns 0 or an errno. */
static int open_socket(bus_t *bus)
{
    if (bus->is_multicast) {
        return open_multicast(bus);
    }
    return has_prefix(bus, UNIX_PREFIX) ? open_unix(bus) : open_can(bus);
}

/* Open the bus anew: its counts go on. Returns 0, or an errno with the bus closed. */
int bus_open(bus_t *bus)
{
    bus->fd = -1;
    bus->is_multicast = has_prefix(bus, MULTICAST_PREFIX);
    bus->health = MCP_ASDF_HEALTH_NOMINAL;
    bus->overflowed_before = bus->counts.overflowed;
    const int error = open_socket(bus);
    if (error != 0) {
        bus_close(bus);
    }
    return error;
}

/* Close the sockets, if there are any. */
void bus_close(bus_t *bus)
{
    if (bus->is_multicast) {
        multicast_close(&bus->group);
    } else if (bus->fd >= 0) {
        (void)close(bus->fd);
    }
    bus->fd = -1;
}

/* ---- Receiving -------------------------------------------------------------------------------------- */

/* Returns the health that corresponds to a controller's state, a set of CAN_ERR_CRTL_... bits: caution if it
 * is error-passive, advisory if it has reached the warning level, and else nominal. */
static uint8_t health_of_controller(uint8_t state)
{
    if ((state & ERROR_PASSIVE) != 0) {
        return MCP_ASDF_HEALTH_CAUTION;
    }
    return (state & ERROR_WARNING) != 0 ? MCP_ASDF_HEALTH_ADVISORY : MCP_ASDF_HEALTH_NOMINAL;
}

/* Count an error frame, and set the health by what it reports: warning if the controller has left the bus,
 * nominal when it has restarted, and else by its state. Without any of these the health stays. */
static void handle_error_frame(bus_t *bus, const struct canfd_frame *frame)
{
    ++bus->counts.error_frames;
    if ((frame->can_id & CAN_ERR_BUSOFF) != 0) {
        ++bus->counts.bus_off;
        bus->health = MCP_ASDF_HEALTH_WARNING;
    } else if ((frame->can_id & CAN_ERR_RESTARTED) != 0) {
        bus->health = MCP_ASDF_HEALTH_NOMINAL;
    } else if ((frame->can_id & CAN_ERR_CRTL) != 0) {
        bus->health = health_of_controller(frame->data[1]); /* where error frames have this state */
    }
}

/* Update counts.overflowed by the control data of a received packet: there the kernel states how many frames
 * it has dropped since this socket was opened, if there are any. Without such data nothing changes. */
static void read_overflow_count(bus_t *bus, struct msghdr *message)
{
    for (struct cmsghdr *header = CMSG_FIRSTHDR(message); header != NULL;
         header = CMSG_NXTHDR(message, header)) {
        if (header->cmsg_level == SOL_SOCKET && header->cmsg_type == SO_RXQ_OVFL) {
            uint32_t dropped_since_open;
            memcpy(&dropped_since_open, CMSG_DATA(header), sizeof dropped_since_open);
            /* bus_open() has kept what earlier sockets had counted. */
            bus->counts.overflowed = bus->overflowed_before + dropped_since_open;
        }
    }
}

/* Convert the kernel's frame `raw` to one of the codec, mcp_asdf_frame.h. The kernel has flags in the upper
 * bits of can_id. Of an FD frame only the first 8 bytes are copied, but `length` is that of all. */
static void convert_frame(mcp_asdf_frame_t *frame, const struct canfd_frame *raw, bool is_fd)
{
    if ((raw->can_id & CAN_EFF_FLAG) != 0) {
        frame->id = raw->can_id & CAN_EFF_MASK;
        frame->flags = 0;
    } else {
        frame->id = raw->can_id & CAN_SFF_MASK;
        frame->flags = MCP_ASDF_FRAME_STANDARD;
    }
    if ((raw->can_id & CAN_RTR_FLAG) != 0) {
        frame->flags |= MCP_ASDF_FRAME_REMOTE;
    }
    if (is_fd) {
        frame->flags |= MCP_ASDF_FRAME_FD;
    }
    frame->length = raw->len;
    memcpy(frame->data, raw->data, sizeof frame->data);
}

/* Mark the interface as down. Counts it once: an interface that vanishes goes down first. */
static void mark_down(bus_t *bus)
{
    if (!bus->is_down) {
        ++bus->counts.downs;
    }
    bus->is_down = true;
}

/* Handle a failure to receive, by errno: mark an interface as down, and close one that has vanished. Returns
 * BUS_CLOSED if the other side has closed a Unix socket. */
static bus_event_t handle_receive_error(bus_t *bus)
{
    const int error = errno;
    if (error == ENETDOWN || error == ENODEV) {
        mark_down(bus);
    }
    if (error == ENODEV) {
        bus_close(bus);
    }
    return error == ECONNRESET ? BUS_CLOSED : BUS_NOTHING;
}

/* Decode a packet of `size` bytes, which is 0 for one that is longer than any frame. Returns BUS_FRAME and
 * writes *frame, or returns BUS_OTHER for error frames and for packets that are no frame. Both are counted.
 */
static bus_event_t decode_packet(bus_t *bus, mcp_asdf_frame_t *frame, const uint8_t *packet, size_t size)
{
    struct canfd_frame raw = {0};
    bool is_frame, is_fd;
    if (bus->is_multicast) {
        is_frame = multicast_unpack(&raw, packet, size);
        is_fd = false; /* datagrams with FD frames are refused */
    } else {           /* a struct canfd_frame, or its beginning, which is a struct can_frame */
        is_fd = size == CANFD_MTU;
        is_frame = is_fd || size == CAN_MTU;
        if (is_frame) {
            memcpy(&raw, packet, size);
        }
    }
    if (!is_frame) {
        ++bus->counts.odd_packets;
        return BUS_OTHER;
    }
    if ((raw.can_id & CAN_ERR_FLAG) != 0) {
        handle_error_frame(bus, &raw);
        return BUS_OTHER;
    }
    convert_frame(frame, &raw, is_fd);
    return BUS_FRAME;
}

/* Whether the sender of a packet is this node itself: a multicast group returns its datagrams. */
static bool is_own_datagram(const bus_t *bus, const struct sockaddr_storage *sender)
{
    return bus->is_multicast && memcmp(sender, &bus->group.own_address, COMPARED_ADDRESS_SIZE) == 0;
}

/* Read one packet without waiting, count it as received, and decode it. Own datagrams, which a multicast
 * group returns, are not counted: they are BUS_OTHER. */
bus_event_t bus_receive(bus_t *bus, mcp_asdf_frame_t *frame)
{
    uint8_t packet[MULTICAST_SIZE];
    struct sockaddr_storage sender = {0};
    union {
        struct cmsghdr alignment; /* not used: `bytes` begin at an address that is right for it */
        char bytes[CMSG_SPACE(sizeof(uint32_t))];
    } control;
    struct iovec packet_buffer = {.iov_base = packet, .iov_len = sizeof packet};
    struct msghdr message = {.msg_name = &sender,
                             .msg_namelen = sizeof sender,
                             .msg_iov = &packet_buffer,
                             .msg_iovlen = 1,
                             .msg_control = control.bytes,
                             .msg_controllen = sizeof control.bytes};
    const ssize_t size = recvmsg(bus->fd, &message, MSG_DONTWAIT);
    if (size < 0) {
        return handle_receive_error(bus);
    }
    if (size == 0 && !bus->is_multicast) { /* the end of a connection; but a datagram may be empty */
        return BUS_CLOSED;
    }
    if (is_own_datagram(bus, &sender)) {
        return BUS_OTHER;
    }
    ++bus->counts.received;
    bus->is_down = false;
    read_overflow_count(bus, &message);
    const bool is_too_long = (message.msg_flags & MSG_TRUNC) != 0;
    return decode_packet(bus, frame, packet, is_too_long ? 0 : (size_t)size);
}

/* ---- Sending ---------------------------------------------------------------------------------------- */

/* Try once to send a frame, without waiting. Returns a negative number, with errno set, if it was not sent.
 */
static ssize_t try_send(const bus_t *bus, const struct can_frame *frame)
{
    uint8_t datagram[MULTICAST_SIZE];
    struct timespec now;
    if (!bus->is_multicast) {
        return send(bus->fd, frame, sizeof *frame, MSG_DONTWAIT | MSG_NOSIGNAL);
    }
    (void)clock_gettime(CLOCK_REALTIME, &now);
    const size_t size = multicast_pack(datagram, frame, (double)now.tv_sec + (double)now.tv_nsec * 1e-9);
    return send(bus->group.send_fd, datagram, size, MSG_DONTWAIT | MSG_NOSIGNAL);
}

/* Close a multicast group that cannot be reached: it is joined again when there may be another address. Other
 * buses stay open. */
static void leave_lost_group(bus_t *bus)
{
    if (bus->is_multicast) {
        mark_down(bus);
        bus_close(bus);
    }
}

/* Send a frame, and return whether it was sent. While the send queue is full, wait a millisecond and try
 * again, until the timeout. Counts each wait in queue_full, and closes a multicast group that cannot be
 * reached. */
bool bus_send(void *context, const mcp_asdf_frame_t *frame)
{
    bus_t *bus = context;
    const struct timespec millisecond = {.tv_nsec = 1000000};
    struct can_frame raw = {.can_id = frame->id | CAN_EFF_FLAG, .can_dlc = frame->length};
    memcpy(raw.data, frame->data, sizeof raw.data);
    for (int waited_ms = 0; bus->fd >= 0; ++waited_ms) {
        if (try_send(bus, &raw) >= 0) { /* a frame is never sent in part */
            bus->is_down = false;
            return true;
        }
        const bool is_queue_full = errno == ENOBUFS || errno == EAGAIN;
        if (!is_queue_full) {
            leave_lost_group(bus);
            return false;
        }
        if (waited_ms == BUS_SEND_TIMEOUT_MS) {
            return false;
        }
        ++bus->counts.queue_full;
        (void)nanosleep(&millisecond, NULL);
    }
    return false;
}
