/* Plays a script (scripted_board.c has the format) to a robot's image on a simulated ATmega328P, as its
 * hardware would: tiles as voltages at ADC0, bytes of the radio on the UART, ticks by the chip's own timer.
 * What the UART sends goes to a file. Usage: avr_robot IMAGE FILE CLOCK BAUD < SCRIPT
 * Exits with 3 if the UART was set to a speed that is 2.5 % off. */
#include "avr_machine.h"

#include <stdbool.h>
#include <stdio.h>

#define UART_STATE 0xC0
#define DOUBLE_SPEED 2
#define UART_DIVISOR 0xC4 /* and its high byte behind it */

static uint32_t clock_rate, baud; /* Hz, bit/s */
static avr_t *avr;
static FILE *output;

static void run_until(avr_cycle_count_t cycle)
{
    while (avr->cycle < cycle) {
        run_instruction(avr);
    }
}

static void sent(struct avr_irq_t *irq, uint32_t value, void *parameter)
{
    (void)irq;
    (void)parameter;
    (void)fputc((int)value, output);
}

static bool has_right_speed(void)
{
    const uint32_t divisor = (uint32_t)avr->data[UART_DIVISOR] + 256U * avr->data[UART_DIVISOR + 1] + 1;
    const uint32_t made = clock_rate / ((avr->data[UART_STATE] & DOUBLE_SPEED) != 0 ? 8 : 16) / divisor;
    return labs((long)made - (long)baud) * 40 <= (long)baud;
}

int main(int count, char **arguments)
{
    output = count == 5 ? fopen(arguments[2], "wb") : NULL;
    if (output == NULL) {
        return 2;
    }
    clock_rate = (uint32_t)strtoul(arguments[3], NULL, 10);
    baud = (uint32_t)strtoul(arguments[4], NULL, 10);
    avr = make_machine(arguments[1], clock_rate, sent, NULL);
    const avr_cycle_count_t tick_length = clock_rate / 10, byte_length = clock_rate / (baud / 10);
    avr_irq_t *const radio = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    avr_irq_t *const sensor = avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC0);
    avr_cycle_count_t now = tick_length / 2; /* half a tick away from the robot's */
    run_until(now);
    for (int byte = getchar(); byte != EOF; byte = getchar()) {
        for (int left = byte - 2; left > 0; --left) {
            avr_raise_irq(radio, (uint32_t)getchar());
            run_until(avr->cycle + byte_length);
        }
        if (byte <= 1) {
            avr_raise_irq(sensor, byte == 1 ? BLACK_MILLIVOLTS : WHITE_MILLIVOLTS);
            run_until(now += tick_length);
        }
    }
    return fclose(output) == 0 && has_right_speed() ? 0 : 3;
}
