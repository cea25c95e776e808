"""The C firmware through cffi: its numbers are the header's, and C memory lives as long as it is used."""

from __future__ import annotations

import gc
import weakref
from dataclasses import replace
from enum import IntEnum

import pytest

from mcp_asdf import fixed_point, robot
from mcp_asdf.mirror import IMAGE_MAGIC, IMAGE_WORDS
from mcp_asdf.native import NativeRobot, ffi, lib
from mcp_asdf.robot import Config, Filter, Observation, Status
from mcp_asdf.table import EXTRA_WORDS, MAX_Q
from robots import OWN_ID, TABLE


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
    # MCP_ASDF_CONFIG_ASDF's, which test_core.c checks
    assert Config() == Config(None, Filter.ADAPTIVE, filter_period=1000, memory=lib.MCP_ASDF_MEMORY_MAX)


def test_c_reads_memory_of_a_robot_s_config_for_as_long_as_the_robot_lives() -> None:
    """The table is followed by zeros up to the longest one: a damaged q may claim as many words."""
    native = NativeRobot(Config(replace(TABLE), filter_period=7), OWN_ID, 0.8)
    kept = weakref.ref(native._c_config)
    gc.collect()
    _ = [ffi.new("uint32_t[]", [0xAAAAAAAA] * 40) for _ in range(1000)]  # takes what was freed
    assert native.pointer.config.filter_period == 7
    words = native._c_config._table
    assert native.pointer.config.table == words and len(words) == EXTRA_WORDS + MAX_Q
    assert list(words) == [*TABLE.words(), *[0] * (MAX_Q - TABLE.q)]
    del native
    gc.collect()
    assert kept() is None
