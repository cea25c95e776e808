"""A simulated ATmega328P: simavr through cffi, with what a robot's board has at its pins."""

from __future__ import annotations

import sysconfig
import tempfile
from collections.abc import Callable
from functools import cache
from importlib.machinery import ExtensionFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from typing import Any

import pytest
from cffi import FFI

from support import run

BLACK_MILLIVOLTS, WHITE_MILLIVOLTS = 1000, 4000
"""Voltage of the sensor above a tile."""
_C = """
#include <simavr/avr_adc.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_core.h>
#include <simavr/sim_elf.h>

static void on_sent_byte(void *board, uint8_t byte);
static void on_uart_output(avr_irq_t *irq, uint32_t byte, void *board)
{
    (void)irq;
    on_sent_byte(board, (uint8_t)byte);
}
static void stay_awake(avr_t *avr, avr_cycle_count_t cycles) { (void)avr; (void)cycles; }

static avr_t *make_avr(const char *image, uint32_t clock, void *board)
{
    elf_firmware_t firmware = {0};
    uint32_t flags = 0;
    avr_t *const avr = avr_make_mcu_by_name("atmega328p");
    if (elf_read_firmware(image, &firmware) != 0) {
        return NULL;
    }
    avr_init(avr);
    avr_load_firmware(avr, &firmware);
    avr->frequency = clock;
    avr->vcc = avr->avcc = 5000;
    avr->sleep = stay_awake;
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    avr_irq_register_notify(
        avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_uart_output, board);
    return avr;
}

static void receive_byte(avr_t *avr, uint8_t byte)
{
    avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT), byte);
}

static void set_sensor_voltage(avr_t *avr, uint32_t millivolts)
{
    avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC0), millivolts);
}

static int run_until(avr_t *avr, uint64_t cycle)
{
    int state = cpu_Running;
    while (avr->cycle < cycle && state != cpu_Done && state != cpu_Crashed) {
        state = avr_run(avr);
    }
    return state != cpu_Done && state != cpu_Crashed;
}

static uint64_t call(avr_t *avr, uint32_t from, uint32_t to)
{
    uint64_t instructions = 0;
    avr->state = cpu_Running;
    for (avr->pc = from; avr->pc != to && avr->state == cpu_Running; ++instructions) {
        avr->pc = avr_run_one(avr);
    }
    return avr->state == cpu_Running ? instructions : 0;
}
"""
_DECLARED = """
typedef struct { uint8_t *data; uint64_t cycle; ...; } avr_t;
extern "Python" void on_sent_byte(void *board, uint8_t byte);
avr_t *make_avr(const char *image, uint32_t clock, void *board);
void receive_byte(avr_t *avr, uint8_t byte);
void set_sensor_voltage(avr_t *avr, uint32_t millivolts);
int run_until(avr_t *avr, uint64_t cycle);
uint64_t call(avr_t *avr, uint32_t from, uint32_t to);
"""


@cache
def _simavr() -> tuple[FFI, Any]:
    """Compile the board as a Python extension, and return its ``ffi`` and ``lib``."""
    ffi = FFI()
    ffi.cdef(_DECLARED)
    ffi.set_source("avr_board", _C)
    with tempfile.TemporaryDirectory() as folder:
        source, library = Path(folder, "avr_board.c"), Path(folder, "avr_board.so")
        ffi.emit_c_code(str(source))
        # Not by ffi.compile, which needs setuptools from Python 3.12 on.
        include = f"-I{sysconfig.get_path('include')}"
        run("cc", "-shared", "-fPIC", "-O2", include, source, "-lsimavr", "-o", library)
        loader = ExtensionFileLoader("avr_board", str(library))
        spec = spec_from_loader(loader.name, loader)
        assert spec
        module = module_from_spec(spec)
    module.ffi.def_extern("on_sent_byte")(lambda board, byte: module.ffi.from_handle(board)(byte))
    return module.ffi, module.lib


def require_simavr() -> None:
    """Skip the test where the library simavr is missing."""
    if not Path("/usr/include/simavr/sim_avr.h").exists():
        pytest.skip("no simavr library: apt-get install libsimavr-dev")


class Board:
    """A robot's board with a simulated ATmega328P, which has an image in its flash and never sleeps.

    Attributes:
        registers: The data space: registers, ports and RAM, by their addresses.
    """

    def __init__(self, image: Path, clock: int, on_sent_byte: Callable[[int], object]) -> None:
        """Load an image into the flash.

        Args:
            image: ELF file of the program.
            clock: Frequency of the chip, in Hz.
            on_sent_byte: Called with each byte that the UART sends.
        """
        ffi, self._simavr = _simavr()
        self._on_sent_byte = ffi.new_handle(on_sent_byte)  # C has only a pointer to it
        self._avr = self._simavr.make_avr(str(image).encode(), clock, self._on_sent_byte)
        self.registers = ffi.buffer(self._avr.data, 0x900)

    @property
    def cycle(self) -> int:
        """Clock cycles since the reset."""
        return int(self._avr.cycle)

    def receive_byte(self, byte: int) -> None:
        """Let the UART receive a byte."""
        self._simavr.receive_byte(self._avr, byte)

    def place_on_tile(self, tile: int) -> None:
        """Put the sensor above a tile, which is black if ``tile`` is 1 and else white."""
        self._simavr.set_sensor_voltage(self._avr, BLACK_MILLIVOLTS if tile == 1 else WHITE_MILLIVOLTS)

    def run_until(self, cycle: int) -> None:
        """Run the program until a clock cycle. Fails if it ends before, which no robot does."""
        assert self._simavr.run_until(self._avr, cycle), "the program has ended"

    def call(self, start: int, stop: int) -> int:
        """Run from one byte address until another is reached, and return the number of instructions.

        Raises RuntimeError if the program crashes.
        """
        instructions = int(self._simavr.call(self._avr, start, stop))
        if instructions == 0:
            raise RuntimeError(f"the program crashed on its way from {start:#x} to {stop:#x}")
        return instructions
