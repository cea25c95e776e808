/* UART of Nordic's nRF51, as on the BBC micro:bit. */
#include "../uart.h"

#include "../port.h"

#include <stdint.h>

#define START_TX (*(volatile uint32_t *)0x40002008)
#define IS_SENT (*(volatile uint32_t *)0x4000211C)
#define ENABLE (*(volatile uint32_t *)0x40002500)
#define PIN_TX (*(volatile uint32_t *)0x4000250C)
#define DATA (*(volatile uint32_t *)0x4000251C)
#define BAUD (*(volatile uint32_t *)0x40002524)

/* Choose pin and speed of the serial line, and switch on its sender. */
void uart_start(void)
{
    PIN_TX = 24;       /* the line to the interface chip's USB port */
    BAUD = 0x01D7E000; /* 115200, in the code that the manual of the chip lists */
    ENABLE = 4;        /* the number that the manual gives for it */
    START_TX = 1;      /* writing 1 starts the sender */
}

/* Send a byte, and wait until it has been sent. */
void port_put(char byte)
{
    IS_SENT = 0; /* cleared here, and set by the UART when it has sent the byte */
    DATA = (uint8_t)byte;
    while (IS_SENT == 0) {
    }
}
