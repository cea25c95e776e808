/* Frames as packets of 14 bytes on a serial line: a mark, identifier (little-endian) and data of a frame, and
 * a checksum, CRC-8 with the polynomial 0x07. The queue lets an interrupt receive while the robot computes.
 */
#include "radio.h"

#include "port.h"

#define MARK 0x7E
#define IDENTIFIER 4U
#define FRAME (IDENTIFIER + 8U)
#define PACKET (FRAME + 1U) /* without the mark */
#define SLOTS 8U            /* packets that may wait; a power of two */

/* Each side writes only one of the two counts, and every processor reads and writes a byte in one piece:
 * nothing has to be masked. A packet that finds the queue full is lost. */
static volatile uint8_t queue[SLOTS][PACKET];
static volatile uint8_t filled, emptied; /* packets since start, modulo 256 */
static volatile uint8_t refused;         /* written by the receiving side */
static uint8_t damaged;                  /* by the other */

void radio_hear(uint8_t byte)
{
    static uint8_t count; /* bytes of this packet so far, its mark included */
    static bool has_room;
    if (count == 0) {
        has_room = (uint8_t)(filled - emptied) < SLOTS;
        count = byte == MARK;
        return;
    }
    if (has_room) {
        queue[filled % SLOTS][count - 1] = byte;
    }
    if (count++ == PACKET) {
        count = 0;
        filled = (uint8_t)(filled + has_room);
        refused = (uint8_t)(refused + !has_room);
    }
}

static uint8_t checksum(const uint8_t *bytes)
{
    uint8_t crc = 0;
    for (uint8_t i = 0; i < FRAME; ++i) {
        crc ^= bytes[i];
        for (uint8_t bit = 0; bit < 8; ++bit) {
            crc = (uint8_t)(crc << 1 ^ (crc & 0x80 ? 0x07 : 0));
        }
    }
    return crc;
}

bool radio_take(mcp_asdf_frame_t *frame)
{
    while (emptied != filled) {
        uint8_t packet[PACKET];
        for (uint8_t i = 0; i < PACKET; ++i) {
            packet[i] = queue[emptied % SLOTS][i];
        }
        emptied = (uint8_t)(emptied + 1);
        if (packet[FRAME] != checksum(packet)) {
            damaged = (uint8_t)(damaged + 1);
            continue;
        }
        *frame = (mcp_asdf_frame_t){.length = 8};
        for (uint8_t i = 0; i < IDENTIFIER; ++i) {
            frame->id |= (uint32_t)packet[i] << 8 * i;
        }
        for (uint8_t i = 0; i < 8; ++i) {
            frame->data[i] = packet[IDENTIFIER + i];
        }
        return true;
    }
    return false;
}

void radio_send(const mcp_asdf_frame_t *frame)
{
    uint8_t packet[PACKET];
    for (uint8_t i = 0; i < FRAME; ++i) {
        packet[i] = i < IDENTIFIER ? (uint8_t)(frame->id >> 8 * i) : frame->data[i - IDENTIFIER];
    }
    packet[FRAME] = checksum(packet);
    port_put(MARK);
    for (uint8_t i = 0; i < PACKET; ++i) {
        port_put((char)packet[i]);
    }
}

uint8_t radio_lost(void) { return (uint8_t)(refused + damaged); }
