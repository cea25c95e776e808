"""Programs in other languages use the firmware as a shared library, whose symbols are all they know."""

from __future__ import annotations

import ctypes
import re
from pathlib import Path

import pytest

from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Config, Filter, Observation
from support import CORE, HEADER, blocks, require, run

PAGE = CORE.parents[2] / "docs/porting.md"
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
    (folder / "c_ref").symlink_to(CORE.parents[1])
    [commands] = [block for block in blocks(PAGE, "sh") if "BUILD_SHARED_LIBS" in block]
    run("sh", "-exc", commands, cwd=folder)
    [path] = folder.glob("build/**/libmcp_asdf.so")
    return path


def inline_functions() -> set[str]:
    text = HEADER.read_text(encoding="utf-8")
    return set(re.findall(r"^MCP_ASDF_INLINE [^(\n]*?(mcp_asdf_\w+)\(", text, re.MULTILINE))


def test_every_inline_function_is_a_symbol_of_the_library(library: Path) -> None:
    symbols = {line.split()[-1] for line in run("nm", "--dynamic", "--defined-only", library).splitlines()}
    assert len(inline_functions()) == 11
    assert inline_functions() <= symbols
    assert "static inline" not in HEADER.read_text(encoding="utf-8").replace(
        "MCP_ASDF_INLINE static inline", ""
    )


@pytest.mark.parametrize("left_out", ["ASDF", "ROBUST"])
def test_builds_of_one_filter_have_the_symbols_that_their_header_declares(
    left_out: str, tmp_path: Path
) -> None:
    flags = (
        "-std=c99",
        "-Wall",
        "-Wextra",
        "-Wmissing-prototypes",
        "-Werror",
        f"-DMCP_ASDF_WITH_{left_out}=0",
    )
    run("gcc", *flags, "-c", CORE.with_name("mcp_asdf_accessors.c"), "-o", tmp_path / "accessors.o")
    symbols = {line.split()[-1] for line in run("nm", tmp_path / "accessors.o").splitlines()}
    missing = "mcp_asdf_beta" if left_out == "ASDF" else "mcp_asdf_crowd"
    assert symbols == inline_functions() - {missing}


def test_a_binding_generator_sees_no_inline_function(tmp_path: Path) -> None:
    """Generators leave out inline functions, and fail on types without a name."""
    (tmp_path / "program.c").write_text('#include "mcp_asdf.h"\n')
    clang = require("clang", "clang")
    flags = ("-fsyntax-only", "-Xclang", "-ast-dump", "-fno-color-diagnostics", "-DMCP_ASDF_INLINE=extern")
    tree = run(clang, "-std=c99", *flags, f"-I{CORE.parent}", tmp_path / "program.c")
    functions = [line for line in tree.splitlines() if re.search(r"FunctionDecl .* mcp_asdf_\w+ ", line)]
    assert len(functions) > len(inline_functions())
    assert not [line for line in functions if line.endswith((" inline", " static"))]
    members = re.findall(r"FieldDecl .* \w+ '([^']*)'", tree)
    assert members and not [kind for kind in members if "unnamed" in kind or "anonymous" in kind]


def test_ctypes_steps_a_robot_by_the_symbols_alone(library: Path) -> None:
    firmware = ctypes.CDLL(str(library))
    firmware.mcp_asdf_beta.restype = ctypes.c_uint64
    for name in ("x_hat", "alpha", "x", "b_hat", "t_count"):
        getattr(firmware, f"mcp_asdf_{name}").restype = ctypes.c_uint32
    config = CConfig(None, 100, 2**31, ROBUST)
    robot = (ctypes.c_uint64 * (SIZE_MAX // 8))()
    mirror = MirrorRobot(Config(filter=Filter.ROBUST, filter_period=100), 7, 0.55)
    assert firmware.mcp_asdf_init(robot, ctypes.byref(config), 7, ctypes.c_uint32(mirror.b_hat_raw)) == 0
    for tick in range(TICKS):
        for sender in range(3):
            x_hat, alpha = 7_000_000 + 1000 * sender + tick, 0x80000010
            firmware.mcp_asdf_receive(robot, sender, x_hat, ctypes.c_uint32(alpha))
            mirror.receive_raw(sender, x_hat, alpha)
        is_black = tick % 8 != 0
        firmware.mcp_asdf_step(robot, int(is_black))
        mirror.observe(Observation(is_black))
        mirror.settle()
    assert firmware.mcp_asdf_id(robot) == 7
    assert firmware.mcp_asdf_t_count(robot) == TICKS
    assert firmware.mcp_asdf_x_hat(robot) == mirror.x_hat_raw
    assert firmware.mcp_asdf_alpha(robot) == mirror.alpha_raw
    assert firmware.mcp_asdf_b_hat(robot) == mirror.b_hat_raw != round(0.55 * 2**32)
    assert firmware.mcp_asdf_x(robot) == mirror.x_raw
    assert firmware.mcp_asdf_beta(robot) == 0
    assert firmware.mcp_asdf_thousandths(firmware.mcp_asdf_x(robot)) == round(1000 * mirror.x)
