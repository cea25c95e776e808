"""Parameters are coerced to their type, or refused with their name, the value and a fix."""

from __future__ import annotations

import re
from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.parameters import parameters_of
from mcp_asdf_tools.experiments.experiment import Experiment, grid
from mcp_asdf_tools.swarm.settings import SwarmSettings
from support import draws

pytestmark = pytest.mark.random

WRONG: list[Any] = [
    *(None, True, False, -1, 0, 1, 2, 3.0, 2.5, 10**30, -(10**400), 1j, Fraction(1, 3)),
    *(float("nan"), float("inf"), -float("inf"), Decimal("NaN"), Decimal("sNaN"), Decimal("0.25")),
    *("", "x", "\0", "0.5", "²", "30%", "nan%", "1e999%", "none", "dynamic", "0 0", "3 >", b"x"),
    *([], [1], (), {}, {"a": 1}, {1, 200}, object(), int, np.float32(0.5), np.zeros(3)),
]
PLACES = [(kind, name) for kind in (Experiment, SwarmSettings) for name in parameters_of(kind)]
ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.binary() | st.decimals(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=2),
    max_leaves=4,
)


def attempt(kind: Any, name: str, value: Any) -> None:
    """Either an instance with a value of the right type and in range, or a UsageError that explains."""
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
        assert declared.least <= made <= declared.most
    if declared.choices:
        assert made in declared.choices


@pytest.mark.parametrize(("kind", "name"), PLACES, ids=lambda each: getattr(each, "__name__", each))
def test_a_wrong_value_is_coerced_or_refused(kind: Any, name: str) -> None:
    """A range includes its ends and nothing beyond."""
    for value in WRONG:
        attempt(kind, name, value)
    declared = parameters_of(kind)[name]
    if declared.kind in (int, float):
        for value in (declared.least, declared.most):
            assert declared.checked(value) == value
        for value in (declared.least - 1, 2 * declared.most + 1):
            with pytest.raises(UsageError, match=f"{name} is .*; it must be .* to "):
                declared.checked(value)


@settings(max_examples=draws(400))
@given(st.sampled_from(PLACES), ANYTHING)
def test_anything_is_coerced_or_refused(place: tuple[Any, str], value: Any) -> None:
    attempt(*place, value)


@pytest.mark.parametrize(
    ("kind", "values", "words"),
    [
        (Experiment, {"filter": "asdf_plus"}, "filter is 'asdf_plus'; choose one of none, asdf-minus"),
        (Experiment, {"topology": "ring"}, "topology is 'ring'; choose one of fully-connected"),
        (Experiment, {"flawed": True}, "flawed is True; give a count, 0 to 20, or a share"),
        (Experiment, {"robots": 2.5}, "robots is 2.5; give a whole number"),
        (SwarmSettings, {"faults": "loss=0.1"}, "faults is 'loss=0.1'; give several in a list or tuple"),
        (grid, {"filter": []}, "filter makes 0 experiments; give 1 to 100000"),
        (grid, {"filtre": "none"}, "unknown key 'filtre'; known are robots, topology"),
    ],
)  # fmt: skip
def test_messages_name_field_value_and_fix(kind: Any, values: dict[str, Any], words: str) -> None:
    with pytest.raises(UsageError, match=re.escape(words)):
        kind(**values)
