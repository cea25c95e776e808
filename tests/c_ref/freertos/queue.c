/* The queue of queue.h: one at a time, in static memory. */
#include "queue.h"

#include <stdlib.h>
#include <string.h>

#define QUEUE_BYTES 1024

struct queue {
    UBaseType_t item_count;
    UBaseType_t item_size;
    UBaseType_t sent_items; /* since its creation */
    UBaseType_t taken_items;
    uint8_t items[QUEUE_BYTES];
};

/* Aborts if the items need more memory than there is. */
QueueHandle_t xQueueCreate(UBaseType_t item_count, UBaseType_t item_size)
{
    static struct queue queue;
    if (item_count * item_size > QUEUE_BYTES) {
        abort();
    }
    queue = (struct queue){.item_count = item_count, .item_size = item_size};
    return &queue;
}

static uint8_t *item_at(QueueHandle_t queue, UBaseType_t index)
{
    return queue->items + index % queue->item_count * queue->item_size;
}

BaseType_t xQueueSend(QueueHandle_t queue, const void *item, TickType_t ticks_to_wait)
{
    (void)ticks_to_wait;
    if (queue->sent_items - queue->taken_items == queue->item_count) {
        return pdFALSE;
    }
    memcpy(item_at(queue, queue->sent_items++), item, queue->item_size);
    return pdTRUE;
}

BaseType_t xQueueReceive(QueueHandle_t queue, void *item, TickType_t ticks_to_wait)
{
    (void)ticks_to_wait;
    if (queue->sent_items == queue->taken_items) {
        return pdFALSE;
    }
    memcpy(item, item_at(queue, queue->taken_items++), queue->item_size);
    return pdTRUE;
}
