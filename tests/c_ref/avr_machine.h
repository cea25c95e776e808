/* A simulated ATmega328P that never sleeps, with an image in it. */
#ifndef AVR_MACHINE_H
#define AVR_MACHINE_H

#include <simavr/avr_adc.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>

#include <stdint.h>
#include <stdlib.h>

#define BLACK_MILLIVOLTS 1000
#define WHITE_MILLIVOLTS 4000

static void stay_awake(struct avr_t *machine, avr_cycle_count_t howlong)
{
    (void)machine;
    (void)howlong;
}

/* What its UART sends goes to `sent` with the parameter. Ends the program with 2 if there is no such image.
 */
static avr_t *make_machine(const char *image, uint32_t clock_rate, avr_irq_notify_t sent, void *parameter)
{
    elf_firmware_t firmware = {0};
    uint32_t flags = 0;
    avr_t *const avr = avr_make_mcu_by_name("atmega328p");
    if (avr == NULL || elf_read_firmware(image, &firmware) != 0) {
        exit(2);
    }
    avr_init(avr);
    avr_load_firmware(avr, &firmware);
    avr->frequency = clock_rate;
    avr->vcc = avr->avcc = 5000;
    avr->sleep = stay_awake;
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), sent, parameter);
    return avr;
}

/* One instruction; a robot never ends, so the end is a failure. */
static void run_instruction(avr_t *avr)
{
    const int state = avr_run(avr);
    if (state == cpu_Done || state == cpu_Crashed) {
        exit(1);
    }
}

#endif
