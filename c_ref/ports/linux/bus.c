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
#define ADDRESS_SIZE offsetof(struct sockaddr_in6, sin6_scope_id) /* and all of an IPv4 one */
#define ERRORS_HEARD                                                                                         \
    (CAN_ERR_TX_TIMEOUT | CAN_ERR_CRTL | CAN_ERR_BUSOFF | CAN_ERR_BUSERROR | CAN_ERR_RESTARTED)
#define PASSIVE (CAN_ERR_CRTL_RX_PASSIVE | CAN_ERR_CRTL_TX_PASSIVE)
#define WARNING (CAN_ERR_CRTL_RX_WARNING | CAN_ERR_CRTL_TX_WARNING)

/* ---- Joining ---------------------------------------------------------------------------------------- */

static bool has_prefix(const bus_t *bus, const char *prefix)
{
    return strncmp(bus->name, prefix, strlen(prefix)) == 0;
}

/* Ask the kernel for room, and for counts of what it had none for. Here and below: what is refused (user-mode
 * emulation knows none of it) costs wake-ups or counts, but no correctness. */
static void set_buffer(const bus_t *bus)
{
    const int on = 1, size = bus->receive_buffer / 2; /* the kernel doubles it */
    (void)setsockopt(bus->fd, SOL_SOCKET, SO_RXQ_OVFL, &on, sizeof on);
    if (size != 0) {
        (void)setsockopt(bus->fd, SOL_SOCKET, SO_RCVBUF, &size, sizeof size);
    }
}

/* Ask the kernel for nothing but frames that this node needs, and reports of errors. */
static void set_filters(bus_t *bus)
{
    struct can_filter filters[2];
    const can_err_mask_t errors = ERRORS_HEARD;
    for (int i = 0; i < 2; ++i) {
        filters[i].can_id = MCP_ASDF_FRAME_FILTER(bus->subjects[i]) | CAN_EFF_FLAG;
        filters[i].can_mask = MCP_ASDF_FRAME_MASK | CAN_EFF_FLAG | CAN_RTR_FLAG;
    }
    bus->is_filtered = setsockopt(bus->fd, SOL_CAN_RAW, CAN_RAW_FILTER, filters, sizeof filters) == 0;
    (void)setsockopt(bus->fd, SOL_CAN_RAW, CAN_RAW_ERR_FILTER, &errors, sizeof errors);
}

/* Filters go before bind(), so that nothing else can slip in. */
static int join_can(bus_t *bus)
{
    struct sockaddr_can address = {.can_family = AF_CAN, .can_ifindex = (int)if_nametoindex(bus->name)};
    if (address.can_ifindex == 0) {
        return errno;
    }
    bus->fd = socket(AF_CAN, SOCK_RAW | SOCK_CLOEXEC | SOCK_NONBLOCK, CAN_RAW);
    if (bus->fd < 0) {
        return errno;
    }
    set_filters(bus);
    set_buffer(bus);
    return bind(bus->fd, (const struct sockaddr *)&address, sizeof address) == 0 ? 0 : errno;
}

static int join_unix(bus_t *bus)
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

static int join_multicast(bus_t *bus)
{
    const int error = multicast_open(&bus->group, bus->name + strlen(MULTICAST_PREFIX));
    bus->fd = bus->group.in;
    if (error == 0) {
        set_buffer(bus);
    }
    return error;
}

static int join(bus_t *bus)
{
    if (bus->is_multicast) {
        return join_multicast(bus);
    }
    return has_prefix(bus, UNIX_PREFIX) ? join_unix(bus) : join_can(bus);
}

int bus_open(bus_t *bus)
{
    bus->fd = -1;
    bus->is_multicast = has_prefix(bus, MULTICAST_PREFIX);
    bus->health = MCP_ASDF_HEALTH_NOMINAL;
    bus->overflowed_before = bus->counts.overflowed;
    const int error = join(bus);
    if (error != 0) {
        bus_close(bus);
    }
    return error;
}

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

static uint8_t health_of(uint8_t controller)
{
    if ((controller & PASSIVE) != 0) {
        return MCP_ASDF_HEALTH_CAUTION;
    }
    return (controller & WARNING) != 0 ? MCP_ASDF_HEALTH_ADVISORY : MCP_ASDF_HEALTH_NOMINAL;
}

static void note_error_frame(bus_t *bus, const struct canfd_frame *frame)
{
    ++bus->counts.error_frames;
    if ((frame->can_id & CAN_ERR_BUSOFF) != 0) {
        ++bus->counts.bus_off;
        bus->health = MCP_ASDF_HEALTH_WARNING;
    } else if ((frame->can_id & CAN_ERR_RESTARTED) != 0) {
        bus->health = MCP_ASDF_HEALTH_NOMINAL;
    } else if ((frame->can_id & CAN_ERR_CRTL) != 0) {
        bus->health = health_of(frame->data[1]);
    }
}

/* The kernel tells with a frame how many it had dropped on this socket before. */
static void note_overflow(bus_t *bus, struct msghdr *message)
{
    for (struct cmsghdr *each = CMSG_FIRSTHDR(message); each != NULL; each = CMSG_NXTHDR(message, each)) {
        if (each->cmsg_level == SOL_SOCKET && each->cmsg_type == SO_RXQ_OVFL) {
            uint32_t since_open;
            memcpy(&since_open, CMSG_DATA(each), sizeof since_open);
            bus->counts.overflowed = bus->overflowed_before + since_open;
        }
    }
}

static void copy_in(mcp_asdf_frame_t *to, const struct canfd_frame *from, bool is_fd)
{
    const bool is_extended = (from->can_id & CAN_EFF_FLAG) != 0;
    to->id = from->can_id & (is_extended ? CAN_EFF_MASK : CAN_SFF_MASK);
    to->flags = (uint8_t)((is_extended ? 0 : MCP_ASDF_FRAME_STANDARD) |
                          ((from->can_id & CAN_RTR_FLAG) != 0 ? MCP_ASDF_FRAME_REMOTE : 0) |
                          (is_fd ? MCP_ASDF_FRAME_FD : 0));
    to->length = from->len;
    memcpy(to->data, from->data, sizeof to->data);
}

/* An interface that vanishes goes down first. */
static void note_down(bus_t *bus)
{
    bus->counts.downs += !bus->is_down;
    bus->is_down = true;
}

static bus_event_t note_failure(bus_t *bus)
{
    const int error = errno;
    if (error == ENETDOWN || error == ENODEV) {
        note_down(bus);
    }
    if (error == ENODEV) {
        bus_close(bus);
    }
    return error == ECONNRESET ? BUS_CLOSED : BUS_NOTHING;
}

/* Make a frame of a packet of `size` bytes, 0 for one that is longer than any frame. */
static bus_event_t read_packet(bus_t *bus, mcp_asdf_frame_t *frame, const uint8_t *packet, size_t size)
{
    struct canfd_frame raw = {0};
    const bool is_fd = !bus->is_multicast && size == CANFD_MTU;
    if (bus->is_multicast ? !multicast_unpack(&raw, packet, size) : size != CAN_MTU && !is_fd) {
        ++bus->counts.odd_packets;
        return BUS_OTHER;
    }
    if (!bus->is_multicast) {
        memcpy(&raw, packet, size);
    }
    if ((raw.can_id & CAN_ERR_FLAG) != 0) {
        note_error_frame(bus, &raw);
        return BUS_OTHER;
    }
    copy_in(frame, &raw, is_fd);
    return BUS_FRAME;
}

bus_event_t bus_receive(bus_t *bus, mcp_asdf_frame_t *frame)
{
    uint8_t packet[MULTICAST_SIZE];
    struct sockaddr_storage from = {0};
    union {
        struct cmsghdr align;
        char bytes[CMSG_SPACE(sizeof(uint32_t))];
    } control;
    struct iovec part = {.iov_base = packet, .iov_len = sizeof packet};
    struct msghdr message = {.msg_name = &from,
                             .msg_namelen = sizeof from,
                             .msg_iov = &part,
                             .msg_iovlen = 1,
                             .msg_control = control.bytes,
                             .msg_controllen = sizeof control.bytes};
    const ssize_t size = recvmsg(bus->fd, &message, MSG_DONTWAIT);
    if (size < 0 || (size == 0 && !bus->is_multicast)) { /* a datagram may be empty */
        return size == 0 ? BUS_CLOSED : note_failure(bus);
    }
    if (bus->is_multicast && memcmp(&from, &bus->group.own, ADDRESS_SIZE) == 0) {
        return BUS_OTHER;
    }
    ++bus->counts.received;
    bus->is_down = false;
    note_overflow(bus, &message);
    return read_packet(bus, frame, packet, (message.msg_flags & MSG_TRUNC) != 0 ? 0 : (size_t)size);
}

/* ---- Sending ---------------------------------------------------------------------------------------- */

static ssize_t transmit(const bus_t *bus, const struct can_frame *frame)
{
    uint8_t datagram[MULTICAST_SIZE];
    struct timespec now;
    if (!bus->is_multicast) {
        return send(bus->fd, frame, sizeof *frame, MSG_DONTWAIT | MSG_NOSIGNAL);
    }
    (void)clock_gettime(CLOCK_REALTIME, &now);
    const size_t size = multicast_pack(datagram, frame, (double)now.tv_sec + (double)now.tv_nsec * 1e-9);
    return send(bus->group.out, datagram, size, MSG_DONTWAIT | MSG_NOSIGNAL);
}

/* A group that cannot be reached is left, and joined again when there may be another address. */
static bool give_up(bus_t *bus, bool is_full)
{
    if (bus->is_multicast && !is_full) {
        note_down(bus);
        bus_close(bus);
    }
    return false;
}

bool bus_send(void *context, const mcp_asdf_frame_t *frame)
{
    bus_t *bus = context;
    const struct timespec pause = {.tv_nsec = 1000000};
    struct can_frame raw = {.can_id = frame->id | CAN_EFF_FLAG, .can_dlc = frame->length};
    memcpy(raw.data, frame->data, sizeof raw.data);
    for (int wait = 0; bus->fd >= 0; ++wait) {
        if (transmit(bus, &raw) >= 0) { /* frames go whole or not at all */
            bus->is_down = false;
            return true;
        }
        const bool is_full = errno == ENOBUFS || errno == EAGAIN;
        if (!is_full || wait == BUS_PATIENCE_MS) {
            return give_up(bus, is_full);
        }
        ++bus->counts.queue_full;
        (void)nanosleep(&pause, NULL);
    }
    return false;
}
