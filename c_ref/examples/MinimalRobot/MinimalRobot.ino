/* A robot on an Arduino: a ground sensor at A0, and a modem that broadcasts to the other robots at Serial.
 *
 * Twice a second the robot observes the floor, broadcasts its estimate, and settles the round of what it
 * has received. Serial carries packets of 14 bytes: the byte 0x7E, the identifier of a frame (lowest byte
 * first), its 8 bytes of data, and their CRC-8 with the polynomial 0x07. `mcp_asdf.h` is the manual.
 */
#include <mcp_asdf.h>
#include <mcp_asdf_frame.h>

const uint8_t ROBOT_ID = 7;            // 0 to 125; every robot has its own
const int BLACK_BELOW = 512;           // reading of A0, 0 to 1023, below which a tile is black
const unsigned long TICK = 500;        // milliseconds
const unsigned long MODEM_BAUD = 9600; // bits a second

// For a swarm in which nobody knows whose sensor is wrong. MCP_ASDF_CONFIG_ASDF(table) is for a sensor that
// you doubt, with the array that `mcp-asdf table` writes, in another tab of this sketch.
const mcp_asdf_config_t config = MCP_ASDF_CONFIG_ROBUST;
const mcp_asdf_frame_format_t estimate_format = MCP_ASDF_FORMAT_ESTIMATE;
mcp_asdf_t robot;

const uint8_t PACKET_MARK = 0x7E;
const uint8_t CONTENT_SIZE = 12; // bytes of identifier and data

// Returns the checksum of a packet's identifier and data.
uint8_t packet_checksum(const uint8_t *content)
{
    uint8_t crc = 0;
    for (uint8_t i = 0; i < CONTENT_SIZE; ++i) {
        crc ^= content[i];
        for (uint8_t bit = 0; bit < 8; ++bit) {
            crc = (crc << 1) ^ (crc & 0x80 ? 0x07 : 0);
        }
    }
    return crc;
}

// Collects the bytes of a packet, with its checksum but without its mark. Returns whether it is complete.
bool read_packet(uint8_t *packet)
{
    static bool has_begun = false;
    static uint8_t byte_count = 0;
    while (Serial.available() > 0) {
        const uint8_t received = Serial.read();
        if (!has_begun) {
            has_begun = received == PACKET_MARK;
            continue;
        }
        packet[byte_count++] = received;
        if (byte_count > CONTENT_SIZE) {
            has_begun = false;
            byte_count = 0;
            return true;
        }
    }
    return false;
}

// Passes the estimates that have arrived to the firmware. Damaged packets and other frames are ignored.
void receive()
{
    static uint8_t packet[CONTENT_SIZE + 1];
    while (read_packet(packet)) {
        if (packet_checksum(packet) != packet[CONTENT_SIZE]) {
            continue;
        }
        mcp_asdf_frame_t frame = {0, 0, 8, {0}};
        for (uint8_t i = 0; i < 4; ++i) {
            frame.id |= (uint32_t)packet[i] << (8 * i);
        }
        memcpy(frame.data, packet + 4, 8);
        mcp_asdf_estimate_t estimate;
        if (mcp_asdf_decode_estimate(&estimate, estimate_format.subject, &frame) == MCP_ASDF_FRAME_OK) {
            mcp_asdf_receive(&robot, estimate.node, estimate.x_hat, estimate.alpha);
        }
    }
}

// Sends x_hat and alpha to the neighbours.
void broadcast()
{
    static uint8_t transfer_id = 0;
    const mcp_asdf_estimate_t estimate = {ROBOT_ID, transfer_id++, mcp_asdf_x_hat(&robot),
                                          mcp_asdf_alpha(&robot)};
    mcp_asdf_frame_t frame;
    if (mcp_asdf_encode_estimate(&frame, &estimate_format, &estimate) != MCP_ASDF_FRAME_OK) {
        return;
    }
    uint8_t content[CONTENT_SIZE];
    for (uint8_t i = 0; i < 4; ++i) {
        content[i] = (uint8_t)(frame.id >> (8 * i));
    }
    memcpy(content + 4, frame.data, 8);
    Serial.write(PACKET_MARK);
    Serial.write(content, CONTENT_SIZE);
    Serial.write(packet_checksum(content));
}

void setup()
{
    Serial.begin(MODEM_BAUD);
    pinMode(LED_BUILTIN, OUTPUT);
    // We take the sensor to be right 95 times out of 100.
    if (mcp_asdf_init(&robot, &config, ROBOT_ID, MCP_ASDF_PROBABILITY(95, 100)) != MCP_ASDF_OK) {
        for (;;) { // the settings above are wrong: mcp_asdf.h says which are allowed
        }
    }
}

void loop()
{
    static unsigned long last_tick = 0;
    receive();
    if (millis() - last_tick < TICK) {
        return;
    }
    last_tick += TICK;
    mcp_asdf_observe(&robot, analogRead(A0) < BLACK_BELOW ? MCP_ASDF_BLACK : MCP_ASDF_WHITE);
    broadcast();
    mcp_asdf_settle(&robot);
    digitalWrite(LED_BUILTIN, mcp_asdf_x(&robot) > MCP_ASDF_HALF); // lit: more than half is black
}
