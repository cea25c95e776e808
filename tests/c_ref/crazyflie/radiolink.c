/* The functions of radiolink.h for one robot. */
#include "radiolink.h"

#include "../air.h"

#include <string.h>

uint8_t air_sent_data[64];
size_t air_sent_length;
uint8_t air_port; /* of the messages that air_deliver() brings */

static P2PCallback receive_callback;

void p2pRegisterCB(P2PCallback callback) { receive_callback = callback; }

bool radiolinkSendP2PPacketBroadcast(P2PPacket *packet)
{
    memcpy(air_sent_data, packet->data, packet->size);
    air_sent_length = packet->size;
    return true;
}

void air_deliver(const uint8_t *data, int length)
{
    P2PPacket packet = {.size = (uint8_t)length, .port = air_port};
    memcpy(packet.data, data, packet.size);
    receive_callback(&packet);
}
