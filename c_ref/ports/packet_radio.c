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
/* Packets that were lost since the queue was full, modulo 256; written by the receiving side. */
static volatile uint8_t rejected_packets;
/* Packets with a wrong checksum, modulo 256; written by the other side. */
static uint8_t damaged_packets;

/* Collect the bytes of a packet: the byte MARK, then PACKET_BYTES bytes, which go to the next free slot of
 * the queue. When the last of them has come, the packet counts in received_packets, which hands its slot over
 * to radio_next_frame(). Bytes before a mark are skipped. If the queue had no room at the mark, the bytes of
 * the packet are dropped, and it counts in rejected_packets. */
void radio_receive_byte(uint8_t byte)
{
    static bool is_in_packet;  /* whether a mark has come whose packet is not complete yet */
    static bool has_slot;      /* whether this packet has a slot in the queue */
    static uint8_t byte_count; /* bytes of this packet so far, without its mark */
    if (!is_in_packet) {
        if (byte == MARK) {
            const uint8_t waiting_packets = (uint8_t)(received_packets - taken_packets); /* modulo 256 */
            has_slot = waiting_packets < QUEUE_SLOTS;
            byte_count = 0;
            is_in_packet = true;
        }
        return;
    }
    if (has_slot) {
        queue[received_packets % QUEUE_SLOTS][byte_count] = byte;
    }
    ++byte_count;
    if (byte_count < PACKET_BYTES) {
        return;
    }
    is_in_packet = false;
    if (has_slot) {
        received_packets = (uint8_t)(received_packets + 1);
    } else {
        rejected_packets = (uint8_t)(rejected_packets + 1);
    }
}

/* Returns the CRC-8 of the first FRAME_BYTES bytes of `packet`, which are all but the checksum: the
 * polynomial CRC_POLYNOMIAL, the highest bit of each byte first, and 0 at the start. */
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
        if (packet[FRAME_BYTES] != checksum(packet)) { /* its last byte is the checksum of those before */
            damaged_packets = (uint8_t)(damaged_packets + 1);
            continue;
        }
        *frame = (mcp_asdf_frame_t){.length = DATA_BYTES};
        for (uint8_t i = 0; i < ID_BYTES; ++i) {
            frame->id |= (uint32_t)packet[i] << (8 * i); /* lowest byte first */
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
        packet[i] = (uint8_t)(frame->id >> (8 * i)); /* lowest byte first */
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
