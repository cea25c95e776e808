/* Joining a bus; bus.h is the manual. */
#include "bus.h"

#include <errno.h>
#include <linux/can.h>
#include <linux/can/error.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#define UNIX_PREFIX "unix:"
#define ERRORS_HEARD                                                                                         \
    (CAN_ERR_TX_TIMEOUT | CAN_ERR_CRTL | CAN_ERR_BUSOFF | CAN_ERR_BUSERROR | CAN_ERR_RESTARTED)

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
