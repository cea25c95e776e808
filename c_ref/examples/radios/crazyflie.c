/* Estimates over the Crazyflie's peer-to-peer radio, for an app of its firmware. */
#include "nine_bytes.h"
#include "robot_radio.h"

#include "FreeRTOS.h"
#include "queue.h"
#include "radiolink.h"

#define QUEUE_LENGTH 20
#define P2P_PORT 0

static QueueHandle_t received_messages;

/* Put a received packet into the queue if it has the port and the size of a message; else ignore it. Runs in
 * the task of the radio link, where nothing of the robot may be touched. */
static void queue_message(P2PPacket *packet)
{
    if (packet->port == P2P_PORT && packet->size == MESSAGE_SIZE) {
        (void)xQueueSend(received_messages, packet->data, 0); /* a full queue loses it */
    }
}

/* Make the queue, and let the radio link call queue_message() with every packet that it receives. */
void radio_start(void)
{
    received_messages = xQueueCreate(QUEUE_LENGTH, MESSAGE_SIZE);
    p2pRegisterCB(queue_message);
}

/* Send the robot's estimate to all robots in range. A message that cannot be sent is lost. */
void radio_broadcast(const mcp_asdf_t *robot)
{
    static uint8_t transfer_id; /* the number of earlier messages, modulo 256 */
    P2PPacket packet = {.size = MESSAGE_SIZE, .port = P2P_PORT};
    write_message(packet.data, robot, transfer_id);
    ++transfer_id;
    (void)radiolinkSendP2PPacketBroadcast(&packet);
}

/* Take all messages out of the queue, without waiting, and let the robot receive them. */
void radio_receive(mcp_asdf_t *robot)
{
    uint8_t message[MESSAGE_SIZE];
    while (xQueueReceive(received_messages, message, 0) == pdTRUE) {
        receive_message(robot, message);
    }
}
