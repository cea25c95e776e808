/* Frames to and from a bus; bus.h is the manual. */
#include "bus.h"

#include <errno.h>
#include <linux/can.h>
#include <linux/can/error.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

#define UNIX_PREFIX "unix:"
#define ERRORS_HEARD                                                                                         \
    (CAN_ERR_TX_TIMEOUT | CAN_ERR_CRTL | CAN_ERR_BUSOFF | CAN_ERR_BUSERROR | CAN_ERR_RESTARTED)
#define PASSIVE (CAN_ERR_CRTL_RX_PASSIVE | CAN_ERR_CRTL_TX_PASSIVE)
#define WARNING (CAN_ERR_CRTL_RX_WARNING | CAN_ERR_CRTL_TX_WARNING)

/* ---- Joining ---------------------------------------------------------------------------------------- */

/* Ask the kernel for nothing but frames that this node needs, reports of errors, and counts of lost frames.
 * What is refused (user-mode emulation knows none of these) costs wake-ups or counts, but no correctness. */
static void set_options(bus_t *bus)
{
    struct can_filter filters[2];
    const can_err_mask_t errors = ERRORS_HEARD;
    const int on = 1;
    for (int i = 0; i < 2; ++i) {
        filters[i].can_id = MCP_ASDF_FRAME_FILTER(bus->subjects[i]) | CAN_EFF_FLAG;
        filters[i].can_mask = MCP_ASDF_FRAME_MASK | CAN_EFF_FLAG | CAN_RTR_FLAG;
    }
    bus->is_filtered = setsockopt(bus->fd, SOL_CAN_RAW, CAN_RAW_FILTER, filters, sizeof filters) == 0;
    (void)setsockopt(bus->fd, SOL_CAN_RAW, CAN_RAW_ERR_FILTER, &errors, sizeof errors);
    (void)setsockopt(bus->fd, SOL_SOCKET, SO_RXQ_OVFL, &on, sizeof on);
    if (bus->receive_buffer != 0) {
        const int size = bus->receive_buffer / 2; /* the kernel doubles it */
        (void)setsockopt(bus->fd, SOL_SOCKET, SO_RCVBUF, &size, sizeof size);
    }
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
    set_options(bus);
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

int bus_open(bus_t *bus)
{
    const bool is_unix = strncmp(bus->name, UNIX_PREFIX, strlen(UNIX_PREFIX)) == 0;
    bus->fd = -1;
    bus->health = MCP_ASDF_HEALTH_NOMINAL;
    bus->overflowed_before = bus->counts.overflowed;
    const int error = is_unix ? join_unix(bus) : join_can(bus);
    if (error != 0) {
        bus_close(bus);
    }
    return error;
}

void bus_close(bus_t *bus)
{
    if (bus->fd >= 0) {
        (void)close(bus->fd);
        bus->fd = -1;
    }
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

static bus_event_t note_failure(bus_t *bus)
{
    const int error = errno;
    if (error == ENETDOWN || error == ENODEV) {
        bus->counts.downs += !bus->is_down; /* an interface that vanishes goes down first */
        bus->is_down = true;
    }
    if (error == ENODEV) {
        bus_close(bus);
    }
    return error == ECONNRESET ? BUS_CLOSED : BUS_NOTHING;
}

bus_event_t bus_receive(bus_t *bus, mcp_asdf_frame_t *frame)
{
    struct canfd_frame raw = {0};
    union {
        struct cmsghdr align;
        char bytes[CMSG_SPACE(sizeof(uint32_t))];
    } control;
    struct iovec part = {.iov_base = &raw, .iov_len = sizeof raw};
    struct msghdr message = {.msg_iov = &part,
                             .msg_iovlen = 1,
                             .msg_control = control.bytes,
                             .msg_controllen = sizeof control.bytes};
    const ssize_t size = recvmsg(bus->fd, &message, MSG_DONTWAIT);
    if (size <= 0) {
        return size == 0 ? BUS_CLOSED : note_failure(bus);
    }
    ++bus->counts.received;
    bus->is_down = false;
    note_overflow(bus, &message);
    if (size != CAN_MTU && size != CANFD_MTU) {
        ++bus->counts.odd_packets;
        return BUS_OTHER;
    }
    if ((raw.can_id & CAN_ERR_FLAG) != 0) {
        note_error_frame(bus, &raw);
        return BUS_OTHER;
    }
    copy_in(frame, &raw, size == CANFD_MTU);
    return BUS_FRAME;
}

/* ---- Sending ---------------------------------------------------------------------------------------- */

bool bus_send(void *context, const mcp_asdf_frame_t *frame)
{
    bus_t *bus = context;
    const struct timespec pause = {.tv_nsec = 1000000};
    struct can_frame raw = {.can_id = frame->id | CAN_EFF_FLAG, .can_dlc = frame->length};
    memcpy(raw.data, frame->data, sizeof raw.data);
    for (int wait = 0; bus->fd >= 0; ++wait) {
        const ssize_t size = send(bus->fd, &raw, sizeof raw, MSG_DONTWAIT | MSG_NOSIGNAL);
        if (size >= 0) { /* frames go whole or not at all */
            bus->is_down = false;
            return true;
        }
        if ((errno != ENOBUFS && errno != EAGAIN) || wait == BUS_PATIENCE_MS) {
            return false;
        }
        ++bus->counts.queue_full;
        (void)nanosleep(&pause, NULL);
    }
    return false;
}
