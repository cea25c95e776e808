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

#define SENT 0x40 /* in UART_STATE */
#define ROOM 0x20
#define DOUBLE_SPEED 0x02
#define SEND 0x08 /* in UART_CONTROL */
#define POWER_DOWN 0x05

static void uart_start(void) __attribute__((constructor));

static void uart_start(void)
{
    UART_STATE = DOUBLE_SPEED;
    UART_DIVISOR = BAUD_DIVISOR - 1;
    UART_CONTROL = SEND;
}

void port_put(char byte)
{
    while ((UART_STATE & ROOM) == 0) {
    }
    UART_STATE = SENT | DOUBLE_SPEED; /* cleared by writing 1 */
    UART_DATA = (uint8_t)byte;
}

/* Asleep without interrupts nothing can wake it, which simavr takes for the end. There is no exit status. */
void port_exit(int status)
{
    (void)status;
    port_put('\n'); /* so that there is something to wait for */
    while ((UART_STATE & SENT) == 0) {
    }
    SLEEP_CONTROL = POWER_DOWN;
    __asm__ volatile("cli\n"
                     "sleep\n");
    for (;;) {
    }
}
