"""Programs in other languages use the firmware as a shared library, whose symbols are all that they know."""

from __future__ import annotations

import ctypes
import re
from pathlib import Path

import pytest

from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Config, Filter, Observation
from support import CORE, HEADER, ROOT, blocks, require, run

PAGE = ROOT / "docs/porting.md"
SIZE_MAX = 168
"""MCP_ASDF_SIZE_MAX, which a caller without the header has to know."""
ROBUST = 3
TICKS = 300


class CConfig(ctypes.Structure):
    """``mcp_asdf_config_t``."""

    _fields_ = (
        ("table", ctypes.c_void_p),
        ("filter_period", ctypes.c_uint32),
        ("memory", ctypes.c_uint32),
        ("filter", ctypes.c_uint8),
    )


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shared library that the commands of docs/porting.md build."""
    folder = tmp_path_factory.mktemp("library")
    require("cmake")
    (folder / "c_ref").symlink_to(ROOT / "c_ref")
    [commands] = [block for block in blocks(PAGE, "sh") if "BUILD_SHARED_LIBS" in block]
    run("sh", "-exc", commands, cwd=folder)
    [path] = folder.glob("build/**/libmcp_asdf.so")
    return path


def inline_functions() -> set[str]:
    """Return the names of the header's inline functions."""
    text = HEADER.read_text(encoding="utf-8")
    return set(re.findall(r"^MCP_ASDF_INLINE [^(\n]*?(mcp_asdf_\w+)\(", text, re.MULTILINE))


def symbols_in(path: Path, *options: str) -> set[str]:
    """Return the names that ``nm`` lists of an object file or a library."""
    return {line.split()[-1] for line in run("nm", *options, path).splitlines()}


# --- Symbols ---------------------------------------------------------------------------------------------


def test_every_inline_function_is_a_symbol_of_the_library(library: Path) -> None:
    assert len(inline_functions()) == 11
    assert inline_functions() <= symbols_in(library, "--dynamic", "--defined-only")


def test_no_function_of_the_header_is_inline_but_by_the_macro() -> None:
    """Whoever defines the macro otherwise makes symbols of all these functions."""
    text = HEADER.read_text(encoding="utf-8").replace("MCP_ASDF_INLINE static inline", "")
    assert "static inline" not in text


@pytest.mark.parametrize(
    ("filter_name", "function"), [("ASDF", "mcp_asdf_beta"), ("ROBUST", "mcp_asdf_crowd")]
)
def test_a_library_without_a_filter_lacks_the_symbol_of_that_filter_alone(
    filter_name: str, function: str, tmp_path: Path
) -> None:
    strict = ("-std=c99", "-Wall", "-Wextra", "-Wmissing-prototypes", "-Werror")
    source, accessors = CORE.with_name("mcp_asdf_accessors.c"), tmp_path / "accessors.o"
    run("gcc", *strict, f"-DMCP_ASDF_WITH_{filter_name}=0", "-c", source, "-o", accessors)
    assert symbols_in(accessors) == inline_functions() - {function}


# --- Generators of bindings ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def syntax_tree(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The header as a generator of bindings reads it: clang's tree of a program that includes it."""
    program = tmp_path_factory.mktemp("bindings") / "program.c"
    program.write_text('#include "mcp_asdf.h"\n')
    dump = ("-fsyntax-only", "-Xclang", "-ast-dump", "-fno-color-diagnostics")
    options = ("-std=c99", *dump, "-DMCP_ASDF_INLINE=extern", f"-I{CORE.parent}")
    return run(require("clang", "clang"), *options, program)


def test_a_generator_of_bindings_finds_no_inline_function(syntax_tree: str) -> None:
    """It would leave them out."""
    functions = [
        line for line in syntax_tree.splitlines() if re.search(r"FunctionDecl .* mcp_asdf_\w+ ", line)
    ]
    assert len(functions) > len(inline_functions())
    assert not any(line.endswith((" inline", " static")) for line in functions)


def test_a_generator_of_bindings_finds_no_type_without_a_name(syntax_tree: str) -> None:
    """It would fail."""
    types = re.findall(r"FieldDecl .* \w+ '([^']*)'", syntax_tree)
    assert types
    assert not any("unnamed" in name or "anonymous" in name for name in types)


# --- ctypes ----------------------------------------------------------------------------------------------


def load_with_return_types(library: Path) -> ctypes.CDLL:
    """Load the library, and declare what its functions return where that is no int."""
    firmware = ctypes.CDLL(str(library))
    firmware.mcp_asdf_beta.restype = ctypes.c_uint64
    for name in ("x_hat", "alpha", "x", "b_hat", "t_count"):
        getattr(firmware, f"mcp_asdf_{name}").restype = ctypes.c_uint32
    return firmware


def test_a_robot_that_ctypes_steps_does_what_the_mirror_does(library: Path) -> None:
    firmware = load_with_return_types(library)
    config = CConfig(None, 100, 2**31, ROBUST)
    robot = (ctypes.c_uint64 * (SIZE_MAX // 8))()
    mirror = MirrorRobot(Config(filter=Filter.ROBUST, filter_period=100), 7, 0.55)
    b_hat = ctypes.c_uint32(mirror.b_hat_raw)
    assert firmware.mcp_asdf_init(robot, ctypes.byref(config), 7, b_hat) == 0
    for tick in range(TICKS):
        for sender in range(3):
            x_hat, alpha = 7_000_000 + 1000 * sender + tick, 0x80000010
            firmware.mcp_asdf_receive(robot, sender, x_hat, ctypes.c_uint32(alpha))
            mirror.receive_raw(sender, x_hat, alpha)
        is_black = tick % 8 != 0
        firmware.mcp_asdf_step(robot, int(is_black))
        mirror.step(Observation(is_black))
    assert firmware.mcp_asdf_id(robot) == 7
    assert firmware.mcp_asdf_t_count(robot) == TICKS
    assert firmware.mcp_asdf_x_hat(robot) == mirror.x_hat_raw
    assert firmware.mcp_asdf_alpha(robot) == mirror.alpha_raw
    assert firmware.mcp_asdf_b_hat(robot) == mirror.b_hat_raw != b_hat.value, "the filter has run"
    assert firmware.mcp_asdf_x(robot) == mirror.x_raw
    assert firmware.mcp_asdf_beta(robot) == 0
    assert firmware.mcp_asdf_thousandths(firmware.mcp_asdf_x(robot)) == round(1000 * mirror.x)
