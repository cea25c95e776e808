"""The C firmware through cffi: its numbers are the header's, and C memory lives as long as it is used."""

from __future__ import annotations

import gc
import re
import weakref
from dataclasses import replace
from enum import IntEnum

import pytest

import mcp_asdf
from mcp_asdf import fixed_point, image_format, mirror, reference, robot, robust_filter, robust_reference
from mcp_asdf.native import NativeRobot, ffi, lib
from mcp_asdf.robot import Config, Filter, Observation, Status
from mcp_asdf.table import EXTRA_WORDS, MAX_Q
from robots import OWN_ID, TABLE
from support import ROOT

# --- Numbers of the header -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("c_type", "enum"),
    [("mcp_asdf_status_t", Status), ("mcp_asdf_filter_t", Filter), ("mcp_asdf_observation_t", Observation)],
)
def test_enums_are_those_of_the_header(c_type: str, enum: type[IntEnum]) -> None:
    """The enums are the results of calls, the filters and the two colours, with the same names and numbers.

    In C the names begin with MCP_ASDF_, as in MCP_ASDF_OK.
    """
    numbers_by_name = {f"MCP_ASDF_{member.name}": member.value for member in enum}

    names_by_number_in_c = ffi.typeof(c_type).elements

    numbers_by_name_in_c = {name: number for number, name in names_by_number_in_c.items()}
    assert numbers_by_name_in_c == numbers_by_name


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("ONE", fixed_point.ONE),
        ("HALF", fixed_point.HALF),
        ("MAX_ID", robot.MAX_ID),
        ("B_HAT_MIN", fixed_point.B_HAT_MIN),
        ("B_HAT_MAX", fixed_point.B_HAT_MAX),
        ("MEMORY_MIN", robot.MIN_MEMORY),
        ("MEMORY_MAX", robot.DEFAULT_MEMORY),
        ("IMAGE_SIZE", 4 * image_format.ROBUST_IMAGE_WORDS),
        ("ASDF_IMAGE_SIZE", 4 * image_format.ASDF_IMAGE_WORDS),
        ("IMAGE_VERSION", image_format.IMAGE_VERSION),
        ("SLOTS", robust_filter.SLOTS),
        ("TESTED_ESTIMATES_MIN", robust_filter.TESTED_ESTIMATES_MIN),
        ("CENTRE_START", robust_filter.CENTRE_START),
        ("SPREAD_MIN", robust_filter.SPREAD_MIN),
        ("SPREAD_MAX", robust_filter.SPREAD_MAX),
        ("VOTES_MAX", robust_filter.VOTES_MAX),
        ("DISPERSION_MIN", robust_filter.DISPERSION_MIN),
    ],
)
def test_constants_are_those_of_the_header(name: str, value: int) -> None:
    """``value`` is a constant of the Python packages, and MCP_ASDF_ with ``name`` that of the header."""
    value_in_c = getattr(lib, f"MCP_ASDF_{name}")
    assert value_in_c == value


def test_the_default_config_is_that_of_the_header() -> None:
    """The header's is a macro, which Python cannot read: tests/c_ref/test_core.c checks the same members."""
    largest_memory = lib.MCP_ASDF_MEMORY_MAX
    assert Config() == Config(table=None, filter=Filter.ADAPTIVE, filter_period=1000, memory=largest_memory)


@pytest.mark.parametrize(
    "name", ["VOTES_OF_MAX_GAIN", "HUBER_STEPS", "REJECTED_SIGMAS_SQUARED", "DISPERSION_SHIFT"]
)
def test_the_robust_filter_has_the_same_constants_in_c_and_python(name: str) -> None:
    """In C they are macros of a private header, which the compiled module hides: so the header is read."""
    header = (ROOT / "c_ref/src/mcp_asdf_robust.h").read_text(encoding="utf-8")

    # The line is "#define NAME 12", in which the number may also be 12U or UINT32_C(12).
    [value_in_c] = re.findall(rf"^#define {name} (?:UINT32_C\()?(\d+)U?\)?$", header, re.MULTILINE)

    assert int(value_in_c) == getattr(robust_filter, name)


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("SLOTS", 1),
        ("CENTRE_START", 2**-30),
        ("SPREAD_MIN", 2**-30),
        ("SPREAD_MAX", 2**-30),
        ("VOTES_MAX", 1),
        ("VOTES_OF_MAX_GAIN", 1),
        ("TESTED_ESTIMATES_MIN", 1),
        ("HUBER_STEPS", 1),
        ("REJECTED_SIGMAS_SQUARED", 1),
        ("DISPERSION_MIN", 2**-8),
        ("DISPERSION_MAX", 2**-8),
        ("DISPERSION_SHIFT", 1),
    ],
)
def test_the_robust_filter_has_the_same_constants_in_integers_and_in_floats(name: str, unit: float) -> None:
    """The mirror computes with integers, whose unit is ``unit``, and the reference with floats."""
    integer_of_mirror = getattr(robust_filter, name)
    float_of_reference = getattr(robust_reference, name)
    assert integer_of_mirror * unit == float_of_reference


def test_an_accuracy_carries_no_information_at_the_same_limit_in_integers_and_in_floats() -> None:
    """The limit of |2 b_hat - 1|, which the mirror has in units of 2**-32."""
    assert mirror.INFORMATIVE_G / 2**32 == reference.INFORMATIVE_G


# --- Memory of the C -------------------------------------------------------------------------------------


def overwrite_freed_memory() -> None:
    """Allocate and free arrays of about a table's size, which take the place of memory that was freed."""
    gc.collect()
    words_of_a_table = 40
    _ = [ffi.new("uint32_t[]", [0xAAAAAAAA] * words_of_a_table) for _ in range(1000)]


def test_the_settings_of_a_c_robot_are_not_freed_while_it_lives() -> None:
    """The C robot has a pointer to them, which Python's garbage collector does not see."""
    copy_of_table = replace(TABLE)  # to which only the robot refers, once the name is deleted
    robot = NativeRobot(Config(copy_of_table, filter_period=7), OWN_ID, b_hat=0.8)
    del copy_of_table

    overwrite_freed_memory()

    config_in_c = robot.pointer.config
    words_in_c = ffi.unpack(config_in_c.table, len(TABLE.words()))
    assert config_in_c.filter_period == 7
    assert tuple(words_in_c) == TABLE.words()


def test_the_settings_of_a_c_robot_are_freed_with_it() -> None:
    """Otherwise a swarm that makes many robots would need more and more memory."""
    robot = NativeRobot(Config(replace(TABLE), filter_period=7), OWN_ID, b_hat=0.8)
    settings_in_c = weakref.ref(robot._c_config)  # the private owner of the memory

    del robot
    gc.collect()

    assert settings_in_c() is None


def test_a_table_in_c_is_followed_by_zeros_up_to_the_length_of_the_longest_one() -> None:
    """If the table's length is damaged, the C may read as many words as the longest table has."""
    robot = NativeRobot(Config(TABLE), OWN_ID, b_hat=0.8)
    words_of_table = list(TABLE.words())
    length_of_longest_table = EXTRA_WORDS + MAX_Q  # the entries, and the words before and after them

    words_in_c = ffi.unpack(robot.pointer.config.table, length_of_longest_table)

    zeros = [0] * (length_of_longest_table - len(words_of_table))
    assert words_in_c == words_of_table + zeros


# --- The package -----------------------------------------------------------------------------------------


def test_the_package_offers_the_compiled_firmware() -> None:
    """It is loaded at its first use, so that the package also works where nothing could be compiled."""
    assert mcp_asdf.NativeRobot is NativeRobot


def test_the_package_has_no_other_attributes() -> None:
    """Python asks the function that loads NativeRobot for every name that the package does not have."""
    with pytest.raises(AttributeError, match="module 'mcp_asdf' has no attribute 'NoRobot'"):
        mcp_asdf.NoRobot  # noqa: B018
