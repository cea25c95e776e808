/* Frames as packets of 14 bytes on a serial line: a mark, the identifier (little-endian) and the data of a
 * frame, and a checksum, CRC-8 with the polynomial 0x07. The queue lets an interrupt receive while the robot
 * computes.
 */
#include "radio.h"

#include "port.h"

#define MARK 0x7E
#define ID_BYTES 4U
#define DATA_BYTES 8U
#define FRAME_BYTES (ID_BYTES + DATA_BYTES)
#define PACKET_BYTES (FRAME_BYTES + 1U) /* with the checksum, without the mark */
#define QUEUE_SLOTS 8U                  /* packets that may wait; a power of two */
#define CRC_POLYNOMIAL 0x07

/* The receiving side writes to the queue, the other one reads it. Each writes only one of the two counts, and
 * every processor reads and writes a byte in one piece: no interrupt has to be masked. */
static volatile uint8_t queue[QUEUE_SLOTS][PACKET_BYTES];
static volatile uint8_t received_packets, taken_packets; /* put into the queue and taken out, modulo 256 */
static volatile uint8_t
    rejected_packets;           /* lost since the queue was full, modulo 256; by the receiving side */
static uint8_t damaged_packets; /* with a wrong checksum, modulo 256; written by the other side */

/* Collect the bytes of a packet, and add the packet to the queue when it is complete. Bytes before a mark are
 * skipped. A packet for which the queue had no room when it began counts in rejected_packets. */
void radio_receive_byte(uint8_t byte)
{
    static uint8_t byte_count; /* bytes of this packet so far, with its mark; 0 before that */
    static bool has_room;      /* whether this packet has a slot in the queue */
    if (byte_count == 0) {
        if (byte == MARK) {
            const uint8_t waiting_packets = (uint8_t)(received_packets - taken_packets);
            has_room = waiting_packets < QUEUE_SLOTS;
            byte_count = 1;
        }
        return;
    }
    if (has_room) {
        queue[received_packets % QUEUE_SLOTS][byte_count - 1] = byte; /* the mark is counted, but not kept */
    }
    if (byte_count < PACKET_BYTES) { /* with so many before it, the mark included, a byte is the last */
        ++byte_count;
        return;
    }
    /* That was the last byte, the checksum. Counting the packet hands its slot over to radio_next_frame(). */
    byte_count = 0;
    if (has_room) {
        received_packets = (uint8_t)(received_packets + 1);
    } else {
        rejected_packets = (uint8_t)(rejected_packets + 1);
    }
}

/* Returns the CRC-8 of the first FRAME_BYTES bytes of `packet`: all but the checksum. */
static uint8_t checksum(const uint8_t *packet)
{
    uint8_t crc = 0;
    for (uint8_t i = 0; i < FRAME_BYTES; ++i) {
        crc ^= packet[i];
        for (uint8_t bit = 0; bit < 8; ++bit) {
            const bool is_top_bit_set = (crc & 0x80) != 0; /* the shift moves it out */
            crc = (uint8_t)((crc << 1) ^ (is_top_bit_set ? CRC_POLYNOMIAL : 0));
        }
    }
    return crc;
}

/* Take packets out of the queue until one is undamaged, and write its frame to *frame. Every packet with a
 * wrong checksum counts in damaged_packets and is dropped. Returns false, and leaves *frame as it was, if no
 * undamaged packet is waiting. */
bool radio_next_frame(mcp_asdf_frame_t *frame)
{
    while (taken_packets != received_packets) {
        /* Copied first: the slot is free as soon as the packet counts as taken. */
        uint8_t packet[PACKET_BYTES];
        for (uint8_t i = 0; i < PACKET_BYTES; ++i) {
            packet[i] = queue[taken_packets % QUEUE_SLOTS][i];
        }
        taken_packets = (uint8_t)(taken_packets + 1);
        if (packet[FRAME_BYTES] != checksum(packet)) {
            damaged_packets = (uint8_t)(damaged_packets + 1);
            continue;
        }
        *frame = (mcp_asdf_frame_t){.length = DATA_BYTES};
        for (uint8_t i = 0; i < ID_BYTES; ++i) {
            frame->id |= (uint32_t)packet[i] << (8 * i);
        }
        for (uint8_t i = 0; i < DATA_BYTES; ++i) {
            frame->data[i] = packet[ID_BYTES + i];
        }
        return true;
    }
    return false;
}

/* Send a packet of `frame`: the byte MARK, with which a receiver finds its beginning, the id, lowest byte
 * first, the data, and the checksum of both. Waits until the line has accepted all of it. */
void radio_send(const mcp_asdf_frame_t *frame)
{
    uint8_t packet[PACKET_BYTES];
    for (uint8_t i = 0; i < ID_BYTES; ++i) {
        packet[i] = (uint8_t)(frame->id >> (8 * i));
    }
    for (uint8_t i = 0; i < DATA_BYTES; ++i) {
        packet[ID_BYTES + i] = frame->data[i];
    }
    packet[FRAME_BYTES] = checksum(packet);
    port_put(MARK);
    for (uint8_t i = 0; i < PACKET_BYTES; ++i) {
        port_put((char)packet[i]);
    }
}

/* Returns the number of packets that were damaged or found the queue full, modulo 256. */
uint8_t radio_lost_packets(void) { return (uint8_t)(rejected_packets + damaged_packets); }
