/* The robot of demo.c on Arm's MPS2 boards (Cortex-M3, Cortex-M4): the first button stands for the ground
 * sensor, SysTick counts the ticks, and a modem on the first UART is the radio. */
#include "../demo.h"
#include "../port.h"
#include "../radio.h"

#define CLOCK 25000000U
#define TICKS_PER_SECOND 10U

#define UART_DATA (*(volatile uint32_t *)0x40004000)
#define UART_STATE (*(volatile uint32_t *)0x40004004)
#define UART_CONTROL (*(volatile uint32_t *)0x40004008)
#define UART_INTERRUPT (*(volatile uint32_t *)0x4000400C)
#define BUTTONS (*(volatile uint32_t *)0x40028008)
#define SYSTICK_CONTROL (*(volatile uint32_t *)0xE000E010)
#define SYSTICK_RELOAD (*(volatile uint32_t *)0xE000E014)
#define INTERRUPTS_ENABLED (*(volatile uint32_t *)0xE000E100)
#define VECTORS (*(volatile uint32_t *)0xE000ED08)

#define RECEIVE 0xAU /* in UART_CONTROL: on, with an interrupt */
#define RECEIVED 2U  /* in UART_STATE and UART_INTERRUPT */
#define BEGUN 0x10000U

static void fault(void) { port_exit(1); }

/* The flag is cleared first, so that a byte that comes after the last look sets it again. */
static void received(void)
{
    UART_INTERRUPT = RECEIVED; /* cleared by writing 1 */
    while ((UART_STATE & RECEIVED) != 0) {
        radio_hear((uint8_t)UART_DATA);
    }
}

/* The start-up's table ends before the chip's own interrupts, of which the receiver's is the first. */
static void (*const vectors[17])(void)
    __attribute__((aligned(128))) = {fault, fault, fault, fault, fault, fault, fault, fault,   fault,
                                     fault, fault, fault, fault, fault, fault, fault, received};

void board_start(void)
{
    VECTORS = (uint32_t)(uintptr_t)vectors;
    INTERRUPTS_ENABLED = 1;
    UART_CONTROL |= RECEIVE;
    SYSTICK_RELOAD = CLOCK / TICKS_PER_SECOND - 1;
    SYSTICK_CONTROL = 5; /* the processor's clock, no interrupt */
}

/* Reading SysTick's flag clears it. */
bool board_tick(void) { return (SYSTICK_CONTROL & BEGUN) != 0; }

bool board_sees(mcp_asdf_observation_t *tile)
{
    *tile = (BUTTONS & 1) != 0 ? MCP_ASDF_BLACK : MCP_ASDF_WHITE;
    return true;
}
