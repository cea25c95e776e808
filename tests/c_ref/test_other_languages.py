"""Programs in other languages use the firmware as a shared library, whose symbols are all that they know."""

from __future__ import annotations

import ctypes
import re
from decimal import Decimal
from pathlib import Path

import pytest

from ctypes_robot import CtypesRobot, robot_size
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Config, Filter, Observation
from mcp_asdf_tools.tables.thresholds import generate
from support import CORE, HEADER, ROOT, block_with, require, run

PAGE = ROOT / "docs/platforms/elsewhere.md"
RUST_PROGRAM = ROOT / "c_ref/examples/rust/robot.rs"
ROBOT_ID = 7
INITIAL_B_HAT = 0.55
TICKS = 300


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shared library that the commands of docs/platforms/elsewhere.md build."""
    folder = tmp_path_factory.mktemp("library")
    require("cmake")
    (folder / "c_ref").symlink_to(ROOT / "c_ref")
    run("sh", "-exc", block_with(PAGE, "BUILD_SHARED_LIBS", "sh"), cwd=folder)
    return folder / "build/shared/libmcp_asdf.so"


def inline_functions() -> set[str]:
    """Return the names of the header's inline functions."""
    text = HEADER.read_text(encoding="utf-8")
    return set(re.findall(r"^MCP_ASDF_INLINE [^(\n]*?(mcp_asdf_\w+)\(", text, re.MULTILINE))


def symbols_in(path: Path, *options: str) -> set[str]:
    """Return the names that ``nm`` lists of an object file or a library."""
    return {line.split()[-1] for line in run("nm", *options, path).splitlines()}


# --- Symbols ---------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_every_inline_function_is_a_symbol_of_the_library(library: Path) -> None:
    """Another language can call only functions that are symbols. The C header has eleven inline functions."""
    exported_symbols = symbols_in(library, "--dynamic", "--defined-only")
    assert len(inline_functions()) == 11
    assert inline_functions() <= exported_symbols


def test_every_inline_function_of_the_header_is_inline_by_the_macro() -> None:
    """The macro is MCP_ASDF_INLINE; defined as ``extern`` it makes symbols of all these functions.

    Generators of bindings leave out functions that are inline.
    """
    text = HEADER.read_text(encoding="utf-8")
    assert re.findall(r"^(?:static )?inline .*", text, re.MULTILINE) == []


@pytest.mark.parametrize(
    ("filter_left_out", "function_left_out"), [("ASDF", "mcp_asdf_beta"), ("ROBUST", "mcp_asdf_robust")]
)
def test_a_library_without_a_filter_lacks_only_the_symbol_of_that_filter(
    filter_left_out: str, function_left_out: str, tmp_path: Path
) -> None:
    """mcp_asdf_accessors.c makes symbols of the functions that the header defines inline.

    One of them reads what a filter remembers. A macro leaves that filter out, and only this function with it.
    """
    strict = ("-std=c99", "-Wall", "-Wextra", "-Wmissing-prototypes", "-Werror")
    source, compiled = CORE.with_name("mcp_asdf_accessors.c"), tmp_path / "accessors.o"

    run("gcc", *strict, f"-DMCP_ASDF_WITH_{filter_left_out}=0", "-c", source, "-o", compiled)

    assert symbols_in(compiled) == inline_functions() - {function_left_out}


# --- Generators of bindings ------------------------------------------------------------------------------


def syntax_tree_of_header(folder: Path) -> str:
    """Return the header as a generator of bindings reads it: clang's tree of a program that includes it."""
    program = folder / "program.c"
    program.write_text('#include "mcp_asdf.h"\n')
    dump = ("-fsyntax-only", "-Xclang", "-ast-dump", "-fno-color-diagnostics")
    options = ("-std=c99", *dump, "-DMCP_ASDF_INLINE=extern", f"-I{CORE.parent}")
    return run(require("clang", "clang"), *options, program)


def test_a_generator_of_bindings_finds_no_type_without_a_name(tmp_path: Path) -> None:
    """A generator fails at such a type. Clang's tree calls it "unnamed struct" or "anonymous union".

    A line of the tree about a member is, say, "FieldDecl 0x5b <place> x_hat 'uint32_t':'unsigned int'".
    """
    types_of_members = re.findall(r"FieldDecl .* \w+ '([^']*)'", syntax_tree_of_header(tmp_path))
    nameless = [type_name for type_name in types_of_members if re.search("unnamed|anonymous", type_name)]

    assert len(types_of_members) > 0
    assert nameless == []


@pytest.mark.slow
def test_rust_s_bindgen_finds_only_functions_that_the_library_has(library: Path) -> None:
    """It also finds all functions that the header defines inline."""
    require("bindgen", "bindgen")
    folder_of_commands = library.parents[2]  # the library is in build/shared there

    run("sh", "-exc", block_with(PAGE, "bindgen", "sh"), cwd=folder_of_commands)

    bindings = (folder_of_commands / "build/mcp_asdf.rs").read_text(encoding="utf-8")
    functions = set(re.findall(r"pub fn (mcp_asdf_\w+) ?\(", bindings))
    assert inline_functions() < functions
    assert functions <= symbols_in(library, "--dynamic", "--defined-only")


# --- Robots ----------------------------------------------------------------------------------------------


def estimate_at(tick: int, sender: int) -> tuple[int, int]:
    """Return x_hat and alpha, as the firmware's integers, that a neighbour broadcasts in a tick."""
    x_hat = 7_000_000 + 1000 * sender + tick  # about 0.83, in units of 2^-23
    alpha = 0x80000010  # 2^15: a mantissa of 2^23, shifted by 16, in units of 2^-24
    return x_hat, alpha


def is_black_at(tick: int) -> bool:
    """Return what the robot's sensor reads in a tick: three tiles of four are black."""
    return tick % 4 != 0


def run_robot_in_python(config: Config) -> MirrorRobot:
    """Return a robot in Python after all ticks. Three neighbours broadcast in each tick."""
    mirror = MirrorRobot(config, ROBOT_ID, INITIAL_B_HAT)
    for tick in range(TICKS):
        for sender in range(3):
            mirror.receive_raw(sender, *estimate_at(tick, sender))
        mirror.step(Observation(is_black_at(tick)))
    return mirror


def run_robot_by_ctypes(library: Path, config: Config) -> CtypesRobot:
    """Return a robot of the library after all ticks. Three neighbours broadcast in each tick."""
    robot = CtypesRobot(ctypes.CDLL(str(library)), config, ROBOT_ID, INITIAL_B_HAT)
    for tick in range(TICKS):
        for sender in range(3):
            robot.receive(sender, *estimate_at(tick, sender))
        robot.step(is_black_at(tick))
    return robot


ROBUST_FILTER = Config(filter=Filter.ROBUST, filter_period=100)
PAPER_S_FILTER = Config(table=generate(Decimal("0.05"), q=4), filter_period=100)


@pytest.mark.parametrize("config", [ROBUST_FILTER, PAPER_S_FILTER], ids=["robust", "the paper's"])
def test_a_robot_that_ctypes_steps_has_the_bits_of_the_robot_in_python(library: Path, config: Config) -> None:
    """Both run 300 ticks with each filter, and receive three neighbours. t_count is the number of ticks."""
    robot = run_robot_by_ctypes(library, config)
    in_python = run_robot_in_python(config)

    numbers = {name: robot.read(name) for name in ("id", "t_count", "x_hat", "alpha", "b_hat", "x")}
    assert numbers == {
        "id": ROBOT_ID,
        "t_count": TICKS,
        "x_hat": in_python.x_hat_raw,
        "alpha": in_python.alpha_raw,
        "b_hat": in_python.b_hat_raw,
        "x": in_python.x_raw,
    }
    assert robot.read("beta", ctypes.c_uint64) == in_python.beta_raw  # the only number of 64 bits


def test_the_rust_program_reserves_a_robot_s_memory() -> None:
    """It cannot read the C header. So if a robot needs more memory in C, the Rust program has to change."""
    assert f"const ROBOT_SIZE: usize = {robot_size()};" in RUST_PROGRAM.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def output_of_rust(library: Path) -> str:
    """Output of the Rust program that the page's commands build and run."""
    require("rustc", "rustc")
    commands = block_with(PAGE, "rustc", "sh").replace("rustc ", "rustc -D warnings ")
    folder_of_commands = library.parents[2]  # the library is in build/shared there
    return run("sh", "-exc", commands, cwd=folder_of_commands)


def test_a_robot_that_rust_steps_has_the_bits_of_the_robot_in_python(output_of_rust: str) -> None:
    """The program has the robust filter, and prints the integers of a robot after 300 ticks.

    The robot in Python gets the same tiles and messages.
    """
    robot = run_robot_in_python(ROBUST_FILTER)
    assert output_of_rust == f"x_hat {robot.x_hat_raw} x {robot.x_raw} b_hat {robot.b_hat_raw}\n"


def test_the_rust_program_prints_what_docs_elsewhere_shows(output_of_rust: str) -> None:
    """The commands of docs/platforms/elsewhere.md have built and run it, and the output stands there."""
    assert output_of_rust == block_with(PAGE, "x_hat 8388608", "text")
