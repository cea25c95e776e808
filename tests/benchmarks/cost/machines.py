"""Emulated processors: call a function of an image, and learn what the call cost."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

from unicorn import (
    UC_ARCH_ARM,
    UC_ARCH_RISCV,
    UC_HOOK_CODE,
    UC_MODE_MCLASS,
    UC_MODE_RISCV32,
    UC_MODE_THUMB,
    UC_PROT_ALL,
    Uc,
    arm_const,
    riscv_const,
)

from simulated_avr import Board

from .images import Image

_PAINT = b"\xa5"
_PAINTED = 1024


class Cost(NamedTuple):
    """Result of a call with its instructions, cycles (on an AVR only) and bytes of stack touched."""

    value: int
    instructions: int
    cycles: int
    stack: int


Argument = tuple[int, int]
"""Value, and how many bytes it has on an AVR; elsewhere each has a register to itself."""


class Machine(ABC):
    """A processor with an image loaded and its variables set up.

    Attributes:
        image: What is loaded.
        stack_end: The address behind the stack's first byte.
    """

    stack_end: int

    def __init__(self, image: Image) -> None:
        self.image = image

    def call(self, name: str, *arguments: Argument) -> Cost:
        """Call a function. Raises an error if it does not return."""
        self.write(self.stack_end - _PAINTED, _PAINT * _PAINTED)
        value, instructions, cycles = self._run(self.image.address(name), arguments)
        painted = self.read(self.stack_end - _PAINTED, _PAINTED)
        return Cost(value, instructions, cycles, len(painted.lstrip(_PAINT)))

    @abstractmethod
    def read(self, address: int, size: int) -> bytes:
        """Return some bytes of RAM."""

    @abstractmethod
    def write(self, address: int, content: bytes) -> None:
        """Set bytes of RAM."""

    @abstractmethod
    def _run(self, address: int, arguments: tuple[Argument, ...]) -> tuple[int, int, int]:
        """Call what is at the address: its value, instructions and cycles."""


class UnicornMachine(Machine):
    """A Cortex-M or RV32 under Unicorn, which counts instructions, without those that a condition skips."""

    stack_end, _RETURN, _END = 0x100000, 0x10F000, 0x110000

    def __init__(self, image: Image) -> None:
        super().__init__(image)
        self._arm = image.target.tools.startswith("arm")
        mode = UC_MODE_THUMB | UC_MODE_MCLASS
        self._uc = Uc(UC_ARCH_ARM, mode) if self._arm else Uc(UC_ARCH_RISCV, UC_MODE_RISCV32)
        self._uc.mem_map(0, self._END, UC_PROT_ALL)
        for address, content in image.segments():
            self._uc.mem_write(address, content)
        if not self._arm:
            self._uc.reg_write(riscv_const.UC_RISCV_REG_GP, image.address("__global_pointer$"))
        self._count = 0
        self._uc.hook_add(UC_HOOK_CODE, self._count_instruction)

    def _count_instruction(self, *_: object) -> None:
        self._count += 1

    def read(self, address: int, size: int) -> bytes:
        return bytes(self._uc.mem_read(address, size))

    def write(self, address: int, content: bytes) -> None:
        self._uc.mem_write(address, content)

    def _run(self, address: int, arguments: tuple[Argument, ...]) -> tuple[int, int, int]:
        if self._arm:
            first_argument, stack_pointer = arm_const.UC_ARM_REG_R0, arm_const.UC_ARM_REG_SP
            return_address = arm_const.UC_ARM_REG_LR
        else:
            first_argument, stack_pointer = riscv_const.UC_RISCV_REG_A0, riscv_const.UC_RISCV_REG_SP
            return_address = riscv_const.UC_RISCV_REG_RA
        thumb_bit = int(self._arm)  # addresses of Thumb code are odd
        for register, (value, _size) in enumerate(arguments, first_argument):
            self._uc.reg_write(register, value)
        self._uc.reg_write(stack_pointer, self.stack_end)
        self._uc.reg_write(return_address, self._RETURN | thumb_bit)
        self._count = 0
        self._uc.emu_start(address | thumb_bit, self._RETURN)
        result = int(self._uc.reg_read(first_argument))
        cycles = 0  # not known
        return result, self._count, cycles


class AvrMachine(Machine):
    """An ATmega328P under simavr, which counts true cycles."""

    stack_end, _RETURN, _STACK_POINTER, _DATA = 0x900, 0x7FFE, 0x5D, 0xFFFF
    """_DATA: bits of a variable's address; the others mark it as data."""

    def __init__(self, image: Image) -> None:
        super().__init__(image)
        self._board = Board(image.path, 16_000_000, str)
        self._board.call(0, image.address("main"))

    def read(self, address: int, size: int) -> bytes:
        start = address & self._DATA
        return bytes(self._board.registers[start : start + size])

    def write(self, address: int, content: bytes) -> None:
        start = address & self._DATA
        self._board.registers[start : start + len(content)] = content

    def _run(self, address: int, arguments: tuple[Argument, ...]) -> tuple[int, int, int]:
        # avr-gcc passes arguments from r25 down, each in an even number of registers.
        register = 26
        for value, size in arguments:
            register -= size + size % 2
            self.write(register, value.to_bytes(size, "little"))
        self.write(self.stack_end - 2, (self._RETURN // 2).to_bytes(2, "big"))
        self.write(self._STACK_POINTER, (self.stack_end - 3).to_bytes(2, "little"))
        first_cycle = self._board.cycle
        instructions = self._board.call(address, self._RETURN)
        result = int.from_bytes(self.read(22, 4), "little")  # r22 to r25
        return result, instructions, self._board.cycle - first_cycle


def load(image: Image) -> Machine:
    """Return the machine for the image's target."""
    return AvrMachine(image) if image.target.tools.startswith("avr") else UnicornMachine(image)
