/* What the Kilobot of docs/platforms/kilobot.md calls of kilolib, in kilolib's shapes. A test sets clock,
 * light and the message that is heard, and calls the robot's functions as kilolib does. */
#ifndef KILOLIB_H
#define KILOLIB_H

#include <avr/io.h>
#include <stdint.h>

typedef union {
    __extension__ struct {
        uint8_t data[9], type;
        uint16_t crc;
    } __attribute__((packed));
    uint8_t rawdata[12];
} message_t;
typedef struct {
    int16_t low_gain, high_gain;
} distance_measurement_t;
typedef enum { NORMAL } message_type_t;

#define RGB(red, green, blue) (uint8_t)((red) | (green) << 2 | (blue) << 4)
#define CRC 0x1234

message_t *(*kilo_message_tx)(void);
void (*kilo_message_rx)(message_t *message, distance_measurement_t *distance);
void (*kilo_loop)(void);
message_t kilo_heard;
volatile uint32_t kilo_ticks;
uint16_t kilo_uid;
volatile int16_t kilo_light;
volatile uint8_t kilo_colour;
uint32_t read_x(void); /* defined behind the page's robot */

static uint16_t message_crc(const message_t *message) { return message->type == NORMAL ? CRC : 0; }
static int16_t get_ambientlight(void) { return kilo_light; }
static void set_color(uint8_t lit) { kilo_colour = lit; }
static void kilo_init(void) {}
static void kilo_start(void (*setup)(void), void (*loop)(void))
{
    setup();
    kilo_loop = loop;
}

#endif
