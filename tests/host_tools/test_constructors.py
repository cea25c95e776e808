"""Parameters are coerced to their type, or refused with their name, the value and a fix."""

from __future__ import annotations

from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.parameters import parameters_of
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.swarm.settings import SwarmSettings

WRONG: list[Any] = [
    *(None, True, False, -1, 0, 1, 2, 3.0, 2.5, 10**30, -(10**400), 1j, Fraction(1, 3)),
    *(float("nan"), float("inf"), -float("inf"), Decimal("NaN"), Decimal("sNaN"), Decimal("0.25")),
    *("", "x", "\0", "0.5", "²", "30%", "nan%", "1e999%", "none", "dynamic", "0 0", "3 >", b"x"),
    *([], [1], (), {}, {"a": 1}, {1, 200}, object(), int, np.float32(0.5), np.zeros(3)),
]
PLACES = [(kind, name) for kind in (Experiment, SwarmSettings) for name in parameters_of(kind)]


def attempt(kind: Any, name: str, value: Any) -> None:
    """Make an instance with a value of the right type and in range, or raise a UsageError that explains."""
    declared = parameters_of(kind)[name]
    try:
        made = getattr(kind(**{name: value}), name)
    except UsageError as error:
        assert name in str(error)
        assert ";" in str(error) or ":" in str(error), f"no fix: {error}"
        return
    if declared.kind in (int, float):
        assert type(made) is declared.kind
        assert made == declared.kind(value)
        assert declared.minimum <= made <= declared.maximum
    if declared.choices:
        assert made in declared.choices


for_every_parameter = pytest.mark.parametrize(
    ("kind", "name"), PLACES, ids=lambda each: getattr(each, "__name__", each)
)


@for_every_parameter
def test_a_wrong_value_of_a_parameter_is_converted_or_refused_with_a_fix(kind: Any, name: str) -> None:
    """Values of many types and forms, most of which no user would give on purpose."""
    for value in WRONG:
        attempt(kind, name, value)


for_every_number = pytest.mark.parametrize(
    ("kind", "name"),
    [(kind, name) for kind, name in PLACES if parameters_of(kind)[name].kind in (int, float)],
    ids=lambda each: getattr(each, "__name__", each),
)


@for_every_number
def test_the_ends_of_a_parameter_s_range_are_accepted(kind: Any, name: str) -> None:
    parameter = parameters_of(kind)[name]
    for value in (parameter.minimum, parameter.maximum):
        assert parameter.convert(value) == value


@for_every_number
def test_numbers_beyond_a_parameter_s_range_are_refused_with_the_range(kind: Any, name: str) -> None:
    parameter = parameters_of(kind)[name]
    for value in (parameter.minimum - 1, 2 * parameter.maximum + 1):
        with pytest.raises(UsageError, match=f"{name} is .*; it must be .* to "):
            parameter.convert(value)
