/* The packet radio with any bytes in its ear: what it takes is a frame whose checksum is right, in the order
 * of arrival, never more of them than came; what it cannot keep, it counts. A packet of its own survives. */
#include "input.h"
#include "port.h"
#include "radio.h"

#define PACKET 14

static uint8_t sent[PACKET];
static size_t put;

void port_put(char byte)
{
    MUST(put < PACKET);
    sent[put++] = (uint8_t)byte;
}

/* A frame on the air, of which some bits may flip on the way. */
static void hear_frame(input_t *in, mcp_asdf_frame_t *frame)
{
    *frame = (mcp_asdf_frame_t){.id = input_take(in, 4), .length = 8};
    for (int i = 0; i < 8; ++i) {
        frame->data[i] = (uint8_t)input_take(in, 1);
    }
    put = 0;
    radio_send(frame);
    MUST(put == PACKET);
    for (int i = 0; i < PACKET; ++i) {
        radio_receive_byte(sent[i]);
    }
}

/* Whatever stood half there ends, and the queue is empty: the radio keeps its state from input to input. */
static void settle_down(void)
{
    mcp_asdf_frame_t frame;
    for (int i = 0; i < PACKET; ++i) {
        radio_receive_byte(0);
    }
    while (radio_next_frame(&frame)) {
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    input_t in = {data, size};
    mcp_asdf_frame_t frame, heard;
    size_t came = 0, taken = 0;
    settle_down();
    const uint8_t lost = radio_lost_packets();
    while (in.left > 0) {
        const uint32_t byte = input_take(&in, 1);
        if (byte == 0xFE) {
            frame = heard = (mcp_asdf_frame_t){.id = 0xA5, .length = 1};
            const bool found = radio_next_frame(&frame);
            MUST(found != same_frame(&frame, &heard));
            MUST(!found || (frame.length == 8 && frame.flags == 0));
            taken += found;
        } else {
            radio_receive_byte((uint8_t)byte);
            ++came;
        }
    }
    while (radio_next_frame(&frame)) {
        ++taken;
    }
    MUST((taken + (uint8_t)(radio_lost_packets() - lost)) * PACKET <= came + PACKET - 1);
    settle_down();
    in = (input_t){data, size};
    hear_frame(&in, &frame);
    MUST(radio_next_frame(&heard) && same_frame(&heard, &frame) && !radio_next_frame(&heard));
    return 0;
}
