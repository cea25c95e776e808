/* Start and end of a program on any Cortex-M: vector table, memory, exit through a debugger or emulator. */
#include "../uart.h"

#include "../port.h"

#include <stdint.h>

/* Set by cortex_m.ld. */
extern uint32_t stack_top[], data_image[], data_start[], data_end[], bss_start[], bss_end[];

int main(void);
void reset(void);

/* First function after a reset: initialise all variables, run the program, and end with its status. */
void reset(void)
{
    const uint32_t *from = data_image; /* in flash: the values that variables begin with */
    for (uint32_t *to = data_start; to < data_end; ++to) {
        *to = *from++;
    }
    for (uint32_t *to = bss_start; to < bss_end; ++to) {
        *to = 0;
    }
    uart_start();
    port_exit(main());
}

/* Any exception ends the program. */
static void fault(void) { port_exit(1); }

/* A serial line with an interrupt of its own has another function of this name, which takes precedence. */
__attribute__((weak)) void handle_first_interrupt(void) { port_exit(1); }

/* The vector table, from which the processor reads its stack, its first instruction, and what handles its own
 * 14 exceptions and the first interrupt of the chip. */
typedef struct {
    uint32_t *stack;
    void (*handlers[16])(void);
} vectors_t;

extern const vectors_t vectors __attribute__((section(".vectors")));
const vectors_t vectors = {
    stack_top,
    {reset, fault, fault, fault, fault, fault, fault, fault, fault, fault, fault, fault, fault, fault, fault,
     handle_first_interrupt},
};

/* End the program by a call of the debugger: semihosting's SYS_EXIT_EXTENDED (0x20) with the reason
 * "application exit" (0x20026) and the status. */
__attribute__((naked)) void port_exit(int status __attribute__((unused))) /* in r0 */
{
    __asm__("mov r2, r0\n"       /* the status */
            "ldr r1, =0x20026\n" /* the reason */
            "push {r1, r2}\n"    /* a block of both, in this order, on the stack */
            "mov r1, sp\n"       /* its address */
            "movs r0, #0x20\n"   /* the number of the call */
            "bkpt 0xAB\n"        /* semihosting calls are this breakpoint */
            "b .\n");            /* if there is no debugger, stay here for ever */
}
