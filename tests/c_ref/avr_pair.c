/* Two simulated ATmega328P that hear each other's UART, the second one started half a round after the first.
 * Usage: avr_pair IMAGE ROUND TILES FILE TILES FILE, where ROUND is in clock cycles, TILES has a 0 (white) or
 * 1 (black) for each of a robot's rounds, and FILE takes all that it sends. Pins of port B are its id. */
#include "avr_machine.h"

#include <simavr/avr_ioport.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>

typedef struct robot {
    avr_t *avr;
    FILE *said;
    const char *tiles;
    avr_cycle_count_t start;
    size_t seen;
    struct robot *other;
} robot_t;

static void sent(struct avr_irq_t *irq, uint32_t byte, void *parameter)
{
    const robot_t *const robot = parameter, *const other = robot->other;
    (void)irq;
    (void)fputc((int)byte, robot->said);
    if (robot->avr->cycle + robot->start > other->start) {
        avr_raise_irq(avr_io_getirq(other->avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT), byte);
    }
}

static void make(robot_t *robot, const char *image, uint32_t id)
{
    if (robot->said == NULL) {
        exit(2);
    }
    robot->avr = make_machine(image, 8000000, sent, robot);
    for (int pin = 0; pin < 8; ++pin) {
        avr_raise_irq(avr_io_getirq(robot->avr, AVR_IOCTL_IOPORT_GETIRQ('B'), pin), id >> pin & 1);
    }
}

/* One instruction; the tile of a round is under the robot from half a round before it looks. */
static bool step(robot_t *robot, avr_cycle_count_t round)
{
    const size_t now = (size_t)((robot->avr->cycle + round / 2) / round);
    if (now != robot->seen) {
        if (now > strlen(robot->tiles)) {
            return false;
        }
        robot->seen = now;
        avr_raise_irq(avr_io_getirq(robot->avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC0),
                      robot->tiles[now - 1] == '1' ? BLACK_MILLIVOLTS : WHITE_MILLIVOLTS);
    }
    run_instruction(robot->avr);
    return true;
}

int main(int count, char **arguments)
{
    if (count != 7) {
        return 2;
    }
    const avr_cycle_count_t round = strtoul(arguments[2], NULL, 10);
    robot_t robots[2] = {{.tiles = arguments[3], .said = fopen(arguments[4], "wb"), .other = &robots[1]},
                         {.tiles = arguments[5], .said = fopen(arguments[6], "wb"), .other = &robots[0]}};
    robots[1].start = round / 2;
    make(&robots[0], arguments[1], 5);
    make(&robots[1], arguments[1], 6);
    robot_t *behind = robots;
    while (step(behind, round)) {
        const bool is_first = robots[0].avr->cycle <= robots[1].avr->cycle + robots[1].start;
        behind = &robots[is_first ? 0 : 1];
    }
    return fclose(robots[0].said) == 0 && fclose(robots[1].said) == 0 ? 0 : 3;
}
