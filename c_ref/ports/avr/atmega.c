/* First UART of the ATmega328P (Kilobot, Arduino Uno) and its larger relatives. avr-libc starts the program;
 * the addresses are written out so that host tools can read this file. */
#include "../port.h"
#include "clock.h"

#include <stdint.h>

#define SLEEP_CONTROL (*(volatile uint8_t *)0x53)
#define UART_STATE (*(volatile uint8_t *)0xC0)
#define UART_CONTROL (*(volatile uint8_t *)0xC1)
#define UART_DIVISOR (*(volatile uint8_t *)0xC4)
#define UART_DATA (*(volatile uint8_t *)0xC6)

#define ALL_SENT 0x40 /* in UART_STATE */
#define HAS_ROOM 0x20
#define DOUBLE_SPEED 0x02
#define ENABLE_SENDER 0x08 /* in UART_CONTROL */
#define POWER_DOWN 0x05    /* in SLEEP_CONTROL */

static void uart_start(void) __attribute__((constructor));

/* Set the speed of the serial line, and switch on its sender. avr-libc calls this before main(). */
static void uart_start(void)
{
    UART_STATE = DOUBLE_SPEED;
    UART_DIVISOR = BAUD_DIVISOR - 1; /* the UART divides by one more than the register has */
    UART_CONTROL = ENABLE_SENDER;
}

/* Wait for room in the UART, and send a byte. */
void port_put(char byte)
{
    while ((UART_STATE & HAS_ROOM) == 0) {
    }
    /* Writing 1 to ALL_SENT clears it: it is set again when all has been sent. The same register holds
     * DOUBLE_SPEED, which is to stay. */
    UART_STATE = ALL_SENT | DOUBLE_SPEED;
    UART_DATA = (uint8_t)byte;
}

/* Wait until all bytes have been sent, then sleep with interrupts off: nothing can wake the processor, which
 * simavr takes for the end of the program. There is no exit status. */
void port_exit(int status)
{
    (void)status;
    port_put('\n'); /* if nothing has been sent, ALL_SENT would never be set */
    while ((UART_STATE & ALL_SENT) == 0) {
    }
    SLEEP_CONTROL = POWER_DOWN;
    __asm__ volatile("cli\n"
                     "sleep\n");
    for (;;) {
    }
}
