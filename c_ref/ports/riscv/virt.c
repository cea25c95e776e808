/* QEMU's RISC-V board "virt": start, and exit by SiFive's test device. */
#include "../uart.h"

#include "../port.h"

#include <stdint.h>

/* Register of the test device: what is written to it ends the emulation. */
#define TEST (*(volatile uint32_t *)0x00100000)
#define TEST_PASS 0x5555 /* with status 0 */
#define TEST_FAIL 0x3333 /* with the status in the bits from STATUS_SHIFT on */
#define STATUS_SHIFT 16

int main(void);
void start(void);
void begin(void);
void fault(void);

/* Set by virt.ld. */
extern uint32_t bss_start[], bss_end[];

/* The first instructions: set global pointer, stack and trap handler, and go on with begin(). All memory is
 * RAM and holds the image, data included, so that nothing has to be copied. */
__attribute__((naked, section(".start"))) void start(void)
{
    __asm__(".option push\n"
            ".option norelax\n" /* else the linker may compute this address from gp itself */
            "la gp, global_pointer\n"
            ".option pop\n"
            "la sp, stack_top\n"
            "la t0, fault\n"
            ".4byte 0x30529073\n" /* csrw mtvec, t0: assemblers differ in the extension it needs */
            "j begin\n");
}

/* Initialise all variables that are 0, run the program, and end with its status. */
__attribute__((used)) void begin(void)
{
    for (uint32_t *to = bss_start; to < bss_end; ++to) {
        *to = 0;
    }
    uart_start();
    port_exit(main());
}

/* Trap handler: any exception ends the program. */
__attribute__((used, aligned(4))) void fault(void) { port_exit(1); }

/* End the emulation with a status. */
void port_exit(int status)
{
    const uint32_t failure = ((uint32_t)status << STATUS_SHIFT) | TEST_FAIL;
    TEST = status == 0 ? TEST_PASS : failure; /* the emulation ends here */
    for (;;) {
    }
}
