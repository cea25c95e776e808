/* simavr as a library of few functions: run code from one address to another and tell cycles and
 * instructions.
 */
#include <simavr/sim_avr.h>
#include <simavr/sim_core.h>

#include <stdint.h>

avr_t *machine_make(const char *chip);
uint8_t *machine_data(avr_t *avr);
uint8_t *machine_flash(avr_t *avr);
int machine_run(avr_t *avr, uint32_t from, uint32_t to, uint64_t *cycles, uint64_t *instructions);

/* A chip of that name without a program; null if simavr knows none. */
avr_t *machine_make(const char *chip)
{
    avr_t *const avr = avr_make_mcu_by_name(chip);
    if (avr != 0) {
        avr_init(avr);
    }
    return avr;
}

/* Registers, ports and RAM at the addresses that load and store instructions use. */
uint8_t *machine_data(avr_t *avr) { return avr->data; }

uint8_t *machine_flash(avr_t *avr) { return avr->flash; }

/* Run from byte address `from` until `to` is reached; false if the program crashes or ends before. */
int machine_run(avr_t *avr, uint32_t from, uint32_t to, uint64_t *cycles, uint64_t *instructions)
{
    const uint64_t start = avr->cycle;
    *instructions = 0;
    avr->state = cpu_Running;
    for (avr->pc = from; avr->pc != to && avr->state == cpu_Running; ++*instructions) {
        avr->pc = avr_run_one(avr);
    }
    *cycles = avr->cycle - start;
    return avr->state == cpu_Running;
}
