/* A bus by multicast; multicast.h is the manual. */
#include "multicast.h"

#include <arpa/inet.h>
#include <errno.h>
#include <net/if.h>
#include <netinet/in.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* ---- Joining ---------------------------------------------------------------------------------------- */

/* An address of either family. */
typedef union {
    struct sockaddr any;
    struct sockaddr_in four;
    struct sockaddr_in6 six;
    struct sockaddr_storage storage;
} address_t;

static bool read_name(address_t *address, const char *name)
{
    char host[INET6_ADDRSTRLEN] = {0}, *end = NULL;
    const bool is_six = name[0] == '[';
    const char *const first = name + is_six, *const after = strstr(first, is_six ? "]:" : ":");
    if (after == NULL || (size_t)(after - first) >= sizeof host) {
        return false;
    }
    memcpy(host, first, (size_t)(after - first));
    const unsigned long port = strtoul(after + 1 + is_six, &end, 10); /* "-1" is too large */
    memset(address, 0, sizeof *address);
    address->six.sin6_family = is_six ? AF_INET6 : AF_INET;
    address->six.sin6_port = htons((uint16_t)port); /* where IPv4 has it, too */
    return *end == '\0' && port != 0 && port <= UINT16_MAX &&
           (is_six ? inet_pton(AF_INET6, host, &address->six.sin6_addr) == 1 &&
                         IN6_IS_ADDR_MULTICAST(&address->six.sin6_addr)
                   : inet_pton(AF_INET, host, &address->four.sin_addr) == 1 &&
                         IN_MULTICAST(ntohl(address->four.sin_addr.s_addr)));
}

static socklen_t size_of(const address_t *address)
{
    return address->any.sa_family == AF_INET6 ? sizeof address->six : sizeof address->four;
}

/* Bound to the group's own address, so that no other group's datagrams come with them. */
static bool listen_to(int fd, const address_t *address, unsigned index)
{
    const struct ipv6_mreq six = {.ipv6mr_multiaddr = address->six.sin6_addr, .ipv6mr_interface = index};
    const struct ip_mreqn four = {.imr_multiaddr = address->four.sin_addr, .imr_ifindex = (int)index};
    const int on = 1;
    if (setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on) != 0 ||
        bind(fd, &address->any, size_of(address)) != 0) {
        return false;
    }
    return (address->any.sa_family == AF_INET6
                ? setsockopt(fd, IPPROTO_IPV6, IPV6_JOIN_GROUP, &six, sizeof six)
                : setsockopt(fd, IPPROTO_IP, IP_ADD_MEMBERSHIP, &four, sizeof four)) == 0;
}

/* Connected, so that the kernel settles where datagrams come from. */
static bool speak_to(int fd, const address_t *address, unsigned index, int hops)
{
    const struct ip_mreqn four = {.imr_ifindex = (int)index};
    const bool is_six = address->any.sa_family == AF_INET6;
    if (index != 0 && (is_six ? setsockopt(fd, IPPROTO_IPV6, IPV6_MULTICAST_IF, &index, sizeof index)
                              : setsockopt(fd, IPPROTO_IP, IP_MULTICAST_IF, &four, sizeof four)) != 0) {
        return false;
    }
    return (is_six ? setsockopt(fd, IPPROTO_IPV6, IPV6_MULTICAST_HOPS, &hops, sizeof hops)
                   : setsockopt(fd, IPPROTO_IP, IP_MULTICAST_TTL, &hops, sizeof hops)) == 0 &&
           connect(fd, &address->any, size_of(address)) == 0;
}

int multicast_open(multicast_t *group, const char *name)
{
    address_t address;
    socklen_t size = sizeof group->own;
    const unsigned index = group->network != NULL ? if_nametoindex(group->network) : 0;
    group->in = group->out = -1;
    if (!read_name(&address, name)) {
        return EINVAL;
    }
    if (group->network != NULL && index == 0) {
        return ENODEV;
    }
    group->in = socket(address.any.sa_family, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    group->out = socket(address.any.sa_family, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    memset(&group->own, 0, sizeof group->own);
    if (group->in < 0 || group->out < 0 || !listen_to(group->in, &address, index) ||
        !speak_to(group->out, &address, index, group->hops) ||
        getsockname(group->out, (struct sockaddr *)&group->own, &size) != 0) {
        const int error = errno;
        multicast_close(group);
        return error;
    }
    return 0;
}

void multicast_close(multicast_t *group)
{
    if (group->in >= 0) {
        (void)close(group->in);
    }
    if (group->out >= 0) {
        (void)close(group->out);
    }
    group->in = group->out = -1;
}

/* ---- Datagrams: what python-can writes, in its order ------------------------------------------------- */

#define TIME "\x8B\xA9timestamp"
#define ID                                                                                                   \
    "\xAE"                                                                                                   \
    "arbitration_id"
#define EXTENDED "\xAEis_extended_id"
#define KIND                                                                                                 \
    "\xAFis_remote_frame\xC2\xAEis_error_frame\xC2\xA7"                                                      \
    "channel"
#define LENGTH                                                                                               \
    "\xA3"                                                                                                   \
    "dlc"
#define DATA                                                                                                 \
    "\xA4"                                                                                                   \
    "data\xC4"
#define CLASSIC                                                                                              \
    "\xA5is_fd\xC2\xAE"                                                                                      \
    "bitrate_switch\xC2\xB5"                                                                                 \
    "error_state_indicator\xC2"

static uint8_t *put(uint8_t *to, const void *bytes, size_t size)
{
    memcpy(to, bytes, size);
    return to + size;
}

static uint8_t *put_number(uint8_t *to, uint64_t number, int bytes)
{
    for (int i = bytes - 1; i >= 0; --i) {
        *to++ = (uint8_t)(number >> 8 * i);
    }
    return to;
}

size_t multicast_pack(uint8_t datagram[MULTICAST_SIZE], const struct can_frame *frame, double time)
{
    const uint8_t length = frame->can_dlc <= CAN_MAX_DLEN ? frame->can_dlc : CAN_MAX_DLEN;
    uint64_t bits;
    memcpy(&bits, &time, sizeof bits);
    uint8_t *to = put(datagram, TIME "\xCB", sizeof TIME);
    to = put(put_number(to, bits, 8), ID "\xCE", sizeof ID);
    to = put_number(to, frame->can_id & CAN_EFF_MASK, 4);
    to = put(to, EXTENDED "\xC3" KIND "\xC0" LENGTH, sizeof(EXTENDED KIND LENGTH) + 1);
    *to++ = length;
    to = put(to, DATA, sizeof DATA - 1);
    *to++ = length;
    to = put(put(to, frame->data, length), CLASSIC, sizeof CLASSIC - 1);
    return (size_t)(to - datagram);
}

typedef struct {
    const uint8_t *at;
    size_t left;
} reader_t;

static bool skip(reader_t *in, uint64_t size)
{
    if (in->left < size) {
        return false;
    }
    in->at += size;
    in->left -= (size_t)size;
    return true;
}

static bool skip_text(reader_t *in, const char *text)
{
    const uint8_t *const at = in->at;
    return skip(in, strlen(text)) && memcmp(at, text, strlen(text)) == 0;
}

/* A whole number, in 1 byte or up to 5. */
static bool take_number(reader_t *in, uint32_t *number)
{
    const uint8_t *at = in->at;
    if (!skip(in, 1)) {
        return false;
    }
    *number = *at;
    if (*at < 0x80) {
        return true;
    }
    size_t size = (size_t)1 << (*at & 3);
    if (*at < 0xCC || *at > 0xCE || !skip(in, size)) {
        return false;
    }
    for (*number = 0; size > 0; --size) {
        *number = *number << 8 | *++at;
    }
    return true;
}

/* A time or the name of a channel: nil, a number or a text. */
static bool skip_value(reader_t *in)
{
    const uint8_t first = in->left > 0 ? *in->at : 0xC1; /* one that msgpack never uses */
    if ((first & 0xE0) == 0xA0) {
        return skip(in, 1 + (first & 0x1FU));
    }
    if (first == 0xCA || first == 0xCB) {
        return skip(in, first == 0xCA ? 5 : 9);
    }
    if (first == 0xD9) {
        return in->left > 1 && skip(in, 2U + in->at[1]);
    }
    uint32_t number;
    return first == 0xC0 ? skip(in, 1) : take_number(in, &number);
}

bool multicast_unpack(struct canfd_frame *frame, const uint8_t *datagram, size_t size)
{
    reader_t in = {datagram, size};
    uint32_t id, length;
    if (size > MULTICAST_SIZE) {
        return false;
    }
    if (!skip_text(&in, TIME) || !skip_value(&in) || !skip_text(&in, ID) || !take_number(&in, &id) ||
        !skip_text(&in, EXTENDED) || !skip(&in, 1)) {
        return false;
    }
    const uint8_t extended = in.at[-1];
    if (!skip_text(&in, KIND) || !skip_value(&in) || !skip_text(&in, LENGTH) || !take_number(&in, &length) ||
        !skip_text(&in, DATA) || !skip(&in, 1)) {
        return false;
    }
    const uint8_t bytes = in.at[-1];
    if ((extended & 0xFE) != 0xC2 || id > (extended == 0xC3 ? CAN_EFF_MASK : CAN_SFF_MASK) ||
        length != bytes || length > CAN_MAX_DLEN || !skip(&in, length) || !skip_text(&in, CLASSIC) ||
        in.left != 0) {
        return false;
    }
    *frame = (struct canfd_frame){.can_id = id | (extended == 0xC3 ? CAN_EFF_FLAG : 0), .len = bytes};
    memcpy(frame->data, in.at - (sizeof CLASSIC - 1) - length, length);
    return true;
}
