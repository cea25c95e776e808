"""What the firmware costs on a Cortex-M4 and a Cortex-M0+: executed instructions, bytes and stack.

    python tests/benchmarks/cost.py [--json] [--write README.md]

Builds the core with arm-none-eabi-gcc, runs it under Unicorn, which counts every instruction of a call,
helpers of the compiler included, and prints a table. Nothing is timed, so the figures are the same on any
machine with the same compiler. Each call is measured at many moments: t from 1 to 2**32 - 2, both ends
and the inside of the scale, rounds of 0 to 127 messages, halvings, accuracies on both sides of 1/2. The
baseline is plain C of the same equations in double and in float, without checks, in the same run.
"""

from __future__ import annotations

import argparse
import json
import random
import shutil
import struct
import subprocess
import sys
import tempfile
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

from elftools.elf.elffile import ELFFile
from elftools.elf.sections import Symbol, SymbolTableSection
from unicorn import UC_ARCH_ARM, UC_HOOK_CODE, UC_MODE_MCLASS, UC_MODE_THUMB, Uc
from unicorn.arm_const import (
    UC_ARM_REG_LR,
    UC_ARM_REG_R0,
    UC_ARM_REG_R1,
    UC_ARM_REG_R2,
    UC_ARM_REG_R3,
    UC_ARM_REG_SP,
)

ROOT = Path(__file__).resolve().parents[2]
COMPILER = "arm-none-eabi-gcc"
TARGETS = {"Cortex-M4": "cortex-m4", "Cortex-M0+": "cortex-m0plus"}
TABLE = ROOT / "tables" / "t_table_omega05_q127.c"
TABLE_BYTES = 16 + 4 * 127
BASE, STACK_TOP, RETURN = 0x10000, 0x100000, 0x10F000
PAINT = 0xA5
MEMORY = 2**32 - 2
START, END = "<!-- cost table -->", "<!-- end of cost table -->"
ROWS = ("step", "observe", "receive", "settle", "x", "step with test and update")


@dataclass
class Span:
    """Smallest and largest of what was measured."""

    low: int
    high: int

    def add(self, value: int) -> None:
        """Widen to hold ``value``."""
        self.low, self.high = min(self.low, value), max(self.high, value)


def symbols_of(image: ELFFile) -> list[Symbol]:
    """What the image's symbol table holds."""
    section = image.get_section_by_name(".symtab")
    assert isinstance(section, SymbolTableSection)
    return list(section.iter_symbols())


class Emulator:
    """An image in memory; calls return the function's value and what it cost."""

    def __init__(self, elf: Path) -> None:
        self.uc = Uc(UC_ARCH_ARM, UC_MODE_THUMB | UC_MODE_MCLASS)
        self.uc.mem_map(BASE, STACK_TOP)
        with elf.open("rb") as stream:
            image = ELFFile(stream)
            for segment in image.iter_segments("PT_LOAD"):
                self.uc.mem_write(segment["p_vaddr"], segment.data())
            self.symbols = {symbol.name: symbol["st_value"] for symbol in symbols_of(image)}
        self.instructions = 0
        self.deepest = 0
        self.uc.hook_add(UC_HOOK_CODE, self._count)

    def _count(self, *_: object) -> None:
        self.instructions += 1

    def call(self, name: str, *arguments: int) -> tuple[int, int]:
        """Value and number of instructions of ``name(*arguments)``."""
        self.instructions = 0
        for register, value in zip(
            (UC_ARM_REG_R0, UC_ARM_REG_R1, UC_ARM_REG_R2, UC_ARM_REG_R3), arguments, strict=False
        ):
            self.uc.reg_write(register, value & 0xFFFFFFFF)
        self.uc.mem_write(STACK_TOP - 1024, bytes([PAINT]) * 1024)
        self.uc.reg_write(UC_ARM_REG_SP, STACK_TOP)
        self.uc.reg_write(UC_ARM_REG_LR, RETURN | 1)
        self.uc.emu_start(self.symbols[name] | 1, RETURN)
        stack = bytes(self.uc.mem_read(STACK_TOP - 1024, 1024))
        self.deepest = max(self.deepest, len(stack.lstrip(bytes([PAINT]))))
        return self.uc.reg_read(UC_ARM_REG_R0), self.instructions


def build(
    cpu: str, level: str, folder: Path, entry: str, *sources: Path, extra: tuple[str, ...] = ()
) -> Path:
    """Compile and link ``sources`` for ``cpu``; returns the image."""
    elf = folder / f"{len(list(folder.iterdir()))}.elf"
    flags = [
        "-std=c99",
        level,
        f"-mcpu={cpu}",
        "-mthumb",
        "-ffreestanding",
        "-ffunction-sections",
        "-fdata-sections",
    ]
    flags += ["-fno-tree-loop-distribute-patterns", "-nostdlib", "-Wl,--gc-sections", f"-Wl,-Ttext={BASE:#x}"]
    flags += [f"-I{ROOT / 'c_ref' / 'src'}", f"-Wl,-e,{entry}", *extra]
    memory = ROOT / "tests" / "benchmarks" / "cost" / "memory.c"
    command = [COMPILER, *flags, *map(str, sources), str(memory), "-lgcc", "-o", str(elf)]
    subprocess.run(command, check=True)
    return elf


def core_sources() -> tuple[Path, ...]:
    """The firmware, its table and the benchmark's robot."""
    return ROOT / "c_ref" / "src" / "mcp_asdf.c", TABLE, ROOT / "tests" / "benchmarks" / "cost" / "image.c"


def moments(rng: random.Random, count: int) -> list[tuple[int, int, int]]:
    """(b_hat, t, n) before an observation, with edges over-represented."""
    chosen = []
    for _ in range(count):
        b = rng.choice(
            [0.55, 0.75, 0.95, 0.999999, 0.02, rng.uniform(0.5001, 0.9999), rng.uniform(0.0001, 0.4999)]
        )
        t = rng.choice(
            [0, 1, 9, 2**31 - 1, MEMORY - 1, int(2 ** rng.uniform(0, 32)) - 1, int(2 ** rng.uniform(3, 16))]
        )
        share = rng.choice([0.0, 0.5, 1.0, 1 - b, b, rng.random(), rng.uniform(min(b, 1 - b), max(b, 1 - b))])
        chosen.append((int(b * 2**32), min(t, MEMORY - 1), min(int(t * share), t)))
    return chosen


def alpha_bits(rng: random.Random) -> int:
    """A confidence as a neighbour may send it, off the grid too."""
    alpha = rng.choice([1.0, 1e4, 1e9, 3e9, 0.3, 1e-9, 2 ** rng.uniform(-30, 40)])
    return int(struct.unpack("<I", struct.pack("<f", alpha))[0])


def measure_core(elf: Path, rounds: int = 400) -> tuple[dict[str, Span], dict[str, float], int, int]:
    """Spans and means of instructions by call, bytes of RAM per robot, deepest stack of a tick's calls."""
    emulator, rng = Emulator(elf), random.Random(1)
    robot = emulator.symbols["robot"]
    spans: dict[str, Span] = {}
    samples: dict[str, list[int]] = defaultdict(list)

    def note(name: str, cost: int) -> None:
        samples[name].append(cost)
        spans.setdefault(name, Span(cost, cost)).add(cost)

    def prepare(moment: tuple[int, int, int], period: int, messages: int) -> None:
        b_hat, t, n = moment
        emulator.call("bench_init", b_hat, period)
        emulator.call("bench_set", t, n)
        for sender in range(messages):
            own = (sender + 6) % 128
            if own != 5:
                x_hat = rng.getrandbits(23)
                note("receive", emulator.call("mcp_asdf_receive", robot, own, x_hat, alpha_bits(rng))[1])

    emulator.call("bench_init", 1 << 31, 1)
    emulator.deepest = 0
    for moment in moments(rng, rounds):
        messages = rng.choice([0, 1, 2, 10, 10, 127]) if rng.random() < 0.3 else rng.choice([0, 3])
        prepare(moment, 2**31, messages)
        note("observe", emulator.call("mcp_asdf_observe", robot, rng.getrandbits(1))[1])
        note("settle", emulator.call("mcp_asdf_settle", robot)[1])
        note("x", emulator.call("mcp_asdf_x", robot)[1])
        prepare(moment, 2**31, 0)
        note("step", emulator.call("mcp_asdf_step", robot, rng.getrandbits(1))[1])
        prepare(moment, 1, rng.choice([2, 5]))
        note("step with test and update", emulator.call("mcp_asdf_step", robot, rng.getrandbits(1))[1])
    size, _ = emulator.call("bench_robot_size")
    means = {name: sum(costs) / len(costs) for name, costs in samples.items()}
    return spans, means, size, emulator.deepest


def measure_plain(elf: Path) -> dict[str, float]:
    """Mean instructions of the baseline's step and receive."""
    emulator, rng = Emulator(elf), random.Random(1)
    costs: dict[str, list[int]] = {"step": [], "receive": []}
    for b_hat, t, n in moments(rng, 60):
        emulator.call("plain_set", b_hat, max(t, 1), n)
        for _ in range(3):
            costs["receive"].append(emulator.call("plain_receive", rng.getrandbits(23), alpha_bits(rng))[1])
        costs["step"].append(emulator.call("plain_step", rng.getrandbits(1))[1])
    return {name: sum(values) / len(values) for name, values in costs.items()}


def flash_bytes(elf: Path) -> int:
    """Bytes of code and constants that a robot links, without the table and the benchmark's functions."""
    own = {"robot_main", "memset", "memcpy"}
    total = 0
    with elf.open("rb") as stream:
        image = ELFFile(stream)
        total = sum(s["sh_size"] for s in image.iter_sections() if s.name in (".text", ".rodata"))
        for symbol in symbols_of(image):
            if symbol.name in own or symbol.name.startswith("mcp_asdf_t_table"):
                total -= symbol["st_size"]
    return total


def measure(cpu: str, folder: Path) -> dict[str, object]:
    """Everything the table says about one target."""
    plain = ROOT / "tests" / "benchmarks" / "cost" / "plain.c"
    keep = tuple(
        f"-Wl,-u,{name}"
        for name in ("bench_init", "bench_set", "bench_robot_size", "mcp_asdf_observe", "mcp_asdf_step")
    )
    spans, means, ram, stack = measure_core(
        build(cpu, "-O2", folder, "robot_main", *core_sources(), extra=keep)
    )
    plain_keep = ("-Wl,-u,plain_set", "-Wl,-u,plain_receive")
    doubles = measure_plain(build(cpu, "-O2", folder, "plain_step", plain, extra=plain_keep))
    floats = measure_plain(
        build(cpu, "-O2", folder, "plain_step", plain, extra=(*plain_keep, "-DREAL=float"))
    )
    return {
        "instructions": {
            n: {"min": spans[n].low, "mean": round(means[n], 1), "max": spans[n].high} for n in ROWS
        },
        "plain double": {name: round(value) for name, value in doubles.items()},
        "plain float": {name: round(value) for name, value in floats.items()},
        "flash -Os": flash_bytes(build(cpu, "-Os", folder, "robot_main", *core_sources())),
        "flash -O2": flash_bytes(build(cpu, "-O2", folder, "robot_main", *core_sources())),
        "table": TABLE_BYTES,
        "ram": ram,
        "stack": stack,
    }


def compiler_version() -> str:
    """Name and version of the cross compiler. Raises FileNotFoundError without one."""
    done = subprocess.run([COMPILER, "-dumpfullversion"], capture_output=True, text=True, check=True)
    return f"{COMPILER} {done.stdout.strip()}"


def measure_all() -> dict[str, dict[str, object]]:
    """``measure`` for every target."""
    with tempfile.TemporaryDirectory() as folder:
        return {name: measure(cpu, Path(folder)) for name, cpu in TARGETS.items()}


def markdown(results: dict[str, dict[str, object]], version: str) -> str:
    """The table of the README."""
    lines = [f"| {version} | " + " | ".join(results) + " |", "|---|" + "---|" * len(results)]

    def row(title: str, cells: list[str]) -> None:
        lines.append(f"| {title} | " + " | ".join(cells) + " |")

    for name in ROWS:
        figures = [r["instructions"][name] for r in results.values()]  # type: ignore[index]
        row(f"{name}: instructions, mean (max)", [f"{f['mean']:.0f} ({f['max']})" for f in figures])
    for kind in ("plain double", "plain float"):
        cells = []
        for r in results.values():
            ratio = r[kind]["step"] / (r["instructions"]["step"]["mean"] + r["instructions"]["x"]["mean"])  # type: ignore[index]
            cells.append(f"{r[kind]['step']}, {ratio:.1f} times as many")  # type: ignore[index]
        row(f"{kind} C instead of step and x", cells)
    row(
        "code, bytes of flash at -Os (-O2)",
        [f"{r['flash -Os']} ({r['flash -O2']})" for r in results.values()],
    )
    row("t-table, bytes of flash: 16 + 4 q", [f"{r['table']} at q = 127" for r in results.values()])
    row("RAM per robot, bytes", [str(r["ram"]) for r in results.values()])
    row("deepest stack of a tick, bytes", [str(r["stack"]) for r in results.values()])
    return "\n".join(lines)


def write_between_markers(path: Path, table: str) -> None:
    """Replace what stands between the markers in ``path``. Raises ValueError without markers."""
    text = path.read_text(encoding="utf-8")
    if START not in text or END not in text:
        raise ValueError(f"{path} has no lines {START} and {END}")
    head, rest = text.split(START, 1)
    tail = rest.split(END, 1)[1]
    path.write_text(f"{head}{START}\n{table}\n{END}{tail}", encoding="utf-8")


def main() -> int:
    """Measure and print; returns the exit code."""
    parser = argparse.ArgumentParser(description="Measure what the firmware costs on two microcontrollers.")
    parser.add_argument("--json", action="store_true", help="print everything measured as JSON")
    parser.add_argument(
        "--write", type=Path, metavar="FILE", help="put the table between the markers of FILE"
    )
    args = parser.parse_args()
    if shutil.which(COMPILER) is None:
        print(
            f"cost: {COMPILER} is not installed; on Debian: apt-get install gcc-arm-none-eabi",
            file=sys.stderr,
        )
        return 2
    results, version = measure_all(), compiler_version()
    table = markdown(results, version)
    print(json.dumps({"compiler": version, "targets": results}, indent=2) if args.json else table)
    if args.write is not None:
        write_between_markers(args.write, table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
