/* Datagrams of a multicast group. An accepted datagram holds a frame that a CAN controller could have sent. A
 * packed frame is unpacked as it was, or refused if the datagram is cut. */
#include "input.h"
#include "linux/multicast.h"

/* Check that a datagram of any bytes is refused or holds a frame with an id and a length in range, and zeros
 * behind its data. */
static void check_any_datagram(const uint8_t *data, size_t size)
{
    struct canfd_frame frame;
    if (multicast_unpack(&frame, data, size)) {
        const bool is_extended = (frame.can_id & CAN_EFF_FLAG) != 0;
        MUST((frame.can_id & ~CAN_EFF_FLAG) <= (is_extended ? CAN_EFF_MASK : CAN_SFF_MASK));
        MUST(frame.len <= CAN_MAX_DLEN && size >= 144U + frame.len); /* 144: the shortest without data */
        for (size_t i = frame.len; i < sizeof frame.data; ++i) {
            MUST(frame.data[i] == 0);
        }
    }
}

/* Check that a frame made of the input is unpacked from its datagram as it was, and refused if the datagram
 * is cut.
 */
static void check_any_frame(input_t *in)
{
    struct can_frame frame = {.can_id = (input_take(in, 4) & CAN_EFF_MASK) | CAN_EFF_FLAG | (1U << 16)};
    struct canfd_frame unpacked;
    uint8_t datagram[MULTICAST_SIZE];
    frame.can_dlc = (uint8_t)(input_take(in, 1) % 9);
    for (int i = 0; i < frame.can_dlc; ++i) {
        frame.data[i] = (uint8_t)input_take(in, 1);
    }
    const size_t size = multicast_pack(datagram, &frame, 0.5);
    MUST(size == 156U + frame.can_dlc && multicast_unpack(&unpacked, datagram, size));
    MUST(unpacked.can_id == frame.can_id && unpacked.len == frame.can_dlc);
    MUST(memcmp(unpacked.data, frame.data, sizeof frame.data) == 0);
    MUST(!multicast_unpack(&unpacked, datagram, size - 1 - input_take(in, 1) % size));
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    input_t in = {data, size};
    check_any_datagram(data, size);
    check_any_frame(&in);
    return 0;
}
