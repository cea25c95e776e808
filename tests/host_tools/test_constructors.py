"""Parameters are coerced to their type, or refused with their name, the value and a fix."""

from __future__ import annotations

from decimal import Decimal
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
import pytest

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.parameters import Parameter, parameters_of
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.swarm.settings import SwarmSettings

VALUES: list[Any] = [
    *(None, True, False, -1, 0, 1, 2, 3.0, 2.5, 10**30, -(10**400), 1j, Fraction(1, 3)),
    *(float("nan"), float("inf"), -float("inf"), Decimal("NaN"), Decimal("sNaN"), Decimal("0.25")),
    *("", "x", "\0", "0.5", "²", "30%", "nan%", "1e999%", "none", "dynamic", "0 0", "3 >", b"x"),
    *([], [1], (), {}, {"a": 1}, {1, 200}, object(), int, np.float32(0.5), np.zeros(3)),
]
"""Values of many types and forms. No user would give most of them on purpose."""
PARAMETERS = [(kind, name) for kind in (Experiment, SwarmSettings) for name in parameters_of(kind)]


@cache
def try_all_values(kind: Any, name: str) -> tuple[list[tuple[Any, Any]], list[str]]:
    """Make an instance of a class with each of VALUES for a parameter.

    Returns the values that were accepted, each with what the instance has in its place, and the messages of
    errors about the others.
    """
    accepted_values: list[tuple[Any, Any]] = []
    refusals: list[str] = []
    for value in VALUES:
        try:
            instance = kind(**{name: value})
        except UsageError as error:
            refusals.append(str(error))
        else:
            accepted_values.append((value, getattr(instance, name)))
    return accepted_values, refusals


for_every_parameter = pytest.mark.parametrize(
    ("kind", "name"), PARAMETERS, ids=lambda value: getattr(value, "__name__", value)
)
NUMBERS = [(kind, name) for kind, name in PARAMETERS if parameters_of(kind)[name].kind in (int, float)]
DIFFERENT_NUMBERS = sorted(
    {parameters_of(kind)[name] for kind, name in NUMBERS}, key=lambda number: (number.name, number.maximum)
)
"""Experiment and SwarmSettings have most numbers in common, which are tried once."""
for_every_number = pytest.mark.parametrize("number", DIFFERENT_NUMBERS, ids=lambda number: number.name)


@for_every_parameter
def test_an_impossible_value_is_refused_with_the_parameter_s_name_and_a_fix(kind: Any, name: str) -> None:
    """``kind`` is Experiment or SwarmSettings. The fix stands behind a colon or semicolon of the message."""
    _, refusals = try_all_values(kind, name)
    for refusal in refusals:
        assert name in refusal
        assert ";" in refusal or ":" in refusal


@pytest.mark.parametrize(
    ("kind", "name"),
    [(kind, name) for kind, name in PARAMETERS if parameters_of(kind)[name].choices],
    ids=lambda value: getattr(value, "__name__", value),
)
def test_a_parameter_with_choices_accepts_nothing_else(kind: Any, name: str) -> None:
    """``kind`` is Experiment or SwarmSettings. For example, ``topology`` must be one of the known ones."""
    accepted_values, _ = try_all_values(kind, name)
    for _, converted_value in accepted_values:
        assert converted_value in parameters_of(kind)[name].choices


@pytest.mark.parametrize(("kind", "name"), NUMBERS, ids=lambda value: getattr(value, "__name__", value))
def test_a_number_that_is_accepted_is_converted_to_the_type_of_its_parameter(kind: Any, name: str) -> None:
    """``kind`` is Experiment or SwarmSettings. For example, 3.0 robots become the integer 3."""
    parameter = parameters_of(kind)[name]
    accepted_values, _ = try_all_values(kind, name)
    for value, converted_value in accepted_values:
        assert type(converted_value) is parameter.kind
        assert converted_value == parameter.kind(value)
        assert parameter.minimum <= converted_value <= parameter.maximum


@for_every_number
def test_the_smallest_and_the_largest_value_of_a_number_are_accepted(number: Parameter) -> None:
    """The values are returned unchanged."""
    assert number.convert(number.minimum) == number.minimum
    assert number.convert(number.maximum) == number.maximum


@for_every_number
def test_a_value_below_or_above_a_number_s_range_is_refused_with_the_range(number: Parameter) -> None:
    """The error says "it must be" and the two limits."""
    for value in (number.minimum - 1, 2 * number.maximum + 1):
        with pytest.raises(UsageError, match=f"{number.name} is .*; it must be .* to "):
            number.convert(value)
