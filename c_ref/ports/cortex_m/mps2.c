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

#define NO_ROOM 1U   /* in state */
#define LOST 8U      /* cleared by writing 1 */
#define SEND 1U      /* in control */
#define RECEIVE 0xAU /* with an interrupt */
#define RECEIVER 2U  /* in interrupt: cleared by writing 1 */
#define KEPT 128U    /* bytes in the queue: a power of two */

#define UART ((volatile uart_t *)0x40004000)
#define INTERRUPTS_ON (*(volatile uint32_t *)0xE000E100) /* bits that are 0 do nothing */
#define INTERRUPTS_OFF (*(volatile uint32_t *)0xE000E180)
#define VECTORS (*(volatile uint32_t *)0xE000ED08)

/* The queue from interrupt to program. Each side writes only its own count; counts go around at 256. */
static volatile int16_t queue[KEPT];
static volatile uint8_t filled, emptied;

bool port_has_room(void) { return (UART->state & NO_ROOM) == 0; }

void port_put(char byte)
{
    while (!port_has_room()) {
    }
    UART->data = (uint8_t)byte;
}

/* While the queue is full, bytes stay in the UART. It keeps one, and then says that it has lost some. */
static void received(void)
{
    if ((uint8_t)(filled - emptied) > KEPT - 2) {
        INTERRUPTS_OFF = 1;
        return;
    }
    UART->interrupt = RECEIVER;
    if ((UART->state & LOST) != 0) {
        UART->state = LOST;
        queue[filled++ % KEPT] = PORT_LOST;
    }
    queue[filled++ % KEPT] = (uint8_t)UART->data;
}

static void fault(void) { port_exit(1); }

/* The start-up's table ends before the chip's own interrupts. */
typedef void (*handler_t)(void);
static const handler_t vectors[] __attribute__((aligned(128))) = {
    fault, fault, fault, fault, fault, fault, fault, fault,    fault,
    fault, fault, fault, fault, fault, fault, fault, received,
};

void uart_start(void)
{
    UART->divisor = CLOCK / BAUD;
    VECTORS = (uint32_t)(uintptr_t)vectors;
    INTERRUPTS_ON = 1;
    UART->control = SEND | RECEIVE;
}

int port_get(void)
{
    if (emptied == filled) {
        return PORT_NOTHING;
    }
    const int byte = queue[emptied++ % KEPT];
    INTERRUPTS_ON = 1;
    return byte;
}

/* A byte that comes after the look at the queue wakes the processor, too: masked interrupts do. */
void port_sleep(void)
{
    __asm__ volatile("cpsid i");
    if (emptied == filled) {
        __asm__ volatile("wfi");
    }
    __asm__ volatile("cpsie i");
}
