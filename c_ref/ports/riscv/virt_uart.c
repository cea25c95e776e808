/* The serial line of QEMU's RISC-V board "virt": a 16550, whose interrupt goes through SiFive's controller
 * (PLIC). */
#include "../uart.h"

#include "../port.h"

#include <stdint.h>

#define UART_DATA (*(volatile uint8_t *)0x10000000)
#define UART_INTERRUPTS (*(volatile uint8_t *)0x10000001)
#define UART_QUEUES (*(volatile uint8_t *)0x10000002)
#define UART_STATE (*(volatile uint8_t *)0x10000005)

#define WHEN_RECEIVED 1    /* in UART_INTERRUPTS */
#define ENABLE_AND_CLEAR 7 /* in UART_QUEUES */
#define HAS_BYTE 0x01      /* in UART_STATE */
#define HAS_LOST 0x02
#define HAS_ROOM 0x20

#define UART_PRIORITY (*(volatile uint32_t *)0x0C000028) /* interrupt 10 */
#define ENABLED_INTERRUPTS (*(volatile uint32_t *)0x0C002000)
#define CLAIMED_INTERRUPT (*(volatile uint32_t *)0x0C200004)
#define UART_BIT (UINT32_C(1) << 10)

static bool has_lost_bytes; /* kept here, since reading the state clears it there */

/* Read the state of the UART, and remember whether it has lost bytes. */
static uint8_t read_state(void)
{
    const uint8_t state = UART_STATE;
    has_lost_bytes |= (state & HAS_LOST) != 0;
    return state;
}

bool port_has_room(void) { return (read_state() & HAS_ROOM) != 0; }

/* Wait for room in the UART, and send a byte. */
void port_put(char byte)
{
    while (!port_has_room()) {
    }
    UART_DATA = (uint8_t)byte;
}

/* Returns PORT_LOST once if bytes were lost, which read_state() notes in has_lost_bytes. Otherwise it returns
 * the next byte, or PORT_NOTHING if there is none. */
int port_get(void)
{
    const bool has_byte = (read_state() & HAS_BYTE) != 0;
    if (has_lost_bytes) {
        has_lost_bytes = false;
        return PORT_LOST;
    }
    return has_byte ? UART_DATA : PORT_NOTHING;
}

/* Switch on the queues of the UART, and let received bytes wake the processor: an interrupt that is enabled
 * ends "wfi" even where the processor takes none, as here. Nor does it need to, since the UART itself keeps
 * 16 bytes, which is time enough. */
void uart_start(void)
{
    UART_QUEUES = ENABLE_AND_CLEAR;
    UART_INTERRUPTS = WHEN_RECEIVED;
    UART_PRIORITY = 1;
    ENABLED_INTERRUPTS = UART_BIT;
    /* Bit 11 of mie: external interrupts. The number is "csrs mie, a0", as assemblers differ in the extension
     * that they need for its name. */
    register uint32_t external __asm__("a0") = 0x800;
    __asm__ volatile(".4byte 0x30452073" ::"r"(external));
}

/* Sleep until an interrupt. It wakes the processor although it is masked. Reading this register claims the
 * interrupt, writing it back completes it, so that the next one can come. */
void port_sleep(void)
{
    __asm__ volatile("wfi");
    CLAIMED_INTERRUPT = CLAIMED_INTERRUPT;
}
