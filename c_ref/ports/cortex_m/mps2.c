/* First UART of Arm's MPS2 boards with the Cortex-M system design kit (AN385: Cortex-M3, AN386: Cortex-M4).
 */
#include "uart.h"

#include "../port.h"

#include <stdint.h>

#define CLOCK 25000000
#define BAUD 115200

typedef struct {
    uint32_t data;
    uint32_t state; /* bit 0: no room to send */
    uint32_t control;
    uint32_t interrupt;
    uint32_t divisor;
} uart_t;

#define UART ((volatile uart_t *)0x40004000)

void uart_start(void)
{
    UART->divisor = CLOCK / BAUD;
    UART->control = 1; /* send */
}

void port_put(char byte)
{
    while ((UART->state & 1) != 0) {
    }
    UART->data = (uint8_t)byte;
}
