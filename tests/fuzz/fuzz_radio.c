/* The packet radio receives any bytes. It returns no more frames than packets have room in these bytes, lost
 * ones counted, and every frame is a classic one of 8 bytes. After any bytes it receives a packet that it has
 * sent itself. */
#include "input.h"
#include "port.h"
#include "radio.h"

#define PACKET 14       /* bytes, with the mark */
#define TAKE_FRAME 0xFE /* in the input: take a frame instead of receiving a byte */

static uint8_t sent[PACKET];
static size_t sent_count;

/* Store the byte that the radio sends. */
void port_put(char byte)
{
    MUST(sent_count < PACKET);
    sent[sent_count++] = (uint8_t)byte;
}

/* Send a frame made of the input, which is stored in *frame, and let the radio receive its own packet. */
static void receive_own_packet(input_t *in, mcp_asdf_frame_t *frame)
{
    *frame = (mcp_asdf_frame_t){.id = input_take(in, 4), .length = 8};
    for (int i = 0; i < 8; ++i) {
        frame->data[i] = (uint8_t)input_take(in, 1);
    }
    sent_count = 0;
    radio_send(frame);
    MUST(sent_count == PACKET);
    for (int i = 0; i < PACKET; ++i) {
        radio_receive_byte(sent[i]);
    }
}

/* Complete a packet that is half received, and empty the queue: the radio keeps its state from input to
 * input.
 */
static void reset_radio(void)
{
    mcp_asdf_frame_t frame;
    for (int i = 0; i < PACKET; ++i) {
        radio_receive_byte(0);
    }
    while (radio_next_frame(&frame)) {
    }
}

/* Take a frame out of the queue. Returns whether there was one; checks that it is a classic frame of 8 bytes,
 * and that nothing is written where there is none. */
static bool takes_frame(void)
{
    const mcp_asdf_frame_t before = {.id = 0xA5, .length = 1}; /* which no packet is */
    mcp_asdf_frame_t frame = before;
    const bool is_taken = radio_next_frame(&frame);
    MUST(is_taken != same_frame(&frame, &before));
    MUST(!is_taken || (frame.length == 8 && frame.flags == 0));
    return is_taken;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    input_t in = {data, size};
    mcp_asdf_frame_t frame, expected_frame;
    size_t received_bytes = 0, received_frames = 0;
    reset_radio();
    const uint8_t lost_before = radio_lost_packets();
    while (in.left > 0) {
        const uint32_t byte = input_take(&in, 1);
        if (byte == TAKE_FRAME) {
            received_frames += takes_frame();
        } else {
            radio_receive_byte((uint8_t)byte);
            ++received_bytes;
        }
    }
    while (radio_next_frame(&frame)) {
        ++received_frames;
    }
    /* reset_radio() may have left a packet that lacks its last byte. */
    const uint8_t lost_packets = (uint8_t)(radio_lost_packets() - lost_before);
    MUST((received_frames + lost_packets) * PACKET <= received_bytes + PACKET - 1);
    reset_radio();
    in = (input_t){data, size};
    receive_own_packet(&in, &expected_frame);
    MUST(radio_next_frame(&frame) && same_frame(&frame, &expected_frame) && !radio_next_frame(&frame));
    return 0;
}
