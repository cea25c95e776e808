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

/* An address of either family, which any.sa_family names. */
typedef union {
    struct sockaddr any;
    struct sockaddr_in ipv4;
    struct sockaddr_in6 ipv6;
    struct sockaddr_storage storage;
} address_t;

/* Read a port, 1 to 65535, from a text that is nothing but its number. Returns false if the text is something
 * else; *port is then of no use. */
static bool parse_port(uint16_t *port, const char *text)
{
    char *end = NULL;
    /* strtoul() reads a negative number as a very large one, which is refused below. */
    const unsigned long value = strtoul(text, &end, 10);
    *port = (uint16_t)value;
    return *end == '\0' && value != 0 && value <= UINT16_MAX;
}

/* Read the numeric address `host` into *address, with a port. Returns whether it is a multicast address of
 * the family; if not, *address is of no use. */
static bool parse_group(address_t *address, bool is_ipv6, const char *host, uint16_t port)
{
    memset(address, 0, sizeof *address);
    if (is_ipv6) {
        struct sockaddr_in6 *const ipv6 = &address->ipv6;
        ipv6->sin6_family = AF_INET6;
        ipv6->sin6_port = htons(port);
        return inet_pton(AF_INET6, host, &ipv6->sin6_addr) == 1 && IN6_IS_ADDR_MULTICAST(&ipv6->sin6_addr);
    }
    struct sockaddr_in *const ipv4 = &address->ipv4;
    ipv4->sin_family = AF_INET;
    ipv4->sin_port = htons(port);
    return inet_pton(AF_INET, host, &ipv4->sin_addr) == 1 && IN_MULTICAST(ntohl(ipv4->sin_addr.s_addr));
}

/* Read the name of a group, GROUP:PORT or [GROUP]:PORT, into *address. Returns whether it is a multicast
 * address with a port from 1 to 65535; if not, *address is of no use. */
static bool parse_group_name(address_t *address, const char *name)
{
    char host[INET6_ADDRSTRLEN] = {0};
    uint16_t port;
    const bool is_ipv6 = name[0] == '[';
    const char *const separator = is_ipv6 ? "]:" : ":"; /* the address is in brackets, as it has colons */
    const char *const host_start = is_ipv6 ? name + 1 : name;
    const char *const host_end = strstr(host_start, separator);
    if (host_end == NULL || (size_t)(host_end - host_start) >= sizeof host) {
        return false;
    }
    memcpy(host, host_start, (size_t)(host_end - host_start));
    return parse_port(&port, host_end + strlen(separator)) && parse_group(address, is_ipv6, host, port);
}

/* Returns the size of an address in bytes, by its family. */
static socklen_t address_size(const address_t *address)
{
    return address->any.sa_family == AF_INET6 ? sizeof address->ipv6 : sizeof address->ipv4;
}

/* Join the group with a socket, through the interface of that index, or if it is 0 through one that the
 * kernel chooses. Returns whether that worked; if not, errno says why. */
static bool join_group(int fd, const address_t *address, unsigned interface_index)
{
    if (address->any.sa_family == AF_INET6) {
        const struct ipv6_mreq request = {.ipv6mr_multiaddr = address->ipv6.sin6_addr,
                                          .ipv6mr_interface = interface_index};
        return setsockopt(fd, IPPROTO_IPV6, IPV6_JOIN_GROUP, &request, sizeof request) == 0;
    }
    const struct ip_mreqn request = {.imr_multiaddr = address->ipv4.sin_addr,
                                     .imr_ifindex = (int)interface_index};
    return setsockopt(fd, IPPROTO_IP, IP_ADD_MEMBERSHIP, &request, sizeof request) == 0;
}

/* Open the socket that receives, group->receive_fd, and join the group through the interface of that index,
 * or if it is 0 through one that the kernel chooses. Returns whether that worked; if not, errno says why, and
 * the socket may be open: the caller closes it. */
static bool open_receiver(multicast_t *group, const address_t *address, unsigned interface_index)
{
    const int on = 1;
    const int fd = socket(address->any.sa_family, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    group->receive_fd = fd;
    /* Other sockets of this machine may be bound to the group's port, too. Bound to the group's own address,
     * this one receives no datagrams of other groups on the same port. */
    const bool is_bound = fd >= 0 && setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on) == 0 &&
                          bind(fd, &address->any, address_size(address)) == 0;
    return is_bound && join_group(fd, address, interface_index);
}

/* Let a socket send its datagrams through the interface of that index, or if it is 0 through one that the
 * kernel chooses. Returns whether that worked; if not, errno says why. */
static bool choose_interface(int fd, bool is_ipv6, unsigned interface_index)
{
    if (interface_index == 0) {
        return true;
    }
    if (is_ipv6) {
        return setsockopt(fd, IPPROTO_IPV6, IPV6_MULTICAST_IF, &interface_index, sizeof interface_index) == 0;
    }
    const struct ip_mreqn interface = {.imr_ifindex = (int)interface_index};
    return setsockopt(fd, IPPROTO_IP, IP_MULTICAST_IF, &interface, sizeof interface) == 0;
}

/* Let the datagrams of a socket cross `hop_limit` networks. Returns whether that worked; if not, errno says
 * why. */
static bool limit_hops(int fd, bool is_ipv6, int hop_limit)
{
    if (is_ipv6) {
        return setsockopt(fd, IPPROTO_IPV6, IPV6_MULTICAST_HOPS, &hop_limit, sizeof hop_limit) == 0;
    }
    return setsockopt(fd, IPPROTO_IP, IP_MULTICAST_TTL, &hop_limit, sizeof hop_limit) == 0;
}

/* Open the socket that sends to the group, group->send_fd, through the interface of that index, or if it is 0
 * through one that the kernel chooses, and store the address of its datagrams in group->own_address. Returns
 * whether that worked; if not, errno says why, and the socket may be open: the caller closes it. */
static bool open_sender(multicast_t *group, const address_t *address, unsigned interface_index)
{
    const bool is_ipv6 = address->any.sa_family == AF_INET6;
    const int fd = socket(address->any.sa_family, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    group->send_fd = fd;
    /* By connect() the kernel chooses the sender's address now, so that own datagrams can be recognised. */
    const bool is_connected = fd >= 0 && choose_interface(fd, is_ipv6, interface_index) &&
                              limit_hops(fd, is_ipv6, group->hop_limit) &&
                              connect(fd, &address->any, address_size(address)) == 0;
    if (!is_connected) {
        return false;
    }
    socklen_t own_address_size = sizeof group->own_address;
    memset(&group->own_address, 0, sizeof group->own_address); /* it is compared byte by byte */
    return getsockname(fd, (struct sockaddr *)&group->own_address, &own_address_size) == 0;
}

/* Open both sockets of the group that `name` names. Returns 0, or an errno with both closed: EINVAL if the
 * name is malformed, ENODEV if there is no interface group->network. */
int multicast_open(multicast_t *group, const char *name)
{
    address_t address;
    /* 0 where no interface is named, which leaves it to the kernel, and where there is none of that name. */
    const unsigned interface_index = group->network != NULL ? if_nametoindex(group->network) : 0;
    group->receive_fd = group->send_fd = -1;
    if (!parse_group_name(&address, name)) {
        return EINVAL;
    }
    if (group->network != NULL && interface_index == 0) {
        return ENODEV;
    }
    if (!open_receiver(group, &address, interface_index) || !open_sender(group, &address, interface_index)) {
        const int error = errno; /* closing may change it */
        multicast_close(group);
        return error;
    }
    return 0;
}

/* Close the sockets that are open. */
void multicast_close(multicast_t *group)
{
    if (group->receive_fd >= 0) {
        (void)close(group->receive_fd);
    }
    if (group->send_fd >= 0) {
        (void)close(group->send_fd);
    }
    group->receive_fd = group->send_fd = -1;
}

/* ---- Datagrams -------------------------------------------------------------------------------------- */

/* A datagram is a msgpack map of 11 fields in python-can's order:
 *
 *     timestamp              seconds, a number of 64 bits
 *     arbitration_id         a number in its shortest form
 *     is_extended_id         true for an id of 29 bits
 *     is_remote_frame        false
 *     is_error_frame         false
 *     channel                nil, or a text
 *     dlc                    number of bytes of data
 *     data                   bytes, after their number
 *     is_fd                  false
 *     bitrate_switch         false
 *     error_state_indicator  false
 *
 * The strings below are what stands before each value that varies: the name of its field, and the fields
 * before it that are always the same. The byte before a name is 0xA0 + its length; it is a string of its own,
 * since a hexadecimal escape would take letters that follow for digits. */
#define NAME(length_byte, name) length_byte name
#define MAP_OF_11 "\x8B"
#define FALSE "\xC2"
#define BEFORE_TIME MAP_OF_11 NAME("\xA9", "timestamp")
#define BEFORE_ID NAME("\xAE", "arbitration_id")
#define BEFORE_EXTENDED NAME("\xAE", "is_extended_id")
#define BEFORE_CHANNEL                                                                                       \
    NAME("\xAF", "is_remote_frame") FALSE NAME("\xAE", "is_error_frame") FALSE NAME("\xA7", "channel")
#define BEFORE_DLC NAME("\xA3", "dlc")
#define BEFORE_DATA NAME("\xA4", "data")
#define AFTER_DATA                                                                                           \
    NAME("\xA5", "is_fd")                                                                                    \
    FALSE NAME("\xAE", "bitrate_switch") FALSE NAME("\xB5", "error_state_indicator") FALSE

/* First bytes of msgpack values. A number below 128 is its own first byte. These are whole values, */
#define MSGPACK_NIL 0xC0
#define MSGPACK_FALSE 0xC2
#define MSGPACK_TRUE 0xC3
/* after these a number follows, big-endian, */
#define MSGPACK_FLOAT64 0xCB
#define MSGPACK_UINT8 0xCC
#define MSGPACK_UINT32 0xCE
/* and after these a byte with the length, then the bytes or the text. */
#define MSGPACK_BYTES8 0xC4
#define MSGPACK_STRING8 0xD9

/* Append bytes to a datagram that ends at `end`. Returns its new end. */
static uint8_t *put_bytes(uint8_t *end, const void *bytes, size_t size)
{
    memcpy(end, bytes, size);
    return end + size;
}

/* Append a text without its terminating zero. Returns the new end. */
static uint8_t *put_text(uint8_t *end, const char *text) { return put_bytes(end, text, strlen(text)); }

/* Append the lowest `byte_count` bytes of a number, big-endian. Returns the new end. */
static uint8_t *put_number(uint8_t *end, uint64_t number, int byte_count)
{
    for (int i = byte_count - 1; i >= 0; --i) {
        *end++ = (uint8_t)(number >> (8 * i));
    }
    return end;
}

/* Pack a data frame with a 29-bit id of 2^16 or more as python-can's udp_multicast does: a msgpack map of the
 * fields above, with `time` in seconds since 1970 and nil as the channel. Returns the size of the datagram.
 */
size_t multicast_pack(uint8_t datagram[MULTICAST_SIZE], const struct can_frame *frame, double time)
{
    const uint8_t data_length = frame->can_dlc <= CAN_MAX_DLEN ? frame->can_dlc : CAN_MAX_DLEN;
    uint64_t time_bits; /* of an IEEE 754 number, which msgpack stores as it is */
    memcpy(&time_bits, &time, sizeof time_bits);
    uint8_t *end = put_text(datagram, BEFORE_TIME);
    *end++ = MSGPACK_FLOAT64;
    end = put_number(end, time_bits, sizeof time_bits);
    end = put_text(end, BEFORE_ID);
    *end++ = MSGPACK_UINT32; /* the shortest form of an id of 2^16 or more */
    end = put_number(end, frame->can_id & CAN_EFF_MASK, sizeof frame->can_id);
    end = put_text(end, BEFORE_EXTENDED);
    *end++ = MSGPACK_TRUE;
    end = put_text(end, BEFORE_CHANNEL);
    *end++ = MSGPACK_NIL;
    end = put_text(end, BEFORE_DLC);
    *end++ = data_length; /* as a number below 128 */
    end = put_text(end, BEFORE_DATA);
    *end++ = MSGPACK_BYTES8;
    *end++ = data_length;
    end = put_bytes(end, frame->data, data_length);
    end = put_text(end, AFTER_DATA);
    return (size_t)(end - datagram);
}

/* The rest of a datagram that is being read. */
typedef struct {
    const uint8_t *next;
    size_t bytes_left;
} reader_t;

/* Skip `size` bytes. Returns false, and skips none, if fewer are left. */
static bool skip(reader_t *reader, uint64_t size)
{
    if (reader->bytes_left < size) {
        return false;
    }
    reader->next += size;
    reader->bytes_left -= (size_t)size;
    return true;
}

/* Read one byte into *byte. Returns false, and leaves *byte as it was, if there is none. */
static bool read_byte(reader_t *reader, uint8_t *byte)
{
    const uint8_t *const start = reader->next;
    if (!skip(reader, 1)) {
        return false;
    }
    *byte = *start;
    return true;
}

/* Skip a text, without its terminating zero. Returns false if something else is there; the reader may then
 * have moved on. */
static bool skip_text(reader_t *reader, const char *text)
{
    const uint8_t *const start = reader->next;
    const size_t length = strlen(text);
    return skip(reader, length) && memcmp(start, text, length) == 0;
}

/* Read an unsigned number of up to 32 bits, in any of the forms that msgpack has for it. Returns false if
 * something else is there or the datagram ends before; *number and the reader's position are then of no use.
 */
static bool read_number(reader_t *reader, uint32_t *number)
{
    uint8_t first_byte, next_byte;
    if (!read_byte(reader, &first_byte)) {
        return false;
    }
    *number = first_byte;
    if (first_byte < 0x80) {
        return true; /* a number below 128 is its own first byte */
    }
    if (first_byte < MSGPACK_UINT8 || first_byte > MSGPACK_UINT32) {
        return false;
    }
    *number = 0;
    /* The three first bytes from MSGPACK_UINT8 to MSGPACK_UINT32 announce a number of 1, 2 or 4 bytes. */
    const int byte_count = 1 << (first_byte - MSGPACK_UINT8);
    for (int i = 0; i < byte_count; ++i) {
        if (!read_byte(reader, &next_byte)) {
            return false;
        }
        *number = (*number << 8) | next_byte;
    }
    return true;
}

/* Skip a time or the name of a channel: nil, a number or a text, in the forms that python-can writes, of up
 * to 255 characters. Returns false if something else is there; the reader's position is then of no use. */
static bool skip_value(reader_t *reader)
{
    if (reader->bytes_left == 0) {
        return false;
    }
    const uint8_t first_byte = *reader->next;
    const bool is_short_text = (first_byte & 0xE0) == 0xA0; /* up to 31 bytes: the upper 3 bits say so */
    if (is_short_text) {
        const uint32_t text_length = first_byte & 0x1FU; /* in the lower 5 bits */
        return skip(reader, 1 + text_length);
    }
    if (first_byte == MSGPACK_FLOAT64) {
        return skip(reader, 1 + sizeof(uint64_t));
    }
    if (first_byte == MSGPACK_STRING8) {
        /* The second byte is the length of the text, which follows. */
        return reader->bytes_left > 1 && skip(reader, 2U + reader->next[1]);
    }
    if (first_byte == MSGPACK_NIL) {
        return skip(reader, 1);
    }
    uint32_t number; /* skipped, too */
    return read_number(reader, &number);
}

/* Read the bytes at the end of a datagram's data field: their number, which must be `data_length`, then the
 * bytes, which are copied to `data`. Returns false, and leaves `data` as it was, if something else is there;
 * the reader's position is then of no use. */
static bool read_data(reader_t *reader, uint8_t data[CAN_MAX_DLEN], uint32_t data_length)
{
    uint8_t first_byte, byte_count;
    if (!read_byte(reader, &first_byte) || first_byte != MSGPACK_BYTES8 || !read_byte(reader, &byte_count)) {
        return false;
    }
    const uint8_t *const start = reader->next;
    if (byte_count != data_length || byte_count > CAN_MAX_DLEN || !skip(reader, byte_count)) {
        return false;
    }
    memcpy(data, start, byte_count);
    return true;
}

/* Read a datagram of `size` bytes, field by field: it must have the 11 fields listed above BEFORE_TIME, in
 * their order, and be a classic data frame. Any time and any channel will do. Writes *frame and returns true,
 * or returns false, and leaves *frame as it was, at the first byte that differs. */
bool multicast_unpack(struct canfd_frame *frame, const uint8_t *datagram, size_t size)
{
    reader_t reader = {datagram, size};
    uint32_t id, data_length;
    uint8_t extended, data[CAN_MAX_DLEN];
    if (size > MULTICAST_SIZE) {
        return false;
    }
    /* Each step reads what stands behind the one before, and the first that fails ends the chain. The five
     * fields that are always false are in the texts: two in BEFORE_CHANNEL, three in AFTER_DATA. */
    const bool has_all_fields =
        skip_text(&reader, BEFORE_TIME) && skip_value(&reader) &&                   /* timestamp */
        skip_text(&reader, BEFORE_ID) && read_number(&reader, &id) &&               /* arbitration_id */
        skip_text(&reader, BEFORE_EXTENDED) && read_byte(&reader, &extended) &&     /* is_extended_id */
        skip_text(&reader, BEFORE_CHANNEL) && skip_value(&reader) &&                /* channel */
        skip_text(&reader, BEFORE_DLC) && read_number(&reader, &data_length) &&     /* dlc */
        skip_text(&reader, BEFORE_DATA) && read_data(&reader, data, data_length) && /* data */
        skip_text(&reader, AFTER_DATA) && reader.bytes_left == 0;
    if (!has_all_fields) {
        return false;
    }
    const bool is_extended = extended == MSGPACK_TRUE;
    if (!is_extended && extended != MSGPACK_FALSE) {
        return false;
    }
    if (id > (is_extended ? CAN_EFF_MASK : CAN_SFF_MASK)) {
        return false;
    }
    *frame =
        (struct canfd_frame){.can_id = id | (is_extended ? CAN_EFF_FLAG : 0), .len = (uint8_t)data_length};
    memcpy(frame->data, data, data_length);
    return true;
}
