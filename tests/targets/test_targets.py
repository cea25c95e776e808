"""Every target computes the mirror's bits in an image that holds nothing else, and tells where it differs."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from support import CORE, ROOT, require
from targets import matrix
from targets.matrix import TARGETS, VERDICT, Target

from host_tools.golden_scenarios import edge_scenarios, run_scenarios
from host_tools.golden_vectors import explain

SCENARIOS = edge_scenarios() + run_scenarios()
VECTORS = [Path(__file__).with_name(name) for name in ("golden_edges.bin", "golden_runs.bin")]
OUR_SOURCES = {"mcp_asdf.c", "t_table_omega05_q30.c", "player.c", "golden_vectors.c"}
COMPILERS_OWN = re.compile(r"libgcc2\.c|_\w+\.o|crt\w*\.o|")
PORTS = sorted(
    path
    for path in (ROOT / "c_ref/ports").rglob("*.*")
    if path.suffix in (".c", ".ld") and path.parent.name != "linux"
)


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_the_target_computes_the_mirror_s_bits(target: Target, tmp_path: Path) -> None:
    reason = target.missing()
    if reason:
        pytest.skip(reason)
    require("ninja", "ninja-build")
    image = matrix.build(target.name, tmp_path)
    passed, printed = matrix.run(tmp_path)
    verdict = VERDICT.search(printed)
    assert passed and verdict, difference(printed)
    assert [int(number) for number in verdict.groups()] == totals(few=target.name == "avr")
    check_core(target, matrix.link_core_alone(target, tmp_path))
    if target.bare:
        check_contents(image)


def totals(few: bool) -> list[int]:
    """Scenarios, calls and ticks that a target has to report."""
    played = edge_scenarios() if few else SCENARIOS
    names = [call.name for scenario in played for call in scenario.calls()]
    return [len(played), 2 * len(played) + len(names), names.count("observe") + names.count("step")]


def test_the_documentation_shows_what_a_target_prints() -> None:
    scenarios, calls, ticks = totals(few=False)
    page = (ROOT / "docs/targets.md").read_text(encoding="utf-8")
    assert f"PASS scenarios {scenarios} calls {calls} ticks {ticks}\n" in page


def difference(printed: str) -> str:
    return explain(printed, SCENARIOS) if "found" in printed else f"the image did not finish:\n{printed}"


def check_core(target: Target, alone: Path) -> None:
    """The core needs integer helpers of the compiler, no more, and has no variables of its own."""
    odd = {name for name in matrix.needed_symbols(alone) if not re.fullmatch(target.helpers, name)}
    assert not odd, f"the core alone needs {sorted(odd)}"
    constants = (".rodata",) if target.name == "avr" else ()  # there they are copied to RAM
    assert matrix.ram_sections(alone, *constants) == {}


def check_contents(image: Path) -> None:
    """The image was linked from the core, a table, the player and the port; the rest is the compiler's."""
    files = {symbol.name for symbol in matrix.symbols(image) if symbol["st_info"]["type"] == "STT_FILE"}
    ours = {name for name in files if not COMPILERS_OWN.fullmatch(name)}
    assert ours >= OUR_SOURCES
    assert ours - OUR_SOURCES <= {path.name for path in PORTS}


@pytest.mark.parametrize("path", PORTS, ids=lambda path: path.name)
def test_a_port_is_small(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 100


def test_there_is_a_target_for_every_preset_and_preset_for_every_target() -> None:
    presets = Path(__file__).with_name("CMakePresets.json").read_text(encoding="utf-8")
    names = set(re.findall(r'"name": "([^"]+)"', presets)) - {"base", "small", "host"}
    assert names == {target.name for target in TARGETS}


def test_what_is_missing_is_named() -> None:
    target = Target("any", ("no-such-compiler", "no-such-emulator"), "one two", "")
    assert target.missing() == "no no-such-compiler and no no-such-emulator: apt-get install one two"
    assert Target("any", ("python3", "cmake"), "", "").missing() == ""


def test_symbols_of_floating_point_and_of_a_library_are_refused() -> None:
    soft_float = (
        "__aeabi_dadd",
        "__aeabi_ui2d",
        "__aeabi_fmul",
        "__adddf3",
        "__mulsf3",
        "__floatsisf",
        "__cmpdf2",
    )
    for target in TARGETS:
        for name in (*soft_float, "printf", "malloc", "memcmp", "abort"):
            assert not re.fullmatch(target.helpers, name), f"{target.name}: {name}"


def test_variables_and_needed_symbols_are_seen(tmp_path: Path) -> None:
    source, linked = tmp_path / "bad.c", tmp_path / "bad.o"
    source.write_text("double sin(double); int one = 1; int zero; double f(void) { return sin(one + zero); }")
    subprocess.run([require("gcc", "gcc"), "-c", source, "-o", linked], check=True)
    assert matrix.needed_symbols(linked) == {"sin"}
    assert matrix.ram_sections(linked) == {".data": 4, ".bss": 4}


# ---- The player finds faults, and the first call that shows one is named ----


def play_on_host(folder: Path, *settings: str) -> tuple[int, str]:
    """Exit status and output of the player built for this computer."""
    require("ninja", "ninja-build")
    image = matrix.build("host", folder / "build", *settings, "CMAKE_COMPILE_WARNING_AS_ERROR=OFF")
    done = subprocess.run([image], capture_output=True, text=True, check=False)
    return done.returncode, done.stdout


def core_with(folder: Path, right: str, wrong: str) -> str:
    """A copy of the firmware with a fault in it, as a setting for CMake."""
    copy = folder / "c_ref"
    shutil.copytree(CORE.parents[1], copy)
    code = CORE.read_text(encoding="utf-8")
    assert code.count(right) == 1, right
    (copy / "src" / CORE.name).write_text(code.replace(right, wrong), encoding="utf-8")
    return f"MCP_ASDF_CORE={copy}"


@pytest.mark.parametrize(
    ("right", "wrong", "first"),
    [
        (  # ties away from zero: first seen when n = 1 is halved
            "(robot->n >> 1 & 1)",
            "(robot->n & 1)",
            "scenario 6 (a memory of 64 halves, ties to even), call 4, step:1:",
        ),
        (  # a message whose effect the digest covers only with the next call
            "*word |= bit;",
            "*word |= bit | bit << 1;",
            "scenario 0 (nothing observed), call 5, receive:1:8388608:1065353216:",
        ),
        (  # one bit of a sum: seen when a round stays open
            "sums->x_squared += multiply(x_hat, x_hat);",
            "sums->x_squared += multiply(x_hat, x_hat) | 1;",
            "scenario 39 (senders), call 1, receive:0:8388608:1065353216:",
        ),
        (  # the last bit of 60 in the test of eq. 12
            "multiply(difference, difference) > threshold",
            "multiply(difference, difference) > threshold + 1",
            "scenario 53 (the threshold for 2), call 6, settle:",
        ),
        (
            "multiply(difference, difference) > threshold",
            "multiply(difference, difference) >= threshold",
            "scenario 54 (the threshold for 3), call 3, settle:",
        ),
    ],
)
def test_a_planted_fault_is_found_at_its_first_call(
    right: str, wrong: str, first: str, tmp_path: Path
) -> None:
    status, printed = play_on_host(tmp_path, core_with(tmp_path, right, wrong))
    assert status == 1
    assert printed.endswith("FAIL\n")
    told = explain(printed, SCENARIOS).splitlines()
    assert told[0] == first
    assert told[1].startswith("  expected status")
    assert told[2].startswith("  found    status")
    assert told[1][11:] != told[2][11:]


def test_a_fault_in_the_vectors_is_found(tmp_path: Path) -> None:
    spoilt = tmp_path / "spoilt.bin"
    edges = VECTORS[0].read_bytes()
    spoilt.write_bytes(edges[:6] + bytes([edges[6] ^ 1]) + edges[7:])
    status, printed = play_on_host(tmp_path, f"GOLDEN_VECTORS={spoilt}")
    assert status == 1
    assert "every call agrees" in explain(printed, SCENARIOS)


def test_the_player_counts_what_it_plays(tmp_path: Path) -> None:
    empty = tmp_path / "empty.bin"
    empty.write_bytes(b"nothing")
    assert play_on_host(tmp_path, f"GOLDEN_VECTORS={empty}") == (0, "PASS scenarios 0 calls 0 ticks 0\n")
