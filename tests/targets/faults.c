/* The Linux node's input and output when system calls fail, one after the other, and when the power does. The
 * linker puts the functions here in place of the system's (--wrap): a disk in memory that remembers what is
 * on it and what only the kernel has, a stream, and a socket. main.c is included, for its clock. */
#define main node_main
#include "linux/main.c"
#undef main

#include "check.h"

#include <fcntl.h>
#include <linux/can.h>
#include <linux/can/error.h>
#include <linux/can/raw.h>
#include <stdarg.h>
#include <sys/socket.h>
#include <unistd.h>

enum { OLD, DRAFT, FILES, NONE = -1, FOLDER_FD = 50, STREAM_FD = 60, SOCKET_FD = 70 };

typedef struct {
    uint8_t bytes[2 * MCP_ASDF_IMAGE_SIZE];
    size_t size;
} content_t;

/* What a call meets: a failure with this errno at the `at`-th, or a write of less than was asked for. */
static struct {
    int calls, at, error;
    bool is_short;
} fault;

/* Files by number, the state's own being OLD in the beginning; names[] are those of the state and its draft.
 */
static struct {
    content_t cached[FILES], kept[FILES];
    int names[2], kept_names[2];
    int opened;
} disk;
static uint8_t images[2][MCP_ASDF_IMAGE_SIZE];
static bool had_one;

static bool fails(void)
{
    const bool is_now = ++fault.calls == fault.at;
    errno = is_now ? fault.error : errno;
    return is_now;
}

/* ---- A loss of power now: the names and contents that the disk has, and those on their way to it ------- */

static bool is_image(const content_t *file)
{
    return file->size == MCP_ASDF_IMAGE_SIZE && (memcmp(file->bytes, images[0], file->size) == 0 ||
                                                 memcmp(file->bytes, images[1], file->size) == 0);
}

static void check_loss_of_power(void)
{
    const int names[2] = {disk.names[0], disk.kept_names[0]};
    for (int i = 0; i < 2; ++i) {
        if (names[i] == NONE) {
            CHECK(!had_one);
        } else {
            CHECK(is_image(&disk.kept[names[i]]));
            CHECK(is_image(&disk.cached[names[i]]));
        }
    }
}

static int name_of(const char *path)
{
    CHECK(strncmp(path, "/data/state", 11) == 0);
    return strcmp(path + 11, ".new") == 0;
}

int __wrap_open(const char *path, int flags, ...);
int __wrap_open(const char *path, int flags, ...)
{
    if (strcmp(path, "stream") == 0) {
        return STREAM_FD;
    }
    if (fails()) {
        return -1;
    }
    if ((flags & O_DIRECTORY) != 0) {
        CHECK(strcmp(path, "/data") == 0);
        return FOLDER_FD;
    }
    int *name = &disk.names[name_of(path)];
    if (*name == NONE && (flags & O_CREAT) == 0) {
        errno = ENOENT;
        return -1;
    }
    *name = *name == NONE ? DRAFT : *name;
    if ((flags & O_TRUNC) != 0) {
        disk.cached[*name].size = 0;
    }
    disk.opened = *name;
    check_loss_of_power();
    return *name;
}

ssize_t __wrap_write(int fd, const void *data, size_t size);
ssize_t __wrap_write(int fd, const void *data, size_t size)
{
    content_t *file = &disk.cached[fd];
    if (fault.is_short && fault.calls + 1 == fault.at) {
        size /= 2; /* no failure: errno stays */
        ++fault.calls;
    } else if (fails()) {
        return -1;
    }
    CHECK(file->size + size <= sizeof file->bytes);
    memcpy(file->bytes + file->size, data, size);
    file->size += size;
    check_loss_of_power();
    return (ssize_t)size;
}

int __wrap_fsync(int fd);
int __wrap_fsync(int fd)
{
    if (fails()) {
        return -1;
    }
    if (fd == FOLDER_FD) {
        memcpy(disk.kept_names, disk.names, sizeof disk.names);
    } else {
        disk.kept[fd] = disk.cached[fd];
    }
    check_loss_of_power();
    return 0;
}

int __wrap_close(int fd);
int __wrap_close(int fd)
{
    disk.opened = NONE;
    return fd >= STREAM_FD || !fails() ? 0 : -1;
}

int __wrap_rename(const char *from, const char *to);
int __wrap_rename(const char *from, const char *to)
{
    if (fails()) {
        return -1;
    }
    disk.names[name_of(to)] = disk.names[name_of(from)];
    disk.names[name_of(from)] = NONE;
    check_loss_of_power();
    return 0;
}

int __wrap_unlink(const char *path);
int __wrap_unlink(const char *path)
{
    if (fails()) {
        return -1;
    }
    disk.names[name_of(path)] = NONE;
    check_loss_of_power();
    return 0;
}

/* ---- The stream: each second call of poll() or read() is interrupted or told to come again ------------- */

static struct {
    const char *text;
    size_t at;
    int calls, error;
} stream;

int __wrap_poll(struct pollfd *fds, nfds_t count, int timeout);
int __wrap_poll(struct pollfd *fds, nfds_t count, int timeout)
{
    CHECK(fds->fd == STREAM_FD && count == 1 && timeout == 0);
    errno = EINTR;
    return ++stream.calls % 3 == 0 ? -1 : 1;
}

ssize_t __wrap_read(int fd, void *data, size_t size);
ssize_t __wrap_read(int fd, void *data, size_t size)
{
    if (fd == STREAM_FD) {
        if (stream.error != 0 && ++stream.calls % 2 == 0) {
            errno = stream.error;
            return -1;
        }
        *(char *)data = stream.text[stream.at];
        return stream.text[stream.at] == 0 ? 0 : (ssize_t)(++stream.at != 0);
    }
    if (fails()) {
        return -1;
    }
    const content_t *file = &disk.cached[fd];
    size = size < file->size ? size : file->size;
    memcpy(data, file->bytes, size);
    return (ssize_t)size;
}

/* ---- The socket ---------------------------------------------------------------------------------------- */

static struct {
    struct can_filter filters[2];
    can_err_mask_t errors;
    bool is_bound, is_closed;
} can_socket;

unsigned __wrap_if_nametoindex(const char *name);
unsigned __wrap_if_nametoindex(const char *name)
{
    CHECK(strcmp(name, "can7") == 0);
    return fails() ? 0 : 7;
}

int __wrap_socket(int domain, int type, int protocol);
int __wrap_socket(int domain, int type, int protocol)
{
    CHECK(domain == AF_CAN && (type & SOCK_NONBLOCK) != 0 && protocol == CAN_RAW);
    return fails() ? -1 : SOCKET_FD;
}

int __wrap_setsockopt(int fd, int level, int name, const void *value, socklen_t size);
int __wrap_setsockopt(int fd, int level, int name, const void *value, socklen_t size)
{
    CHECK(fd == SOCKET_FD && !can_socket.is_bound); /* nothing slips in before */
    if (fails()) {
        return -1;
    }
    if (level == SOL_CAN_RAW && name == CAN_RAW_FILTER) {
        CHECK_EQUAL(size, sizeof can_socket.filters);
        memcpy(can_socket.filters, value, sizeof can_socket.filters);
    } else if (level == SOL_CAN_RAW && name == CAN_RAW_ERR_FILTER) {
        memcpy(&can_socket.errors, value, sizeof can_socket.errors);
    }
    return 0;
}

int __wrap_bind(int fd, const struct sockaddr *address, socklen_t size);
int __wrap_bind(int fd, const struct sockaddr *address, socklen_t size)
{
    CHECK(fd == SOCKET_FD && address->sa_family == AF_CAN && size == sizeof(struct sockaddr_can));
    can_socket.is_bound = true;
    return fails() ? -1 : 0;
}

/* ---- Tests --------------------------------------------------------------------------------------------- */

static const mcp_asdf_config_t config = {0, 6, 1000, MCP_ASDF_OFF};

static mcp_asdf_t robot_after(uint32_t ticks)
{
    mcp_asdf_t robot;
    CHECK_EQUAL(mcp_asdf_init(&robot, &config, 40, 0xC1000000), MCP_ASDF_OK);
    while (ticks-- > 0) {
        (void)mcp_asdf_step(&robot, ticks % 3 == 0 ? MCP_ASDF_BLACK : MCP_ASDF_WHITE);
    }
    return robot;
}

static void begin(int at, int error, bool is_short)
{
    memset(&disk, 0, sizeof disk);
    memcpy(disk.cached[OLD].bytes, images[0], MCP_ASDF_IMAGE_SIZE);
    disk.cached[OLD].size = MCP_ASDF_IMAGE_SIZE;
    disk.kept[OLD] = disk.cached[OLD];
    disk.names[0] = disk.kept_names[0] = had_one ? OLD : NONE;
    disk.names[1] = disk.kept_names[1] = NONE;
    disk.opened = NONE;
    fault.calls = 0;
    fault.at = at;
    fault.error = error;
    fault.is_short = is_short;
}

/* Returns whether there was an `at`-th call to fail. */
static bool save_with_fault(int at, int error, bool is_short)
{
    const mcp_asdf_t robot = robot_after(38);
    mcp_asdf_t loaded = robot_after(0);
    begin(at, error, is_short);
    const int told = state_save("/data/state", &robot);
    const bool was_met = fault.calls >= at;
    GIVEN(at, error, is_short);
    CHECK(disk.opened == NONE);
    if (told == 0) {
        const int name = disk.kept_names[0]; /* what is said to be saved is on the disk */
        CHECK(name != NONE && memcmp(disk.kept[name].bytes, images[1], MCP_ASDF_IMAGE_SIZE) == 0);
    } else {
        CHECK(was_met && told == (error == 0 ? ENOSPC : error));
    }
    CHECK(disk.names[1] == NONE);
    fault.at = 0;
    CHECK(state_load("/data/state", &loaded, &config) == NULL);
    return was_met;
}

static void a_save_leaves_the_old_state_or_the_new(void)
{
    static const int errors[] = {EIO, ENOSPC, EINTR};
    for (int first = 0; first < 2; ++first) {
        had_one = first == 0;
        CHECK(!save_with_fault(1000, EIO, false));
        CHECK(fault.calls > 6);
        for (size_t i = 0; i < COUNT(errors); ++i) {
            for (int at = 1; save_with_fault(at, errors[i], false); ++at) {
            }
        }
        CHECK(save_with_fault(2, 0, true)); /* the write, which takes half */
    }
}

static void a_load_that_fails_leaves_the_robot(void)
{
    had_one = true;
    for (int at = 1; at < 4; ++at) {
        mcp_asdf_t robot = robot_after(3);
        begin(at, EIO, false);
        const char *why = state_load("/data/state", &robot, &config);
        CHECK((why != NULL) == (at < 3)); /* the third closes what was read */
        CHECK_EQUAL(mcp_asdf_t_count(&robot), why == NULL ? 5 : 3);
        CHECK(disk.opened == NONE);
    }
}

static void an_interrupted_stream_goes_on(void)
{
    static const int errors[] = {0, EINTR, EAGAIN, EIO};
    for (size_t i = 0; i < COUNT(errors); ++i) {
        source_t source = {.path = "stream"};
        mcp_asdf_action_t seen;
        unsigned blacks = 0, ticks = 0;
        memset(&stream, 0, sizeof stream);
        stream.text = "1 01-1 1";
        stream.error = errors[i];
        CHECK_EQUAL(source_open(&source), 0);
        while (!source.has_ended && ++ticks < 1000) {
            blacks += source_next(&source, &seen) && seen == MCP_ASDF_OBSERVE_BLACK;
        }
        GIVEN(errors[i], blacks, ticks);
        CHECK(ticks < 1000 && (errors[i] == EIO ? blacks < 4 : blacks == 4));
    }
}

static bool hears(canid_t id)
{
    bool is_heard = false;
    for (int i = 0; i < 2; ++i) {
        const struct can_filter *each = &can_socket.filters[i];
        is_heard = is_heard || (id & each->can_mask) == (each->can_id & each->can_mask);
    }
    return is_heard;
}

static void a_bus_asks_for_what_it_needs_and_nothing_else(void)
{
    for (int at = 0; at < 8; ++at) {
        bus_t bus = {.name = "can7", .subjects = {3000, 3002}, .receive_buffer = 4096};
        memset(&can_socket, 0, sizeof can_socket);
        begin(at, EPERM, false);
        const bool is_needed = at == 1 || at == 2 || at == 7; /* the name, the socket, bind */
        CHECK_EQUAL(bus_open(&bus), is_needed ? EPERM : 0);
        CHECK_EQUAL(bus.fd, is_needed ? -1 : SOCKET_FD);
        CHECK(is_needed || bus.is_filtered == (at != 3));
        if (at == 0) {
            const canid_t own = MCP_ASDF_FRAME_FILTER(3002) | CAN_EFF_FLAG | 5;
            CHECK(hears(own) && hears((MCP_ASDF_FRAME_FILTER(3000)) | CAN_EFF_FLAG));
            CHECK(!hears(own ^ CAN_EFF_FLAG) && !hears(own | CAN_RTR_FLAG));
            CHECK(!hears((MCP_ASDF_FRAME_FILTER(3001)) | CAN_EFF_FLAG));
            CHECK_EQUAL(can_socket.errors, CAN_ERR_TX_TIMEOUT | CAN_ERR_CRTL | CAN_ERR_BUSOFF |
                                               CAN_ERR_BUSERROR | CAN_ERR_RESTARTED);
        }
    }
}

/* Every due time is either a tick or counted as skipped, once. */
static void a_clock_counts_what_it_leaves_out(void)
{
    ticker_t clock = {.period = 1000, .next = 5000};
    uint64_t ticks = 0;
    int64_t worst = 0;
    for (int64_t now = 4000; now < 40000000; now += check_random_word() % 4096) {
        const int64_t late = now - clock.next;
        const bool is_tick = is_due(&clock, now);
        ticks += is_tick;
        worst = is_tick && late > worst ? late : worst;
        GIVEN(now, ticks, clock.skipped);
        CHECK_EQUAL(is_tick, late >= 0);
        CHECK_EQUAL(ticks + clock.skipped, now < 5000 ? 0 : (now - 5000) / 1000 + 1);
        CHECK(clock.next > now || !is_tick);
        CHECK_EQUAL(clock.next % 1000, 0);
        CHECK_EQUAL(clock.worst, worst);
    }
}

int main(void)
{
    const mcp_asdf_t robots[2] = {robot_after(5), robot_after(38)};
    for (int i = 0; i < 2; ++i) {
        mcp_asdf_save(&robots[i], images[i]);
    }
    a_save_leaves_the_old_state_or_the_new();
    a_load_that_fails_leaves_the_robot();
    an_interrupted_stream_goes_on();
    a_bus_asks_for_what_it_needs_and_nothing_else();
    a_clock_counts_what_it_leaves_out();
    return check_report();
}
