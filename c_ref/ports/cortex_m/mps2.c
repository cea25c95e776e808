/* First UART of Arm's MPS2 boards with the Cortex-M system design kit (AN385: Cortex-M3, AN386: Cortex-M4).
 */
#include "../uart.h"

#include "../port.h"

#include <stdint.h>

#define CLOCK 25000000
#define BAUD 115200

typedef struct {
    uint32_t data;
    uint32_t state; /* the bits below */
    uint32_t control;
    uint32_t interrupt;
    uint32_t divisor;
} uart_t;

#define NO_ROOM 1U            /* in state */
#define HAS_LOST 8U           /* in state: cleared by writing 1 */
#define ENABLE_SENDER 1U      /* in control */
#define ENABLE_RECEIVER 0xAU  /* in control: the receiver, and its interrupt */
#define RECEIVER_INTERRUPT 2U /* in interrupt: cleared by writing 1 */
#define QUEUE_SIZE 128U       /* divides 256, at which the counts of entries wrap */
#define RECEIVER_ENABLE_BIT 1 /* of the UART's receiver in the NVIC registers below */

#define UART ((volatile uart_t *)0x40004000)
/* Registers of the processor. A bit that is written as 1 enables or disables an interrupt, and one written as
 * 0 does nothing; bit 0 is the UART's receiver. */
#define NVIC_SET_ENABLE (*(volatile uint32_t *)0xE000E100)
#define NVIC_CLEAR_ENABLE (*(volatile uint32_t *)0xE000E180)

/* Received bytes, and PORT_LOST, on their way from the interrupt to the program. Each side writes only its
 * own count of entries, modulo 256. */
static volatile int16_t queue[QUEUE_SIZE];
static volatile uint8_t entries_put, entries_taken;

/* Whether port_put() would find room at once. */
bool port_has_room(void) { return (UART->state & NO_ROOM) == 0; }

/* Wait for room in the UART, and send a byte. */
void port_put(char byte)
{
    while (!port_has_room()) {
    }
    UART->data = (uint8_t)byte;
}

/* Append an entry, a byte or PORT_LOST, to the queue, which must have room for it. */
static void put_in_queue(int16_t entry)
{
    queue[entries_put % QUEUE_SIZE] = entry;
    ++entries_put; /* modulo 256; only now port_get() may read the entry */
}

/* Interrupt 0: a byte has been received. Puts it into the queue, after PORT_LOST if the UART has lost bytes.
 * If there is no room for two entries, the interrupt is disabled until port_get() has taken one: the UART
 * keeps one byte, and reports that it has lost those which follow. */
void handle_first_interrupt(void)
{
    const uint8_t waiting_entries = (uint8_t)(entries_put - entries_taken); /* modulo 256 */
    const bool has_room_for_two = waiting_entries + 2U <= QUEUE_SIZE;
    if (!has_room_for_two) {
        NVIC_CLEAR_ENABLE = RECEIVER_ENABLE_BIT;
        return;
    }
    UART->interrupt = RECEIVER_INTERRUPT; /* writing 1 acknowledges it */
    if ((UART->state & HAS_LOST) != 0) {
        UART->state = HAS_LOST; /* writing 1 clears it */
        put_in_queue(PORT_LOST);
    }
    put_in_queue((uint8_t)UART->data);
}

/* Set the speed of the serial line, and switch on sender, receiver and the receiver's interrupt. */
void uart_start(void)
{
    UART->divisor = CLOCK / BAUD;
    NVIC_SET_ENABLE = RECEIVER_ENABLE_BIT;
    UART->control = ENABLE_SENDER | ENABLE_RECEIVER;
}

/* Take the oldest entry out of the queue, and return it: a byte, or PORT_LOST. Returns PORT_NOTHING if the
 * queue is empty. Enables the interrupt, which handle_first_interrupt() disables when there is no room. */
int port_get(void)
{
    if (entries_taken == entries_put) {
        return PORT_NOTHING;
    }
    const int entry = queue[entries_taken % QUEUE_SIZE];
    ++entries_taken; /* modulo 256; only now the interrupt may use the entry again */
    NVIC_SET_ENABLE = RECEIVER_ENABLE_BIT;
    return entry;
}

/* Sleep if the queue is empty. Interrupts are masked meanwhile, so that none can come between the check and
 * the sleep; a masked interrupt ends the sleep, too. */
void port_sleep(void)
{
    __asm__ volatile("cpsid i"); /* mask interrupts */
    if (entries_taken == entries_put) {
        __asm__ volatile("wfi"); /* wait for one */
    }
    __asm__ volatile("cpsie i"); /* and let it be handled */
}
