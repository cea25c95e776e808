"""The image for Cortex-M3 on a serial line that does not wait: bytes come at a steady pace or are lost.

A line under QEMU waits until the program takes a byte; real ones do not. Here an emulator of the processor
alone (Unicorn) meets a model of the board's UART that keeps one byte: what comes while that is there takes
its place, and the overrun flag says so. Time is counted in instructions of the program, interrupts apart.
"""

from __future__ import annotations

from collections.abc import Container
from pathlib import Path
from typing import Any

from elftools.elf.elffile import ELFFile
from unicorn import UC_ARCH_ARM, UC_MODE_MCLASS, UC_MODE_THUMB, Uc
from unicorn.arm_const import UC_ARM_REG_LR, UC_ARM_REG_PC, UC_ARM_REG_PRIMASK, UC_ARM_REG_SP

_FLASH, _RAM, _UART, _SYSTEM = 0, 0x2000_0000, 0x4000_4000, 0xE000_E000
_DATA, _STATE, _CONTROL, _INTERRUPT = 0, 4, 8, 12
_RECEIVED, _OVERRUN, _WITH_INTERRUPT, _RECEIVER = 2, 8, 8, 2
_ENABLE, _DISABLE, _VECTORS = 0x100, 0x180, 0xD08
_VECTOR_OF_RECEIVER = 16
_PAGE = 0x1000
_RETURN = 0x3_F000
"""Where interrupts return to: an address in flash at which no program is."""
_WAIT_FOR_INTERRUPT = b"\x30\xbf"


class SlowLine:
    """The board with an image, asleep. What the program sends is taken at once.

    Attributes:
        sent: Bytes that the program has sent and that were not yet asked for.
    """

    def __init__(self, image: Path) -> None:
        """Switch the board on and let the program begin."""
        self.sent = b""
        self._registers = dict.fromkeys((_UART + _STATE, _UART + _CONTROL, _UART + _INTERRUPT), 0)
        self._byte, self._is_enabled = 0, False
        self._cpu: Any = Uc(UC_ARCH_ARM, UC_MODE_THUMB | UC_MODE_MCLASS)
        self._cpu.mem_map(_FLASH, 1 << 18)
        self._cpu.mem_map(_RAM, 1 << 14)
        for base in (_UART, _SYSTEM):
            self._cpu.mmio_map(base, _PAGE, self._read, base, self._write, base)
        with image.open("rb") as stream:
            for segment in ELFFile(stream).iter_segments("PT_LOAD"):
                self._cpu.mem_write(segment["p_paddr"], segment.data())
        self._cpu.reg_write(UC_ARM_REG_SP, self._word(0))
        self._cpu.reg_write(UC_ARM_REG_PC, self._word(4))
        self.wait()

    def say(self, text: bytes, pace: int, late: Container[int] = ()) -> bytes:
        """Let ``text`` come, a byte every ``pace`` instructions; returns what the program sends.

        The interrupt of a byte whose number is in ``late`` is served only when the next has come, too.
        """
        for number, byte in enumerate(text):
            self._arrive(byte)
            if number not in late:
                self._interrupt()
            self._run(pace)
            if number not in late:
                self._interrupt()
        self.wait()
        sent, self.sent = self.sent, b""
        return sent

    def wait(self) -> None:
        """Let the program run until it sleeps."""
        while not self._is_asleep():
            self._run(1000)
            self._interrupt()

    def _run(self, instructions: int) -> None:
        """Run so long, or until the program sleeps."""
        at = self._cpu.reg_read(UC_ARM_REG_PC)
        self._cpu.emu_start(at | 1, _RETURN, count=instructions)

    def _is_asleep(self) -> bool:
        before = self._cpu.reg_read(UC_ARM_REG_PC) - len(_WAIT_FOR_INTERRUPT)
        return bytes(self._cpu.mem_read(before, len(_WAIT_FOR_INTERRUPT))) == _WAIT_FOR_INTERRUPT

    def _arrive(self, byte: int) -> None:
        state = self._registers[_UART + _STATE]
        self._registers[_UART + _STATE] = state | (_OVERRUN if state & _RECEIVED else _RECEIVED)
        if self._registers[_UART + _CONTROL] & _WITH_INTERRUPT:
            self._registers[_UART + _INTERRUPT] |= _RECEIVER
        self._byte = byte

    def _interrupt(self) -> None:
        """Call the receiver's handler, if it is its turn, as soon as the program lets it."""
        if not (self._registers[_UART + _INTERRUPT] and self._is_enabled):
            return
        while self._cpu.reg_read(UC_ARM_REG_PRIMASK):
            self._run(1)
        before = self._cpu.context_save()
        self._cpu.reg_write(UC_ARM_REG_LR, _RETURN | 1)
        handler = self._word(self._registers[_SYSTEM + _VECTORS] + 4 * _VECTOR_OF_RECEIVER)
        self._cpu.emu_start(handler, _RETURN)
        assert self._cpu.reg_read(UC_ARM_REG_PC) == _RETURN
        assert not (self._registers[_UART + _INTERRUPT] and self._is_enabled), "it would come again at once"
        self._cpu.context_restore(before)

    def _read(self, _: object, offset: int, size: int, base: int) -> int:
        if base + offset == _UART + _DATA:
            self._registers[_UART + _STATE] &= ~_RECEIVED
            return self._byte
        return self._registers.get(base + offset, 0)

    def _write(self, _: object, offset: int, size: int, value: int, base: int) -> None:
        if base + offset == _UART + _DATA:
            self.sent += bytes([value & 0xFF])
        elif base + offset in (_UART + _STATE, _UART + _INTERRUPT):
            self._registers[base + offset] &= ~value  # bits are cleared by writing 1
        elif base + offset in (_SYSTEM + _ENABLE, _SYSTEM + _DISABLE):
            if value & 1:
                self._is_enabled = offset == _ENABLE
        else:
            self._registers[base + offset] = value

    def _word(self, address: int) -> int:
        return int.from_bytes(self._cpu.mem_read(address, 4), "little")
