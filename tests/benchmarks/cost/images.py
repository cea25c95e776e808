"""Images whose cost is measured: how they are built, and what can be read from them without running them."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from elftools.elf.elffile import ELFFile
from elftools.elf.sections import Symbol, SymbolTableSection

from support import ROOT, TABLE

HERE = Path(__file__).parent
FIRMWARE, PORTS = ROOT / "c_ref/src", ROOT / "c_ref/ports"

CLONE = re.compile(r"\.(constprop|part|isra|cold)(\.\d+)?")
"""What a compiler adds to the name of a function that it has changed."""
_LINE = re.compile(
    r"^\s*(?P<address>[0-9a-f]+):\t(?P<name>\S+)[ \t]*(?P<operands>.*)$"
    r"|^[0-9a-f]+ <(?P<function>.+)>:$"
    r"|^/\S*/(?P<source_line>[^/\s]+:\d+)( \(discriminator \d+\))?$",
    re.MULTILINE,
)
"""Matches a line of a disassembly: an instruction, the name of a function, or the line of the source that the
instructions below it come from."""
_COMMON = ("-std=c99", "-ffunction-sections", "-fdata-sections", "-fstack-usage", "-g", "-Wl,--gc-sections")
_WITHOUT_LIBRARY = ("-ffreestanding", "-nostdlib", "-Wl,-Ttext=0x10000", "-Wl,-e,main")


@dataclass(frozen=True)
class Target:
    """A microcontroller.

    Attributes:
        name: As the tables show it.
        tools: The prefix of the names of its compiler and its disassembler.
        flags: The compiler's flags besides the level.
        package: Debian's package with the compiler.
        libraries: Sources and libraries that every image gets.
    """

    name: str
    tools: str
    flags: tuple[str, ...]
    package: str
    libraries: tuple[str, ...] = (str(PORTS / "memory.c"), "-lgcc")

    @property
    def compiler(self) -> str:
        """The compiler's name."""
        return f"{self.tools}gcc"

    def version(self) -> str:
        """Return the name and the version of the compiler. Raises FileNotFoundError without one."""
        command = [self.compiler, "-dumpfullversion", "-dumpversion"]
        output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        version, *_ = output.split()
        return f"{self.compiler} {version}"


def _cortex_m(name: str, cpu: str) -> Target:
    flags = (f"-mcpu={cpu}", "-mthumb", "-mfloat-abi=soft", *_WITHOUT_LIBRARY)
    return Target(name, "arm-none-eabi-", flags, "gcc-arm-none-eabi")


_RISCV = ("-march=rv32imc", "-mabi=ilp32", "-mcmodel=medany", *_WITHOUT_LIBRARY)
TARGETS = (
    Target("ATmega328P", "avr-", ("-mmcu=atmega328p",), "gcc-avr avr-libc", ("-lm",)),
    _cortex_m("Cortex-M0+", "cortex-m0plus"),
    _cortex_m("Cortex-M4", "cortex-m4"),
    Target("RV32IMC", "riscv64-unknown-elf-", _RISCV, "gcc-riscv64-unknown-elf"),
)


@dataclass(frozen=True)
class Instruction:
    """An instruction of a disassembly.

    Attributes:
        address: The address of the instruction.
        name: The mnemonic.
        operands: The text behind the mnemonic, which may end with a comment.
        function: The name of the function that the instruction belongs to.
        source_line: The line of the source that it comes from, such as "a.c:12", or "" if it is not known.
    """

    address: int
    name: str
    operands: str
    function: str
    source_line: str


@dataclass(frozen=True)
class Image:
    """A linked program."""

    target: Target
    path: Path

    @cached_property
    def symbols(self) -> dict[str, Symbol]:
        """The symbols of the functions and variables by name."""
        with self.path.open("rb") as stream:
            table = ELFFile(stream).get_section_by_name(".symtab")
            assert isinstance(table, SymbolTableSection)
            return {
                symbol.name: symbol for symbol in table.iter_symbols() if symbol["st_shndx"] != "SHN_UNDEF"
            }

    def address(self, name: str) -> int:
        """Return the address of a function or variable, without the bit that marks Thumb code or AVR data."""
        symbol = self.symbols[name]
        return int(symbol["st_value"]) & (~1 if symbol["st_info"]["type"] == "STT_FUNC" else 0x7FFFFF)

    def segments(self) -> Iterator[tuple[int, bytes]]:
        """Yield the address at run time and the bytes of each segment that is loaded."""
        with self.path.open("rb") as stream:
            for segment in ELFFile(stream).iter_segments("PT_LOAD"):
                yield segment["p_vaddr"], segment.data()

    def sizes(self) -> tuple[int, int]:
        """Return the bytes of flash and of variables in RAM.

        Code, constants and the first values of variables are in flash. An AVR copies constants to RAM, too.
        """
        _titles, numbers = self._run_tool("size").splitlines()
        code, variables_with_values, zeroed_variables, *_ = map(int, numbers.split()[:3])
        return code + variables_with_values, variables_with_values + zeroed_variables

    def _run_tool(self, tool: str, *options: str) -> str:
        """Return what one of the target's tools prints of the image."""
        command = [self.target.tools + tool, *options, str(self.path)]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout

    @cached_property
    def code(self) -> list[Instruction]:
        """The instructions of the disassembly in the order of their addresses."""
        instructions = []
        function, source_line = "", ""
        for line in _LINE.finditer(self._run_tool("objdump", "-d", "-l", "--no-show-raw-insn")):
            if line["function"]:
                function, source_line = line["function"], ""
            elif line["source_line"]:
                source_line = line["source_line"]
            else:
                address = int(line["address"], 16)
                instructions.append(
                    Instruction(address, line["name"], line["operands"], function, source_line)
                )
        return instructions

    @cached_property
    def frames(self) -> dict[str, int]:
        """The bytes of stack by function. The compiler reports them, but not those of its own library."""
        frames: dict[str, int] = {}
        for file in self.path.parent.glob("*.su"):
            for line in file.read_text(encoding="utf-8").splitlines():
                location, size, kind = line.rsplit("\t", 2)
                name = CLONE.sub("", location.rsplit(":", 1)[1])
                if kind not in ("static", "dynamic,bounded"):
                    raise ValueError(f"{file.name}: the stack of {name} has no bound ({kind})")
                frames[name] = max(frames.get(name, 0), int(size))
        return frames


def build(target: Target, folder: Path, sources: Iterable[Path], *flags: str) -> Image:
    """Compile and link ``sources`` in a new folder. Raises RuntimeError with the tools' messages."""
    folder.mkdir(parents=True)
    elf = folder / "image.elf"
    files = [*map(str, sources), *target.libraries]
    include = [f"-I{FIRMWARE}", f"-I{HERE}"]
    command = [target.compiler, *_COMMON, *target.flags, *flags, *include, *files, "-o", str(elf)]
    result = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
    if result.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}\n{result.stderr}")
    return Image(target, elf)


AVR = TARGETS[0]
KILOBOT_CLOCK, KILOBOT_BAUD = 8_000_000, 38_400
"""The clock of a Kilobot in hertz, and the baud rate of its serial line: at 8 MHz 115200 is out of reach."""


def kilobot_image(folder: Path, *flags: str) -> Image:
    """Return the whole firmware of a Kilobot: core, frame codec, main loop of c_ref/ports/demo.c and table.

    With the robust filter alone there is no table.
    """
    ports = (PORTS / name for name in ("demo.c", "packet_radio.c", "avr/demo_atmega.c", "avr/atmega.c"))
    core = (FIRMWARE / f"mcp_asdf{part}.c" for part in ("", "_image", "_frame"))
    clock = (f"-DF_CPU={KILOBOT_CLOCK}UL", f"-DBAUD={KILOBOT_BAUD}")
    is_robust = "-DMCP_ASDF_WITH_ASDF=0" in flags
    symbol = TABLE.stem.replace("t_table", "mcp_asdf_t_table")
    filter_options = () if is_robust else (f"-DDEMO_CONFIG=MCP_ASDF_CONFIG_ASDF({symbol})", str(TABLE))
    return build(AVR, folder, [*ports, *core], "-Os", f"-I{PORTS}", *clock, *flags, *filter_options)
