/* The functions of esp_now.h for one robot: calls in the order that ESP-IDF asks for, or they fail. */
#include "esp_now.h"

#include "../air.h"

#include <string.h>

uint8_t air_sent_data[64];
size_t air_sent_length;

static bool has_begun;
static esp_now_recv_cb_t receive_callback;
static esp_now_peer_info_t added_peer;

esp_err_t esp_now_init(void)
{
    has_begun = true;
    return ESP_OK;
}

esp_err_t esp_now_register_recv_cb(esp_now_recv_cb_t callback)
{
    receive_callback = callback;
    return has_begun ? ESP_OK : ESP_FAIL;
}

esp_err_t esp_now_add_peer(const esp_now_peer_info_t *peer)
{
    added_peer = *peer;
    return has_begun && peer->ifidx == WIFI_IF_STA ? ESP_OK : ESP_FAIL;
}

/* Fails for an address that has not been added as a peer. */
esp_err_t esp_now_send(const uint8_t *address, const uint8_t *data, size_t length)
{
    if (memcmp(address, added_peer.peer_addr, ESP_NOW_ETH_ALEN) != 0 || length > sizeof air_sent_data) {
        return ESP_FAIL;
    }
    memcpy(air_sent_data, data, length);
    air_sent_length = length;
    return ESP_OK;
}

void air_deliver(const uint8_t *data, int length)
{
    const esp_now_recv_info_t info = {NULL};
    receive_callback(&info, data, length);
}
