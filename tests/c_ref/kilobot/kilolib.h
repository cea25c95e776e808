/* What the Kilobot of docs/porting.md calls of kilolib, in kilolib's shapes, on a simulated ATmega328P: the
 * UART is the infrared radio, as a mark and the twelve bytes of a message, and the clock is 16 times as fast.
 * After each change the robot tells its x behind another mark, which its neighbour passes over. */
#ifndef KILOLIB_H
#define KILOLIB_H

#include <avr/interrupt.h>
#include <avr/io.h>
#include <stdint.h>
#include <util/crc16.h>

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
#define BIT_SECONDS 38400UL
#define TICK (F_CPU / 512 / 8)
#define TX_PERIOD                                                                                            \
    10 /* a little faster than kilolib: then it is sure which message is heard first in a round */

static message_t *(*kilo_message_tx)(void);
static void (*kilo_message_rx)(message_t *message, distance_measurement_t *distance);
static volatile uint32_t kilo_ticks;
static uint16_t kilo_uid;
static uint8_t colour;
static uint32_t told(void); /* behind the robot */

static uint16_t message_crc(const message_t *message)
{
    uint16_t crc = 0xFFFF;
    for (uint8_t i = 0; i < 10; ++i) {
        crc = _crc_ccitt_update(crc, message->rawdata[i]);
    }
    return crc;
}

static void put(uint8_t byte)
{
    while ((UCSR0A & _BV(UDRE0)) == 0) {
    }
    UDR0 = byte;
}

ISR(USART_RX_vect)
{
    static message_t message;
    static uint8_t left;
    const uint8_t byte = UDR0;
    if (left == 0) {
        left = byte == 'M' ? 12 : byte == 'X' ? 16 + 4 : 0;
        return;
    }
    if (left > 16) {
        left = (uint8_t)(left == 17 ? 0 : left - 1);
        return;
    }
    message.rawdata[12 - left--] = byte;
    if (left == 0 && message_crc(&message) == message.crc) {
        distance_measurement_t near = {500, 500};
        kilo_message_rx(&message, &near);
    }
}

ISR(TIMER1_COMPA_vect) { kilo_ticks = kilo_ticks + 1; }

static int16_t get_ambientlight(void)
{
    ADCSRA |= _BV(ADSC);
    while ((ADCSRA & _BV(ADSC)) != 0) {
    }
    return (int16_t)ADC;
}

static void set_color(uint8_t lit) { colour = lit; }

static void kilo_init(void)
{
    UBRR0 = F_CPU / 16 / BIT_SECONDS - 1;
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
    ADMUX = _BV(REFS0);
    ADCSRA = _BV(ADEN) | _BV(ADPS2) | _BV(ADPS1);
    OCR1A = TICK - 1;
    TCCR1B = _BV(WGM12) | _BV(CS11);
    TIMSK1 = _BV(OCIE1A);
    kilo_uid = PINB; /* pins of the simulator */
}

/* kilolib sends from its timer's interrupt; here the loop does, with the bytes that an interrupt would see.
 */
static void kilo_start(void (*setup)(void), void (*loop)(void))
{
    uint32_t next = 0, last = UINT32_MAX;
    setup();
    sei();
    for (;;) {
        loop();
        if ((int32_t)(kilo_ticks - next) >= 0) {
            const message_t message = *kilo_message_tx();
            next += TX_PERIOD;
            put('M');
            for (uint8_t i = 0; i < 12; ++i) {
                put(message.rawdata[i]);
            }
        }
        if (told() != last) {
            last = told();
            put('X');
            for (uint8_t i = 0; i < 4; ++i) {
                put((uint8_t)(last >> 8 * i));
            }
        }
    }
}

#endif
