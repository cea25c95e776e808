/* The Linux node where no test can bring it from outside: a CAN socket that is refused things, and the clock.
 * The linker puts the functions here in place of the system's (--wrap). */
#define main node_main
#include "linux/main.c"
#undef main

#include "../c_ref/check.h"

#include <linux/can.h>
#include <linux/can/error.h>
#include <linux/can/raw.h>
#include <sys/socket.h>

enum { SOCKET_FD = 70 };

static int calls, failing; /* the `failing`-th of them */

static bool fails(int error)
{
    errno = error;
    return ++calls == failing;
}

/* ---- A CAN socket -------------------------------------------------------------------------------------- */

static struct can_filter filters[2];
static can_err_mask_t heard_errors;
static bool is_bound;

unsigned __wrap_if_nametoindex(const char *name) { return fails(ENODEV) ? 0 : 1 + (name[0] == 'c'); }

int __wrap_socket(int domain, int type, int protocol)
{
    CHECK(domain == AF_CAN && (type & SOCK_NONBLOCK) != 0 && protocol == CAN_RAW);
    return fails(EPERM) ? -1 : SOCKET_FD;
}

int __wrap_setsockopt(int fd, int level, int name, const void *value, socklen_t size)
{
    CHECK(fd == SOCKET_FD && !is_bound); /* nothing slips in before */
    if (level == SOL_CAN_RAW && name == CAN_RAW_FILTER) {
        memcpy(filters, value, size < sizeof filters ? size : sizeof filters);
    } else if (level == SOL_CAN_RAW && name == CAN_RAW_ERR_FILTER) {
        memcpy(&heard_errors, value, sizeof heard_errors);
    }
    return fails(EPERM) ? -1 : 0;
}

int __wrap_bind(int fd, const struct sockaddr *address, socklen_t size)
{
    CHECK(fd == SOCKET_FD && address->sa_family == AF_CAN && size == sizeof(struct sockaddr_can));
    is_bound = true;
    return fails(ENETDOWN) ? -1 : 0;
}

static bool hears(canid_t id)
{
    bool is_heard = false;
    for (int i = 0; i < 2; ++i) {
        is_heard |= (id & filters[i].can_mask) == (filters[i].can_id & filters[i].can_mask);
    }
    return is_heard;
}

static void a_bus_asks_for_what_it_needs_and_nothing_else(void)
{
    static const int needed[8] = {0, ENODEV, EPERM, 0, 0, 0, 0, ENETDOWN};
    const canid_t own = MCP_ASDF_FRAME_FILTER(3002) | CAN_EFF_FLAG | 5;
    const canid_t other = MCP_ASDF_FRAME_FILTER(3001) | CAN_EFF_FLAG;
    for (failing = 0; failing < 8; ++failing) {
        bus_t bus = {.name = "can7", .subjects = {3000, 3002}, .receive_buffer = 4096};
        calls = 0;
        is_bound = false;
        GIVEN(failing, 0, 0);
        CHECK_EQUAL(bus_open(&bus), needed[failing]);
        CHECK_EQUAL(bus.fd, needed[failing] == 0 ? SOCKET_FD : -1);
        CHECK(needed[failing] != 0 || bus.is_filtered == (failing != 3));
    }
    CHECK(hears(own) && !hears(own ^ CAN_EFF_FLAG) && !hears(own | CAN_RTR_FLAG) && !hears(other));
    CHECK_EQUAL(heard_errors,
                CAN_ERR_TX_TIMEOUT | CAN_ERR_CRTL | CAN_ERR_BUSOFF | CAN_ERR_BUSERROR | CAN_ERR_RESTARTED);
}

/* ---- The clock: every due time is either a tick or counted as skipped, once ---------------------------- */

static void a_clock_counts_what_it_leaves_out(void)
{
    periodic_timer_t clock = {.period = 1000, .next_expiry = 5000};
    uint64_t ticks = 0;
    int64_t worst = 0;
    for (int64_t now = 4000; now < 4000000; now += check_random_word() % 4096) {
        const int64_t late = now - clock.next_expiry;
        const bool is_tick = has_expired(&clock, now);
        ticks += is_tick;
        worst = is_tick && late > worst ? late : worst;
        GIVEN(now, ticks, clock.skipped);
        CHECK_EQUAL(is_tick, late >= 0);
        CHECK_EQUAL(ticks + clock.skipped, now < 5000 ? 0 : (now - 5000) / 1000 + 1);
        CHECK(clock.next_expiry > now && clock.next_expiry % 1000 == 0);
        CHECK_EQUAL(clock.worst_lateness, worst);
    }
}

int main(void)
{
    a_bus_asks_for_what_it_needs_and_nothing_else();
    a_clock_counts_what_it_leaves_out();
    return check_report();
}
