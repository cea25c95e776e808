/* Bytes that wait to be sent over a serial line: whole texts go in, single bytes come out. Nothing waits. */
#ifndef MCP_ASDF_PORT_OUTBOX_H
#define MCP_ASDF_PORT_OUTBOX_H

#include <stdbool.h>
#include <stdint.h>

#define OUTBOX_SIZE 256U /* the bytes are counted around by one byte */

/* All zero is empty. */
typedef struct {
    char bytes[OUTBOX_SIZE];
    uint16_t waiting;
    uint8_t first;
} outbox_t;

/* Put `text` behind the others; returns false, and changes nothing, if not all of it finds room. */
static inline bool outbox_put(outbox_t *box, const char *text, uint8_t length)
{
    if (box->waiting + length > OUTBOX_SIZE) {
        return false;
    }
    for (uint8_t i = 0; i < length; ++i) {
        box->bytes[(uint8_t)(box->first + box->waiting)] = text[i];
        ++box->waiting;
    }
    return true;
}

/* Take the byte that has waited longest. Needs waiting > 0. */
static inline char outbox_take(outbox_t *box)
{
    --box->waiting;
    return box->bytes[box->first++];
}

#endif
