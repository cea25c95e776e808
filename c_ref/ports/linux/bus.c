/* Frames to and from a bus that has been joined; bus.h is the manual. */
#include "bus.h"

#include <errno.h>
#include <linux/can.h>
#include <linux/can/error.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>

#define PASSIVE (CAN_ERR_CRTL_RX_PASSIVE | CAN_ERR_CRTL_TX_PASSIVE)
#define WARNING (CAN_ERR_CRTL_RX_WARNING | CAN_ERR_CRTL_TX_WARNING)

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
