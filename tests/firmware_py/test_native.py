"""The C firmware through cffi: its names and numbers are the header's, and its memory is safe."""

from __future__ import annotations

import gc
import random
import re
import weakref
from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path

import pytest

from mcp_asdf import fixed_point, robot
from mcp_asdf.mirror import IMAGE_MAGIC, IMAGE_WORDS, MirrorRobot
from mcp_asdf.native import NativeRobot, _ConfigInC, ffi, lib
from mcp_asdf.robot import Config, Filter, FirmwareError, Observation, Status
from mcp_asdf.table import EXTRA_WORDS, MAGIC, MAX_Q, Table, checksum
from mcp_asdf_tools.tables.thresholds import generate, parse_omega
from support import CORE, HEADER, run

IMAGE_HEADER, IMAGE = HEADER.with_name("mcp_asdf_image.h"), CORE.with_name("mcp_asdf_image.c")
ALPHA_TWO = 0x80000002
TABLE = generate(parse_omega("0.05"), 30)
CONFIG = Config(TABLE, filter_period=10, memory=64)


# --- Nothing drifts from the header ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("c_type", "enum"),
    [("mcp_asdf_status_t", Status), ("mcp_asdf_filter_t", Filter), ("mcp_asdf_observation_t", Observation)],
)
def test_enums_are_those_of_the_header(c_type: str, enum: type[IntEnum]) -> None:
    of_c = {name.removeprefix("MCP_ASDF_"): value for value, name in ffi.typeof(c_type).elements.items()}
    assert of_c == {member.name: member.value for member in enum}


def test_constants_are_those_of_the_header() -> None:
    expected = {
        **{"ONE": fixed_point.ONE, "HALF": fixed_point.HALF, "MAX_ID": robot.MAX_ID},
        **{"B_HAT_MIN": fixed_point.B_HAT_MIN, "B_HAT_MAX": fixed_point.B_HAT_MAX},
        **{"MEMORY_MIN": robot.MIN_MEMORY, "MEMORY_MAX": robot.DEFAULT_MEMORY},
        **{"IMAGE_SIZE": 4 * IMAGE_WORDS, "IMAGE_VERSION": IMAGE_MAGIC & 0xFF},
    }
    assert {name: getattr(lib, f"MCP_ASDF_{name}") for name in expected} == expected


def test_every_number_that_the_headers_define_is_there() -> None:
    """The preprocessor's own list of macros of both headers, whichever way the declarations were derived."""
    lines = run("cc", "-dM", "-E", IMAGE_HEADER).splitlines()
    macros = re.findall(r"^#define (MCP_ASDF_\w+) .*\d", "\n".join(lines), re.MULTILINE)
    assert len(macros) >= 12
    assert {*macros} <= {*dir(lib)}


@pytest.mark.parametrize(("source", "function"), [(CORE, "mcp_asdf_init"), (IMAGE, "mcp_asdf_save")])
def test_every_function_of_the_core_is_there(source: Path, function: str, tmp_path: Path) -> None:
    """The linker's list of what a source defines; the header's inline functions come on top."""
    run("cc", "-c", source, "-o", tmp_path / "object.o")
    defined = set(re.findall(r" T (\w+)", run("nm", tmp_path / "object.o")))
    assert function in defined
    assert defined <= set(dir(lib))


def test_the_usual_config_is_the_macro_of_the_header(tmp_path: Path) -> None:
    source = tmp_path / "usual.c"
    source.write_text('#include "mcp_asdf.h"\nmcp_asdf_config_t usual = MCP_ASDF_CONFIG(0);')
    preprocessed = run("cc", "-E", "-P", "-I", HEADER.parent, source)
    (values,) = re.findall(r"usual = \{\(0\), (\d+), ([^,]+), (\w+)\}", preprocessed)
    config = Config()
    assert int(values[0]) == config.filter_period
    assert re.fullmatch(r"\(1U?L? << 31\)", values[1]) and config.memory == lib.MCP_ASDF_MEMORY_MAX == 2**31
    assert values[2] == f"MCP_ASDF_{config.filter.name}"


# --- Memory ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Claiming(Table):
    """A table whose first word claims another q, under a right checksum."""

    claimed: int

    def words(self) -> tuple[int, ...]:
        body = (MAGIC | self.claimed, *super().words()[1:-1])
        return (*body, checksum(body))


@pytest.mark.parametrize("claimed", [0, 2, 29, 30, 31, 94, 127, 128, 255])
def test_c_reads_no_word_that_is_not_there(claimed: int) -> None:
    """Words that claim another q than they are for: C has that many before it refuses them."""
    table = Claiming(TABLE.omega_word, TABLE.entries, claimed)
    config = replace(CONFIG, table=table)
    shared = _ConfigInC(config)
    assert len(shared._table) >= EXTRA_WORDS + min(claimed, MAX_Q)  # a larger one is refused unread
    assert tuple(shared._table)[: len(table.words())] == table.words()
    for make in (NativeRobot, MirrorRobot):
        if claimed == TABLE.q:
            make(config, 3, 0.8)
        else:
            with pytest.raises(FirmwareError, match="ERR_TABLE"):
                make(config, 3, 0.8)


def spoilt(fill: str, rng: random.Random, memory: bytes) -> bytes:
    """Other contents of a memory."""
    if fill == "few bits":
        return bytes(old ^ (1 << rng.randrange(8) if rng.random() < 0.05 else 0) for old in memory)
    return (
        {"ones": b"\xff", "zeros": b"\0"}[fill] * len(memory)
        if fill != "random"
        else rng.randbytes(len(memory))
    )


@pytest.mark.parametrize("filter_mode", Filter)
@pytest.mark.parametrize("fill", ["random", "ones", "zeros", "few bits"])
def test_calls_survive_any_contents_of_a_robot(filter_mode: Filter, fill: str) -> None:
    """All of a robot but its config pointer spoilt: every call returns one of its own results, and init makes
    a sound robot of it again."""
    rng, start = random.Random(fill), ffi.offsetof("mcp_asdf_t", "t")
    config = replace(CONFIG, filter=filter_mode, filter_period=1)
    for _ in range(200):
        native = NativeRobot(config, 3, 0.8)
        memory = ffi.buffer(native.pointer)
        memory[start:] = spoilt(fill, rng, bytes(memory)[start:])
        for _ in range(3):
            message = rng.getrandbits(8), rng.randint(0, fixed_point.ONE + 2), rng.getrandbits(32)
            assert native.receive_raw(*message) in (0, Status.REPEATED, Status.ERR_SENDER, Status.ERR_X_HAT)
            assert native.observe(rng.choice(list(Observation))) == Status.OK
            assert native.settle() in (Status.OK, Status.UPDATED)
            assert (native.x_raw, native.x_bar_raw, native.save(), native.holds_invariants()) is not None
        assert lib.mcp_asdf_init(native.pointer, native.pointer.config, 3, 1 << 31) == Status.OK
        assert native.holds_invariants()


def test_a_config_lives_as_long_as_its_robot() -> None:
    config = replace(CONFIG, filter_period=7)
    native, mirror = NativeRobot(config, 3, 0.8), MirrorRobot(config, 3, 0.8)
    kept = weakref.ref(native._settings)
    del config
    gc.collect()
    _ = [ffi.new("uint32_t[]", [0xAAAAAAAA] * 40) for _ in range(1000)]  # takes what was freed
    assert native.pointer.config.filter_period == 7
    assert [native.pointer.config.table[i] for i in range(33)] == list(TABLE.words())
    for tick in range(14):
        for sender in range(5):
            assert lib.mcp_asdf_receive(native.pointer, sender, 0, ALPHA_TWO) == mirror.receive_raw(
                sender, 0, ALPHA_TWO
            )
        native.step(Observation(tick % 2))
        mirror.step(Observation(tick % 2))
    assert native.counters.tests == 2
    assert native.state() == mirror.state()
    del native
    gc.collect()
    assert kept() is None
