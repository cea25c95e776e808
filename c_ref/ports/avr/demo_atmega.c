/* The robot of demo.c on an ATmega328P: the ground sensor at ADC0 gives less than half of the supply over a
 * black tile, timer 1 counts the ticks, and a modem on the UART is the radio. */
#include "../demo.h"
#include "../radio.h"
#include "clock.h"

#include <avr/interrupt.h>
#include <avr/io.h>

#define PRESCALER 64
#define TICKS_PER_SECOND 10
#define ADC_HALF 512 /* half of the supply */

/* Interrupt of the UART when it has received a byte, which reading UDR0 fetches. */
ISR(USART_RX_vect) { radio_receive_byte(UDR0); }

/* Switch on the receiver, timer 1, and the converter of the ground sensor. */
void board_start(void)
{
    UCSR0B |= _BV(RXEN0) | _BV(RXCIE0); /* atmega.c has set the speed */
    OCR1A = F_CPU / PRESCALER / TICKS_PER_SECOND - 1;
    TCCR1B = _BV(WGM12) | _BV(CS11) | _BV(CS10); /* from 0 to OCR1A and again, every 64 clocks */
    ADMUX = _BV(REFS0);                          /* input ADC0, compared with the supply */
    ADCSRA = _BV(ADEN) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0); /* on, with 1/128 of the clock */
    sei();                                                     /* from now on interrupts are handled */
}

/* Whether timer 1 has reached its end, the end of a tick, since the last call. The timer sets its flag OCF1A
 * then; this function clears it. */
bool board_has_tick_begun(void)
{
    const bool has_begun = (TIFR1 & _BV(OCF1A)) != 0;
    if (has_begun) {
        TIFR1 = _BV(OCF1A); /* writing 1 clears the flag */
    }
    return has_begun;
}

/* Measure the voltage of the ground sensor, and wait for the result. Less than half of the supply is black,
 * and any other voltage white; so it always returns true: there is a colour, in *tile. */
bool board_read_tile(mcp_asdf_observation_t *tile)
{
    ADCSRA |= _BV(ADSC); /* starts a conversion, and is 1 until it has ended */
    while ((ADCSRA & _BV(ADSC)) != 0) {
    }
    *tile = ADC < ADC_HALF ? MCP_ASDF_BLACK : MCP_ASDF_WHITE;
    return true;
}
