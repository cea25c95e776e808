"""The ports' start-up code gives all variables their values before main().

An emulated board has zeros in its RAM when it is switched on; a real board has anything. So here the
processor alone is emulated, with RAM that is full of other bytes.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from elftools.elf.constants import SH_FLAGS
from elftools.elf.elffile import ELFFile
from elftools.elf.sections import SymbolTableSection

from support import ROOT, require, run, slow

unicorn: Any = pytest.importorskip("unicorn", reason="unicorn is not installed: make setup")

PORTS = ROOT / "c_ref/ports"
OTHER_BYTE = b"\xa5"
"""The byte of which RAM is full before the start."""
MAX_INSTRUCTIONS = 100_000
REGISTERS_OF_ARM = (unicorn.arm_const.UC_ARM_REG_SP, unicorn.arm_const.UC_ARM_REG_PC)
REGISTERS_OF_RISCV = (unicorn.riscv_const.UC_RISCV_REG_SP, unicorn.riscv_const.UC_RISCV_REG_PC)
"""The stack pointer and the program counter, by Unicorn's numbers."""

PROGRAM = """
unsigned char first_byte = 1; /* so that the words behind it need not be at the start of .data */
unsigned int words[3] = {0x11223344, 2, 3};
unsigned char last_byte = 4;
unsigned int zero_words[5];
unsigned char zero_byte;
int main(void);
int main(void) { return 0; }
"""


@dataclass(frozen=True)
class Board:
    """A board whose start-up code is a port of this project.

    Attributes:
        name: Of the board.
        compiler: With the flags that choose the processor.
        packages: Debian packages that have the compiler.
        script: The linker script.
        sources: The port.
        memories: First address and size of RAM, and of what else the port uses: flash, and registers.
    """

    name: str
    compiler: tuple[str, ...]
    packages: str
    script: str
    sources: tuple[str, ...]
    memories: dict[str, tuple[int, int]]

    @property
    def is_arm(self) -> bool:
        return self.compiler[0].startswith("arm")


CORTEX_M_MEMORIES = {
    "ram": (0x20000000, 0x4000),
    "flash": (0, 0x40000),
    "registers of the chip": (0x40000000, 0x10000),
    "registers of the processor": (0xE000E000, 0x1000),
}
BOARDS = (
    Board(
        name="micro:bit",
        compiler=("arm-none-eabi-gcc", "-mcpu=cortex-m0", "-mthumb"),
        packages="gcc-arm-none-eabi",
        script="cortex_m/cortex_m.ld",
        sources=("cortex_m/start.c", "cortex_m/nrf51.c", "memory.c"),
        memories=CORTEX_M_MEMORIES,
    ),
    Board(
        name="MPS2",
        compiler=("arm-none-eabi-gcc", "-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=soft"),
        packages="gcc-arm-none-eabi",
        script="cortex_m/cortex_m.ld",
        sources=("cortex_m/start.c", "cortex_m/mps2.c", "memory.c"),
        memories=CORTEX_M_MEMORIES,
    ),
    Board(
        name="virt",
        compiler=("riscv64-unknown-elf-gcc", "-march=rv32imc", "-mabi=ilp32", "-mcmodel=medany"),
        packages="gcc-riscv64-unknown-elf",
        script="riscv/virt.ld",
        sources=("riscv/virt.c", "riscv/virt_uart.c", "memory.c"),
        memories={
            "ram": (0x80000000, 0x80000),
            "serial line": (0x10000000, 0x1000),
            "interrupt controller": (0x0C000000, 0x400000),
        },
    ),
)


def build(board: Board, level: str, folder: Path) -> Path:
    """Build the program for a board, with the port's start-up code; returns the image."""
    compiler, *processor_flags = board.compiler
    (folder / "program.c").write_text(PROGRAM)
    flags = ["-std=c99", level, "-ffreestanding", "-nostdlib", f"-T{PORTS / board.script}", f"-I{PORTS}"]
    sources = [PORTS / source for source in board.sources]
    image = folder / "program.elf"
    require(compiler, board.packages)
    run(compiler, *processor_flags, *flags, *sources, folder / "program.c", "-lgcc", "-o", image)
    return image


def address_of(elf: ELFFile, name: str) -> int:
    """Return the address of a function or variable, without the bit that marks Thumb code."""
    table = elf.get_section_by_name(".symtab")
    assert isinstance(table, SymbolTableSection)
    symbols = table.get_symbol_by_name(name)
    assert symbols is not None and len(symbols) == 1
    return int(symbols[0]["st_value"]) & ~1


def run_to_main(board: Board, elf: ELFFile) -> Any:
    """Load an image over RAM that is full of other bytes, and run it from the reset up to main().

    Returns Unicorn's processor. Fails if main() is not reached, or if its stack is not at the end of RAM.
    """
    processor = make_processor(board)
    stack_pointer, program_counter = REGISTERS_OF_ARM if board.is_arm else REGISTERS_OF_RISCV
    load_image(processor, board, elf)
    entry = elf["e_entry"]
    if board.is_arm:  # which reads two addresses from the vector table: its stack and its first instruction
        processor.reg_write(stack_pointer, word_at(processor, 0))
        entry = word_at(processor, 4)
    main_address = address_of(elf, "main")
    processor.emu_start(entry, main_address, count=MAX_INSTRUCTIONS)
    assert processor.reg_read(program_counter) == main_address, "main() is not reached"
    ram_address, ram_size = board.memories["ram"]
    used_stack = ram_address + ram_size - processor.reg_read(stack_pointer)
    assert 0 <= used_stack < 64, "bytes: no more than a few registers that the start-up code has saved"
    return processor


def make_processor(board: Board) -> Any:
    """Return Unicorn's processor of a board, with all its memories."""
    if board.is_arm:
        processor = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
    else:
        processor = unicorn.Uc(unicorn.UC_ARCH_RISCV, unicorn.UC_MODE_RISCV32)
    for address, size in board.memories.values():
        processor.mem_map(address, size)
    return processor


def load_image(processor: Any, board: Board, elf: ELFFile) -> None:
    """Fill RAM with other bytes, and write the segments of an image over them and into flash."""
    ram_address, ram_size = board.memories["ram"]
    processor.mem_write(ram_address, OTHER_BYTE * ram_size)
    for segment in elf.iter_segments("PT_LOAD"):
        processor.mem_write(segment["p_paddr"], segment.data())


def word_at(processor: Any, address: int) -> int:
    """Return the little-endian word of 32 bits at an address."""
    return int.from_bytes(processor.mem_read(address, 4), "little")


def sections_of_variables(elf: ELFFile) -> dict[str, Any]:
    """Return the sections of an image that have variables, by name."""
    return {
        section.name: section
        for section in elf.iter_sections()
        if section["sh_flags"] & SH_FLAGS.SHF_WRITE and section["sh_size"] > 0
    }


@pytest.mark.parametrize("level", ["-Os", *slow(["-O0", "-O3"])])
@pytest.mark.parametrize("board", BOARDS, ids=lambda board: board.name)
def test_variables_have_their_values_when_main_starts(board: Board, level: str, tmp_path: Path) -> None:
    """The program has two sections of variables: one for values other than 0, one for 0.

    The port's start-up code, on an emulated processor, writes both before main(), over any content of RAM.
    ``level`` is how the compiler optimises.
    """
    with build(board, level, tmp_path).open("rb") as stream:
        elf = ELFFile(stream)
        sections = sections_of_variables(elf)
        assert len(sections) == 2, "variables with values, and those that are 0"

        processor = run_to_main(board, elf)

        for name, section in sections.items():
            address, size = section["sh_addr"], section["sh_size"]
            content_in_memory = bytes(processor.mem_read(address, size))
            expected_content = section.data()  # zeros for the section that has no bytes in the image
            assert content_in_memory == expected_content, name
