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
#define UART_BIT (UINT32_C(1) << 10) /* in ENABLED_INTERRUPTS */

/* In the processor's register mie: the interrupts that the controller passes on. */
#define EXTERNAL_INTERRUPTS_BIT (1U << 11)

static bool has_lost_bytes; /* kept here, since reading the state clears it there */

/* Read the state of the UART, and return it. If the UART has lost bytes, has_lost_bytes is set, since this
 * reading clears the UART's own flag. */
static uint8_t read_state(void)
{
    const uint8_t state = UART_STATE;
    has_lost_bytes |= (state & HAS_LOST) != 0;
    return state;
}

/* Whether port_put() would find room at once. */
bool port_has_room(void) { return (read_state() & HAS_ROOM) != 0; }

/* Wait for room in the UART, and send a byte. */
void port_put(char byte)
{
    while (!port_has_room()) {
    }
    UART_DATA = (uint8_t)byte;
}

/* Returns PORT_LOST, once, if bytes were lost, which read_state() stores in has_lost_bytes. The next byte
 * then waits for the next call. Otherwise returns the next byte, or PORT_NOTHING if there is none. */
int port_get(void)
{
    const bool has_byte = (read_state() & HAS_BYTE) != 0;
    if (has_lost_bytes) {
        has_lost_bytes = false;
        return PORT_LOST;
    }
    return has_byte ? UART_DATA : PORT_NOTHING;
}

/* Switch on the queues of the UART, and let received bytes wake the processor from port_sleep(). For that
 * their interrupt is enabled at each step of its way: in the UART, in the interrupt controller, and in the
 * processor's register mie. The processor never takes it, as another bit (mstatus.MIE), 0 from reset on,
 * forbids all interrupts. But an interrupt that is enabled in mie ends the instruction "wfi" all the same,
 * and then port_get() fetches the bytes. The UART keeps up to 16 bytes. */
void uart_start(void)
{
    UART_QUEUES = ENABLE_AND_CLEAR;
    UART_INTERRUPTS = WHEN_RECEIVED;
    UART_PRIORITY = 1; /* the controller passes on no interrupt of priority 0 */
    ENABLED_INTERRUPTS = UART_BIT;
    /* The number is the instruction "csrs mie, a0", which sets in mie the bits that are set in a0. Assemblers
     * differ in the extension that they need for its name. */
    register uint32_t external_interrupts __asm__("a0") = EXTERNAL_INTERRUPTS_BIT;
    __asm__ volatile(".4byte 0x30452073" ::"r"(external_interrupts));
}

/* Sleep until an interrupt, which wakes the processor although it is not taken (uart_start()). */
void port_sleep(void)
{
    __asm__ volatile("wfi");
    /* Reading claims the interrupt, and writing its number back completes it, so that the next can come. */
    const uint32_t interrupt = CLAIMED_INTERRUPT;
    CLAIMED_INTERRUPT = interrupt;
}
