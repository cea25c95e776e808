/* Cases of the Linux node that no test can cause from outside: a kernel that refuses calls on a CAN socket,
 * and a timer that is late. The linker puts the functions below in place of the system's (--wrap). */
#define main node_main
#include "linux/main.c"
#undef main

#include "../c_ref/check.h"

#include <linux/can.h>
#include <linux/can/error.h>
#include <linux/can/raw.h>
#include <sys/socket.h>

enum { SOCKET_FD = 70 };

static int call_count;   /* of the functions below, while a bus is opened */
static int failing_call; /* number of the call that fails, from 1 on; 0 if none does */

/* Count a call. Returns whether it has to fail; errno then is `error`. */
static bool fails(int error)
{
    errno = error;
    return ++call_count == failing_call;
}

/* ---- A CAN socket -------------------------------------------------------------------------------------- */

static struct can_filter filters[2];
static can_err_mask_t reported_errors;
static bool is_bound;

unsigned __wrap_if_nametoindex(const char *name) { return fails(ENODEV) ? 0 : 1 + (name[0] == 'c'); }

int __wrap_socket(int domain, int type, int protocol)
{
    CHECK(domain == AF_CAN && (type & SOCK_NONBLOCK) != 0 && protocol == CAN_RAW);
    return fails(EPERM) ? -1 : SOCKET_FD;
}

int __wrap_setsockopt(int fd, int level, int name, const void *value, socklen_t size)
{
    CHECK(fd == SOCKET_FD && !is_bound); /* filters set after bind() would let other frames in */
    if (level == SOL_CAN_RAW && name == CAN_RAW_FILTER) {
        memcpy(filters, value, size < sizeof filters ? size : sizeof filters);
    } else if (level == SOL_CAN_RAW && name == CAN_RAW_ERR_FILTER) {
        memcpy(&reported_errors, value, sizeof reported_errors);
    }
    return fails(EPERM) ? -1 : 0;
}

int __wrap_bind(int fd, const struct sockaddr *address, socklen_t size)
{
    CHECK(fd == SOCKET_FD && address->sa_family == AF_CAN && size == sizeof(struct sockaddr_can));
    is_bound = true;
    return fails(ENETDOWN) ? -1 : 0;
}

/* Whether the kernel, with the filters that the bus has set, delivers a frame with this id. */
static bool is_delivered(canid_t id)
{
    for (int i = 0; i < 2; ++i) {
        if ((id & filters[i].can_mask) == (filters[i].can_id & filters[i].can_mask)) {
            return true;
        }
    }
    return false;
}

static void opening_a_bus_fails_only_without_what_it_needs(void)
{
    /* By the number of the call that fails. Filters, reports of errors and the receive buffer are not needed.
     */
    static const int expected_error[8] = {0, ENODEV, EPERM, 0, 0, 0, 0, ENETDOWN};
    const canid_t own = MCP_ASDF_FRAME_FILTER(3002) | CAN_EFF_FLAG | 5;
    const canid_t other = MCP_ASDF_FRAME_FILTER(3001) | CAN_EFF_FLAG;
    for (failing_call = 0; failing_call < 8; ++failing_call) {
        bus_t bus = {.name = "can7", .subjects = {3000, 3002}, .receive_buffer = 4096};
        call_count = 0;
        is_bound = false;
        GIVEN(failing_call, 0, 0);
        CHECK_EQUAL(bus_open(&bus), expected_error[failing_call]);
        CHECK_EQUAL(bus.fd, expected_error[failing_call] == 0 ? SOCKET_FD : -1);
        CHECK(expected_error[failing_call] != 0 || bus.is_filtered == (failing_call != 3));
    }
    CHECK(is_delivered(own) && !is_delivered(own ^ CAN_EFF_FLAG) && !is_delivered(own | CAN_RTR_FLAG) &&
          !is_delivered(other));
    CHECK_EQUAL(reported_errors,
                CAN_ERR_TX_TIMEOUT | CAN_ERR_CRTL | CAN_ERR_BUSOFF | CAN_ERR_BUSERROR | CAN_ERR_RESTARTED);
}

/* ---- The timer ----------------------------------------------------------------------------------------- */

static void every_expiry_of_a_timer_is_a_tick_or_skipped(void)
{
    periodic_timer_t timer = {.period = 1000, .next_expiry = 5000};
    uint64_t ticks = 0;
    int64_t worst = 0;
    for (int64_t now = 4000; now < 4000000; now += check_random_word() % 4096) {
        const int64_t late = now - timer.next_expiry;
        const bool is_tick = has_expired(&timer, now);
        ticks += is_tick;
        worst = is_tick && late > worst ? late : worst;
        GIVEN(now, ticks, timer.skipped);
        CHECK_EQUAL(is_tick, late >= 0);
        CHECK_EQUAL(ticks + timer.skipped, now < 5000 ? 0 : (now - 5000) / 1000 + 1);
        CHECK(timer.next_expiry > now && timer.next_expiry % 1000 == 0);
        CHECK_EQUAL(timer.worst_lateness, worst);
    }
}

int main(void)
{
    opening_a_bus_fails_only_without_what_it_needs();
    every_expiry_of_a_timer_is_a_tick_or_skipped();
    return check_report();
}
