/* Estimates over ESP-NOW on an ESP32. Wi-Fi has to be started first, in station mode
 * and on all robots on one channel. For ESP-IDF 5.0 and later. */
#include "nine_bytes.h"
#include "robot_radio.h"

#include "esp_now.h"
#include "freertos/FreeRTOS.h"
#include "freertos/queue.h"

#define QUEUE_LENGTH 20

static const uint8_t all_robots[ESP_NOW_ETH_ALEN] = {0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF};
static QueueHandle_t received_messages;

/* Put a received packet into the queue if it has the size of a message; else ignore it. Runs in the task of
 * the Wi-Fi driver, where nothing of the robot may be touched. */
static void queue_message(const esp_now_recv_info_t *info, const uint8_t *data, int length)
{
    (void)info;
    if (length == MESSAGE_SIZE) {
        (void)xQueueSend(received_messages, data, 0); /* a full queue loses it */
    }
}

/* Make the queue, start ESP-NOW with a peer that stands for all robots in range, and let the driver call
 * queue_message() with every packet that it receives. An error ends the program. */
void radio_start(void)
{
    esp_now_peer_info_t peer = {.ifidx = WIFI_IF_STA};
    memcpy(peer.peer_addr, all_robots, sizeof all_robots);
    received_messages = xQueueCreate(QUEUE_LENGTH, MESSAGE_SIZE);
    ESP_ERROR_CHECK(esp_now_init());
    ESP_ERROR_CHECK(esp_now_add_peer(&peer));
    ESP_ERROR_CHECK(esp_now_register_recv_cb(queue_message));
}

/* Send the robot's estimate to all robots in range. A message that cannot be sent is lost. */
void radio_broadcast(const mcp_asdf_t *robot)
{
    static uint8_t transfer_id; /* the number of earlier messages, modulo 256 */
    uint8_t message[MESSAGE_SIZE];
    write_message(message, robot, transfer_id);
    ++transfer_id;
    (void)esp_now_send(all_robots, message, sizeof message);
}

/* Take all messages out of the queue, without waiting, and let the robot receive them. */
void radio_receive(mcp_asdf_t *robot)
{
    uint8_t message[MESSAGE_SIZE];
    while (xQueueReceive(received_messages, message, 0) == pdTRUE) {
        receive_message(robot, message);
    }
}
