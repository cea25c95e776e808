"""Emulated processors: call a function of an image, and learn what the call cost."""

from __future__ import annotations

import ctypes
import re
import subprocess
import tempfile
from abc import ABC, abstractmethod
from functools import cache
from pathlib import Path
from typing import NamedTuple

from unicorn import (
    UC_ARCH_ARM,
    UC_ARCH_RISCV,
    UC_HOOK_BLOCK,
    UC_HOOK_CODE,
    UC_MODE_MCLASS,
    UC_MODE_RISCV32,
    UC_MODE_THUMB,
    UC_PROT_ALL,
    Uc,
    arm_const,
    riscv_const,
)

from .images import HERE, Image, Instruction

_IT = re.compile("it[te]{0,3}")
_PAINT = 0xA5
_PAINTED = 1024
_AVR_DATA = 0xFFFF
"""Bits of an AVR variable's address; the others mark it as data."""
_SIZES = {"pointer": 2, "enum": 2, "byte": 1, "word": 4}
"""Bytes of an argument on an AVR; elsewhere each has a register to itself."""


class Cost(NamedTuple):
    """Result of a call with its instructions, cycles (on an AVR only) and bytes of stack touched."""

    value: int
    instructions: int
    cycles: int
    stack: int


Argument = tuple[str, int]
"""Kind ("pointer", "enum", "byte" or "word") and value."""


class Machine(ABC):
    """A processor with an image loaded and its variables set up."""

    stack_end: int
    """The address behind the stack's first byte."""

    def __init__(self, image: Image) -> None:
        self.image = image

    def call(self, name: str, *arguments: Argument) -> Cost:
        """Call a function. Raises RuntimeError if it does not return."""
        self.write(self.stack_end - _PAINTED, bytes([_PAINT]) * _PAINTED)
        value, instructions, cycles = self._run(self.image.address(name), arguments)
        painted = self.read(self.stack_end - _PAINTED, _PAINTED)
        return Cost(value, instructions, cycles, len(painted.lstrip(bytes([_PAINT]))))

    @abstractmethod
    def read(self, address: int, size: int) -> bytes:
        """Bytes of variables."""

    @abstractmethod
    def write(self, address: int, content: bytes) -> None:
        """Set bytes of variables."""

    @abstractmethod
    def _run(self, address: int, arguments: tuple[Argument, ...]) -> tuple[int, int, int]:
        """Call what is at the address: its value, instructions and cycles."""


class UnicornMachine(Machine):
    """A Cortex-M or RV32 under Unicorn, which counts instructions.

    Whole blocks are counted, which is fast, but for the instructions that a condition may skip (Thumb-2 IT):
    of those each one is counted that runs.
    """

    stack_end, _RETURN, _END = 0x100000, 0x10F000, 0x110000

    def __init__(self, image: Image) -> None:
        super().__init__(image)
        self._arm = image.target.tools.startswith("arm")
        mode = UC_MODE_THUMB | UC_MODE_MCLASS
        self._uc = Uc(UC_ARCH_ARM, mode) if self._arm else Uc(UC_ARCH_RISCV, UC_MODE_RISCV32)
        self._uc.mem_map(0, self._END, UC_PROT_ALL)
        for address, _, content in image.segments():
            self._uc.mem_write(address, content)
        if not self._arm:
            self._uc.reg_write(riscv_const.UC_RISCV_REG_GP, image.address("__global_pointer$"))
        self._addresses, self._skippable = {line.address for line in image.code}, _skippable(image.code)
        self._blocks: dict[tuple[int, int], int] = {}
        self._count = 0
        self._uc.hook_add(UC_HOOK_BLOCK, self._block)
        for address in self._skippable:
            self._uc.hook_add(UC_HOOK_CODE, self._one, begin=address, end=address)

    def _block(self, _: Uc, address: int, size: int, __: object) -> None:
        key = address, size
        if key not in self._blocks:
            always = self._addresses - self._skippable
            self._blocks[key] = sum(at in always for at in range(address, address + size, 2))
        self._count += self._blocks[key]

    def _one(self, *_: object) -> None:
        self._count += 1

    def read(self, address: int, size: int) -> bytes:
        return bytes(self._uc.mem_read(address, size))

    def write(self, address: int, content: bytes) -> None:
        self._uc.mem_write(address, content)

    def _run(self, address: int, arguments: tuple[Argument, ...]) -> tuple[int, int, int]:
        thumb, uc = int(self._arm), self._uc
        first = arm_const.UC_ARM_REG_R0 if self._arm else riscv_const.UC_RISCV_REG_A0
        for register, (_, value) in enumerate(arguments, first):
            uc.reg_write(register, value)
        uc.reg_write(arm_const.UC_ARM_REG_SP if self._arm else riscv_const.UC_RISCV_REG_SP, self.stack_end)
        back = arm_const.UC_ARM_REG_LR if self._arm else riscv_const.UC_RISCV_REG_RA
        uc.reg_write(back, self._RETURN | thumb)
        self._count = 0
        uc.emu_start(address | thumb, self._RETURN)
        return int(uc.reg_read(first)), self._count, 0


def _skippable(code: list[Instruction]) -> set[int]:
    """Addresses of the instructions that an IT before them makes conditional: one to four."""
    return {
        line.address
        for number, before in enumerate(code)
        if _IT.fullmatch(before.name)
        for line in code[number + 1 : number + len(before.name)]
    }


@cache
def simavr() -> ctypes.CDLL:
    """simavr behind the few functions of avr_machine.c. Raises CalledProcessError without its headers."""
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "avr_machine.so"
        source = HERE / "avr_machine.c"
        subprocess.run(
            ["cc", "-O2", "-shared", "-fPIC", str(source), "-lsimavr", "-o", str(library)],
            check=True,
            capture_output=True,
        )
        loaded = ctypes.CDLL(str(library))
    loaded.machine_make.restype = ctypes.c_void_p
    for name in ("machine_data", "machine_flash"):
        getattr(loaded, name).restype = ctypes.c_void_p
        getattr(loaded, name).argtypes = [ctypes.c_void_p]
    count = ctypes.POINTER(ctypes.c_uint64)
    loaded.machine_run.argtypes = [ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32, count, count]
    return loaded


class AvrMachine(Machine):
    """An ATmega328P under simavr, which counts true cycles."""

    stack_end, _RETURN, _STACK_POINTER = 0x900, 0x7FFE, 0x5D

    def __init__(self, image: Image) -> None:
        super().__init__(image)
        self._library = simavr()
        self._avr = self._library.machine_make(b"atmega328p")
        memory = (ctypes.c_uint8 * self.stack_end).from_address(self._library.machine_data(self._avr))
        self._data = memoryview(memory).cast("B")
        flash = self._library.machine_flash(self._avr)
        for _, address, content in image.segments():
            ctypes.memmove(flash + address, content, len(content))
        self._go(0, image.address("main"))

    def read(self, address: int, size: int) -> bytes:
        start = address & _AVR_DATA
        return bytes(self._data[start : start + size])

    def write(self, address: int, content: bytes) -> None:
        start = address & _AVR_DATA
        self._data[start : start + len(content)] = content

    def _run(self, address: int, arguments: tuple[Argument, ...]) -> tuple[int, int, int]:
        register = 26
        for kind, value in arguments:
            size = _SIZES[kind]
            register -= size + size % 2
            self._store(register, value, size)
        self._data[self.stack_end - 2 :] = (self._RETURN // 2).to_bytes(2, "big")
        self._store(self._STACK_POINTER, self.stack_end - 3, 2)
        instructions, cycles = self._go(address, self._RETURN)
        return int.from_bytes(bytes(self._data[22:26]), "little"), instructions, cycles

    def _store(self, address: int, value: int, size: int) -> None:
        self.write(address, value.to_bytes(size, "little"))

    def _go(self, start: int, stop: int) -> tuple[int, int]:
        cycles, instructions = ctypes.c_uint64(), ctypes.c_uint64()
        if not self._library.machine_run(
            self._avr, start, stop, ctypes.byref(cycles), ctypes.byref(instructions)
        ):
            raise RuntimeError(f"the program crashed on its way from {start:#x} to {stop:#x}")
        return instructions.value, cycles.value


def load(image: Image) -> Machine:
    """The machine for the image's target."""
    return AvrMachine(image) if image.target.tools.startswith("avr") else UnicornMachine(image)
