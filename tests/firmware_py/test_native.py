"""The C firmware through cffi: same interface, names, numbers and errors as its mirror.

The long comparison of the two is the cross-check's; here it is that the wrapper adds nothing of its own.
"""

from __future__ import annotations

import gc
import random
import re
import subprocess
import weakref
from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path

import pytest

from mcp_asdf import fixed_point, robot
from mcp_asdf.mirror import IMAGE_MAGIC, IMAGE_WORDS, MirrorRobot
from mcp_asdf.native import NativeRobot, _SharedConfig, ffi, lib
from mcp_asdf.robot import Config, Filter, FirmwareError, FixedPointRobot, Observation, Status
from mcp_asdf.table import EXTRA_WORDS, MAGIC, MAX_Q, Table, checksum
from mcp_asdf_tools.tables.thresholds import generate, parse_omega
from robots import status_of_receive
from support import CORE, HEADER, run

IMAGE_HEADER, IMAGE = HEADER.with_name("mcp_asdf_image.h"), CORE.with_name("mcp_asdf_image.c")
ALPHA_TWO = 0x80000002
TABLE = generate(parse_omega("0.05"), 30)
CONFIG = Config(TABLE, filter_period=10, memory=64)


def both(config: Config = CONFIG, robot_id: int = 3, b_hat: float = 0.8) -> tuple[NativeRobot, MirrorRobot]:
    return NativeRobot(config, robot_id, b_hat), MirrorRobot(config, robot_id, b_hat)


# --- The interface ---------------------------------------------------------------------------------------


def test_native_is_a_fixed_point_robot() -> None:
    native: FixedPointRobot = NativeRobot(CONFIG, 3, 0.8)
    assert isinstance(native, FixedPointRobot)


# --- Nothing drifts from the header ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("c_type", "enum"),
    [
        ("mcp_asdf_status_t", Status),
        ("mcp_asdf_filter_t", Filter),
        ("mcp_asdf_observation_t", Observation),
    ],
)
def test_enums_are_those_of_the_header(c_type: str, enum: type[IntEnum]) -> None:
    of_c = {name.removeprefix("MCP_ASDF_"): value for value, name in ffi.typeof(c_type).elements.items()}
    assert of_c == {member.name: member.value for member in enum}


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("ONE", fixed_point.ONE),
        ("HALF", fixed_point.HALF),
        ("B_HAT_MIN", fixed_point.B_HAT_MIN),
        ("B_HAT_MAX", fixed_point.B_HAT_MAX),
        ("MAX_ID", robot.MAX_ID),
        ("MEMORY_MIN", robot.MIN_MEMORY),
        ("MEMORY_MAX", robot.DEFAULT_MEMORY),
        ("IMAGE_SIZE", 4 * IMAGE_WORDS),
        ("IMAGE_VERSION", IMAGE_MAGIC & 0xFF),
    ],
)
def test_constants_are_those_of_the_header(name: str, expected: int) -> None:
    assert getattr(lib, f"MCP_ASDF_{name}") == expected


def test_every_number_that_the_headers_define_is_there() -> None:
    """The preprocessor's own list of macros of both headers, whichever way the declarations were derived."""
    macros = dict(
        line.split(maxsplit=2)[1:]
        for line in run("cc", "-dM", "-E", IMAGE_HEADER).splitlines()
        if len(line.split(maxsplit=2)) == 3
    )
    numbers = {
        name
        for name, text in macros.items()
        if re.fullmatch(r"MCP_ASDF_\w+", name) and re.search(r"\d", text)
    }
    assert len(numbers) >= 12
    assert numbers <= set(dir(lib))


@pytest.mark.parametrize(("source", "function"), [(CORE, "mcp_asdf_init"), (IMAGE, "mcp_asdf_save")])
def test_every_function_of_the_core_is_there(source: Path, function: str, tmp_path: Path) -> None:
    """The linker's list of what a source defines; the header's inline functions come on top."""
    run("cc", "-c", source, "-o", tmp_path / "object.o")
    defined = set(re.findall(r" T (\w+)", run("nm", tmp_path / "object.o")))
    assert function in defined
    assert defined <= set(dir(lib))


def test_a_robot_keeps_within_its_ram() -> None:
    wide = (
        ffi.sizeof("void *") > 4
    )  # the budget is for 32-bit pointers; a wider one is aligned to itself, too
    assert ffi.sizeof("mcp_asdf_t") <= (152 if wide else 144)


def test_the_usual_config_is_the_macro_of_the_header(tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("usual")
    source = '#include "mcp_asdf.h"\nmcp_asdf_config_t usual = MCP_ASDF_CONFIG(0);'
    preprocessed = subprocess.run(
        ["cc", "-E", "-P", "-I", HEADER.parent, "-"],
        input=source,
        capture_output=True,
        text=True,
        check=True,
        cwd=folder,
    ).stdout
    (values,) = re.findall(r"usual = \{\(0\), (\d+), ([^,]+), (\w+)\}", preprocessed)
    config = Config()
    assert int(values[0]) == config.filter_period
    assert re.fullmatch(r"\(1U?L? << 31\)", values[1]) and config.memory == lib.MCP_ASDF_MEMORY_MAX == 2**31
    assert values[2] == f"MCP_ASDF_{config.filter.name}"


# --- The same as the mirror ------------------------------------------------------------------------------


def message(rng: random.Random) -> tuple[int, int, int]:
    """Any sender byte; x_hat mostly valid, now and then any 32 bits; any alpha."""
    x_hat = rng.getrandbits(32) if rng.random() < 0.05 else rng.randint(0, fixed_point.ONE)
    alpha = rng.choice(
        [rng.getrandbits(32), rng.getrandbits(24) << 8 | rng.randrange(32), rng.randrange(512)]
    )
    return rng.choice([rng.randint(0, 20), rng.getrandbits(8)]), x_hat, alpha


def views(fixed: FixedPointRobot) -> dict[str, object]:
    """Everything the interface shows, properties by name."""
    names = [n for n in dir(FixedPointRobot) if isinstance(getattr(FixedPointRobot, n), property)]
    shown = {name: getattr(fixed, name) for name in names}
    return {**shown, "state": fixed.state(), "image": fixed.save(), "sound": fixed.holds_invariants()}


@pytest.mark.parametrize("seed", range(6))
def test_native_and_mirror_agree_on_everything_shown(seed: int) -> None:
    rng = random.Random(seed)
    config = replace(CONFIG, filter=Filter(seed % 3), filter_period=1 + seed)
    native, mirror = both(config, b_hat=rng.uniform(0.01, 0.99))
    for _ in range(300):
        for _ in range(rng.randrange(6)):
            heard = message(rng)
            assert native.receive_raw(*heard) == mirror.receive_raw(*heard)
        z = rng.choice(list(Observation))
        match rng.randrange(3):
            case 0:
                assert native.step(z) == mirror.step(z)
            case 1:
                assert native.observe(z) == mirror.observe(z)
            case _:
                assert native.settle() == mirror.settle()
        assert views(native) == views(mirror)
    assert native.counters.updates > 0 or config.filter == Filter.OFF


def test_float_messages_are_rounded_as_the_mirror_rounds_them() -> None:
    native, mirror = both()
    for sender, (x_hat, alpha) in enumerate([(0.3, 0.1), (1.0, 1e300), (0.5, 1e-12), (2.0, 1.0), (0.7, 0.0)]):
        message = sender, x_hat, alpha
        assert status_of_receive(native, *message) == status_of_receive(mirror, *message)
    assert native.state() == mirror.state()


def test_a_restored_robot_goes_on_from_the_mirror_s_image() -> None:
    native, mirror = both()
    for tick in range(50):
        mirror.receive_raw(tick % 3, tick << 16, ALPHA_TWO)
        mirror.step(Observation(tick % 2))
    native = NativeRobot.restore(CONFIG, mirror.save())
    assert native.step(Observation.BLACK) == mirror.step(Observation.BLACK)
    assert views(native) == views(mirror)


def test_an_image_may_reach_far_in_time() -> None:
    config = replace(CONFIG, memory=robot.DEFAULT_MEMORY)
    mirror = MirrorRobot(config, 3, 0.8)
    mirror.s.t, mirror.s.n, mirror.s.updated = 2**31 - 3, 2**30, 1
    native = NativeRobot.restore(config, mirror.save())
    for _ in range(4):  # across the halving
        native.step(Observation.BLACK)
        mirror.step(Observation.BLACK)
    assert native.t == 2**30 + 1
    assert views(native) == views(mirror)


# --- Errors ----------------------------------------------------------------------------------------------


def bad_table() -> Table:
    return replace(TABLE, entries=(*TABLE.entries[:-1], TABLE.entries[-2]))


@pytest.mark.parametrize(
    ("status", "config", "robot_id", "b_hat"),
    [
        (Status.ERR_CONFIG, replace(CONFIG, filter_period=0), 3, 0.8),
        (Status.ERR_CONFIG, replace(CONFIG, filter_period=-1), 3, 0.8),
        (Status.ERR_CONFIG, replace(CONFIG, filter_period=2**32), 3, 0.8),
        (Status.ERR_CONFIG, replace(CONFIG, filter_period=2**40), 3, 0.8),
        (Status.ERR_CONFIG, replace(CONFIG, memory=65), 3, 0.8),
        (Status.ERR_CONFIG, replace(CONFIG, memory=66), 3, 0.8),
        (Status.ERR_CONFIG, replace(CONFIG, memory=62), 3, 0.8),
        (Status.ERR_CONFIG, replace(CONFIG, memory=2**32), 3, 0.8),
        (Status.ERR_CONFIG, replace(CONFIG, memory=2**32 + 64), 3, 0.8),
        (Status.ERR_TABLE, replace(CONFIG, table=None), 3, 0.8),
        (Status.ERR_TABLE, replace(CONFIG, table=bad_table()), 3, 0.8),
        (Status.ERR_TABLE, replace(CONFIG, table=replace(TABLE, omega_word=2**33)), 3, 0.8),
        (Status.ERR_ID, CONFIG, 128, 0.8),
        (Status.ERR_ID, CONFIG, 256 + 3, 0.8),
        (Status.ERR_ID, CONFIG, -1, 0.8),
        (Status.ERR_ID, CONFIG, -1, 7.0),
        (Status.ERR_B_HAT, CONFIG, 3, 1.0),
        (Status.ERR_B_HAT, CONFIG, 3, 0.0),
        (Status.ERR_B_HAT, CONFIG, 3, 1 - 2.0**-20 + 2.0**-53),
        (Status.ERR_B_HAT, CONFIG, 3, float("nan")),
        (Status.ERR_B_HAT, CONFIG, 3, float("inf")),
    ],
)
def test_what_the_c_refuses_to_make(status: Status, config: Config, robot_id: int, b_hat: float) -> None:
    for make in (NativeRobot, MirrorRobot):
        with pytest.raises(FirmwareError, match=status.name) as refused:
            make(config, robot_id, b_hat)
        assert refused.value.status == status


def test_an_unknown_filter_is_refused() -> None:
    with pytest.raises(FirmwareError) as refused:
        NativeRobot(replace(CONFIG, filter=3), 3, 0.8)  # type: ignore[arg-type]
    assert refused.value.status == Status.ERR_CONFIG


@pytest.mark.parametrize("filter_mode", [Filter.ALWAYS, Filter.OFF])
def test_a_table_is_not_read_without_a_test(filter_mode: Filter) -> None:
    NativeRobot(replace(CONFIG, table=bad_table(), filter=filter_mode), 3, 0.8)


def test_refusals_name_the_value() -> None:
    with pytest.raises(FirmwareError, match=r"robot id is 128; choose 0 \.\. 127"):
        NativeRobot(CONFIG, 128, 0.8)
    with pytest.raises(FirmwareError, match=r"b_hat is 1.5; choose one in \[2\*\*-20"):
        NativeRobot(CONFIG, 3, 1.5)


@pytest.mark.parametrize(
    "message",
    [
        *((sender, 0, 0) for sender in (3, 128, 255, 256 + 4, -1)),
        *((4, x_hat, 0) for x_hat in (fixed_point.ONE + 1, 2**32 - 1, 2**32 + 5)),
        (-1, 2**40, 2**32 - 1),
    ],
)
def test_bad_messages_count_and_change_nothing_else(message: tuple[int, int, int]) -> None:
    native, mirror = both()
    before = native.state()
    assert native.receive_raw(*message) == mirror.receive_raw(*message) < Status.OK
    assert native.state() == {**before, "rejected": 1} == mirror.state()


@pytest.mark.parametrize("z", [2, 3, -1, 2**31, 2**32, 2**32 + 1, 2**64])
def test_a_bad_observation_changes_nothing(z: int) -> None:
    native = NativeRobot(CONFIG, 3, 0.8)
    before = native.state()
    assert native.observe(z) == native.step(z) == Status.ERR_OBSERVATION  # type: ignore[arg-type]
    assert native.state() == before


def test_damaged_images_are_refused() -> None:
    image = bytearray(NativeRobot(CONFIG, 3, 0.8).save())
    for position in range(len(image)):
        damaged = bytes(image[:position]) + bytes([image[position] ^ 1]) + bytes(image[position + 1 :])
        with pytest.raises(FirmwareError) as refused:
            NativeRobot.restore(CONFIG, damaged)
        assert refused.value.status == Status.ERR_IMAGE


@pytest.mark.parametrize("size", [0, 123, 125, 136, 1000])
def test_an_image_of_another_size_is_refused(size: int) -> None:
    image = NativeRobot(CONFIG, 3, 0.8).save()
    with pytest.raises(FirmwareError, match="ERR_IMAGE"):
        NativeRobot.restore(CONFIG, (image * 8)[:size])


@dataclass(frozen=True)
class Claiming(Table):
    """A table whose first word claims another q, under a right checksum."""

    claimed: int

    def words(self) -> tuple[int, ...]:
        body = (MAGIC | self.claimed, *super().words()[1:-1])
        return (*body, checksum(body))


@pytest.mark.parametrize("claimed", [0, 1, 2, 3, 29, 30, 31, 94, 126, 127, 128, 255])
def test_c_reads_no_word_that_is_not_there(claimed: int) -> None:
    """Words that claim another q than they are for: C has that many before it refuses them."""
    table = Claiming(TABLE.omega_word, TABLE.entries, claimed)
    config = replace(CONFIG, table=table)
    shared = _SharedConfig(config)
    assert len(shared._table) >= EXTRA_WORDS + min(claimed, MAX_Q)  # a larger one is refused unread
    assert tuple(shared._table)[: len(table.words())] == table.words()
    for make in (NativeRobot, MirrorRobot):
        if claimed == TABLE.q:
            make(config, 3, 0.8)
        else:
            with pytest.raises(FirmwareError, match="ERR_TABLE"):
                make(config, 3, 0.8)


# --- Memory ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("filter_mode", Filter)
@pytest.mark.parametrize("fill", ["random", "ones", "zeros", "few bits"])
def test_calls_survive_any_contents_of_a_robot(filter_mode: Filter, fill: str) -> None:
    """All of a robot but its config pointer spoilt: every call returns one of its own results, and init makes
    a sound robot of it again."""
    rng = random.Random(fill)
    config = replace(CONFIG, filter=filter_mode, filter_period=1)
    for _ in range(300):
        native = NativeRobot(config, 3, 0.8)
        memory = ffi.buffer(native.pointer)
        spoilt = {"ones": b"\xff" * len(memory), "zeros": bytes(len(memory))}.get(
            fill, rng.randbytes(len(memory))
        )
        if fill == "few bits":
            spoilt = bytes(
                old ^ (1 << rng.randrange(8) if rng.random() < 0.05 else 0) for old in bytes(memory)
            )
        memory[ffi.offsetof("mcp_asdf_t", "t") :] = spoilt[ffi.offsetof("mcp_asdf_t", "t") :]
        native.holds_invariants()
        for _ in range(3):
            assert native.receive_raw(*message(rng)) in (
                Status.OK,
                Status.REPEATED,
                Status.ERR_SENDER,
                Status.ERR_X_HAT,
            )
            assert native.observe(rng.choice(list(Observation))) == Status.OK
            assert native.settle() in (Status.OK, Status.UPDATED)
            views(native)
        assert lib.mcp_asdf_init(native.pointer, native.pointer.config, 3, 1 << 31) == Status.OK
        assert native.holds_invariants()


def test_robots_of_equal_configs_share_one_in_c() -> None:
    one, two = NativeRobot(CONFIG, 1, 0.8), NativeRobot(replace(CONFIG), 2, 0.6)
    other = NativeRobot(replace(CONFIG, filter_period=20), 3, 0.8)
    restored = NativeRobot.restore(CONFIG, one.save())
    assert one.pointer.config == two.pointer.config == restored.pointer.config != other.pointer.config
    assert other.pointer.config.filter_period == 20


def test_a_config_lives_as_long_as_its_robots() -> None:
    config = replace(CONFIG, filter_period=7)
    native, mirror = both(config)
    shared = weakref.ref(native._shared)
    twin = NativeRobot(config, 4, 0.8)
    del twin, config
    gc.collect()
    _ = [ffi.new("uint32_t[]", [0xAAAAAAAA] * 40) for _ in range(1000)]  # takes what was freed
    assert native.pointer.config.filter_period == 7
    assert [native.pointer.config.table[i] for i in range(33)] == list(TABLE.words())
    for tick in range(14):
        for sender in range(5):
            native.receive_raw(sender, 0, ALPHA_TWO)
            mirror.receive_raw(sender, 0, ALPHA_TWO)
        native.step(Observation(tick % 2))
        mirror.step(Observation(tick % 2))
    assert native.counters.tests == 2
    assert native.state() == mirror.state()
    del native
    gc.collect()
    assert shared() is None


def test_the_library_drives_robots_through_their_pointers() -> None:
    native, mirror = both()
    assert lib.mcp_asdf_receive(native.pointer, 4, 5, ALPHA_TWO) == Status.OK
    mirror.receive_raw(4, 5, ALPHA_TWO)
    assert native.state() == mirror.state()
