/* What c_ref/examples/radios/esp_now.c calls of ESP-IDF, in ESP-IDF's shapes. */
#ifndef ESP_NOW_H
#define ESP_NOW_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

typedef int esp_err_t;
#define ESP_OK 0
#define ESP_FAIL (-1)
#define ESP_ERROR_CHECK(error)                                                                               \
    do {                                                                                                     \
        if ((error) != ESP_OK) {                                                                             \
            abort();                                                                                         \
        }                                                                                                    \
    } while (false)

#define ESP_NOW_ETH_ALEN 6

typedef enum { WIFI_IF_STA, WIFI_IF_AP } wifi_interface_t;

typedef struct {
    uint8_t peer_addr[ESP_NOW_ETH_ALEN];
    wifi_interface_t ifidx;
} esp_now_peer_info_t;

typedef struct {
    uint8_t *src_addr;
} esp_now_recv_info_t;

typedef void (*esp_now_recv_cb_t)(const esp_now_recv_info_t *info, const uint8_t *data, int length);

esp_err_t esp_now_init(void);
esp_err_t esp_now_register_recv_cb(esp_now_recv_cb_t callback);
esp_err_t esp_now_add_peer(const esp_now_peer_info_t *peer);
esp_err_t esp_now_send(const uint8_t *address, const uint8_t *data, size_t length);

#endif
