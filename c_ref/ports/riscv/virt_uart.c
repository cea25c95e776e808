/* The serial line of QEMU's RISC-V board "virt": a 16550, whose interrupt goes through SiFive's controller
 * (PLIC). */
#include "../uart.h"

#include "../port.h"

#include <stdint.h>

#define UART_DATA (*(volatile uint8_t *)0x10000000)
#define UART_INTERRUPTS (*(volatile uint8_t *)0x10000001)
#define UART_QUEUES (*(volatile uint8_t *)0x10000002)
#define UART_STATE (*(volatile uint8_t *)0x10000005)

#define WHEN_RECEIVED 1 /* in UART_INTERRUPTS */
#define QUEUES_ON 7     /* and empty */
#define RECEIVED 0x01   /* in UART_STATE */
#define LOST 0x02
#define ROOM 0x20

#define UART_PRIORITY (*(volatile uint32_t *)0x0C000028) /* interrupt 10 */
#define ENABLED (*(volatile uint32_t *)0x0C002000)
#define CLAIMED (*(volatile uint32_t *)0x0C200004)
#define UART_BIT (UINT32_C(1) << 10)

static bool has_lost; /* reading the state forgets it */

static uint8_t uart_state(void)
{
    const uint8_t state = UART_STATE;
    has_lost |= (state & LOST) != 0;
    return state;
}

bool port_has_room(void) { return (uart_state() & ROOM) != 0; }

void port_put(char byte)
{
    while (!port_has_room()) {
    }
    UART_DATA = (uint8_t)byte;
}

int port_get(void)
{
    const bool has_byte = (uart_state() & RECEIVED) != 0;
    if (has_lost) {
        has_lost = false;
        return PORT_LOST;
    }
    return has_byte ? UART_DATA : PORT_NOTHING;
}

/* The device itself keeps 16 bytes, which is time enough: no interrupt is ever taken. The number is
 * "csrs mie, a0". */
void uart_start(void)
{
    UART_QUEUES = QUEUES_ON;
    UART_INTERRUPTS = WHEN_RECEIVED;
    UART_PRIORITY = 1;
    ENABLED = UART_BIT;
    register uint32_t external __asm__("a0") = 0x800;
    __asm__ volatile(".4byte 0x30452073" ::"r"(external));
}

/* An interrupt wakes the processor although it is masked; claiming and completing it makes room for the next.
 */
void port_sleep(void)
{
    __asm__ volatile("wfi");
    CLAIMED = CLAIMED;
}
