"""Public dataclasses coerce a field to its type, or refuse it with its name, the value and a fix."""

from __future__ import annotations

import re
from dataclasses import fields
from decimal import Decimal
from enum import Enum
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.native import NativeRobot
from mcp_asdf.reference import ReferenceRobot
from mcp_asdf.robot import Config, Filter, FirmwareError
from mcp_asdf_tools.bus.frames import FrameFormat
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.engine import native
from mcp_asdf_tools.experiments.experiment import Experiment, grid
from mcp_asdf_tools.radio.neighbourhood import RadioSettings
from mcp_asdf_tools.robots.node import NodeSettings, Subjects
from mcp_asdf_tools.robots.population import Filtering, Population
from mcp_asdf_tools.robots.record import RobotRecord
from mcp_asdf_tools.robots.rounds import TickConfig
from mcp_asdf_tools.swarm.fault_spec import Fault, FaultKind
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.world.settings import Drift, Floor, Topology, WorldSettings
from mcp_asdf_tools.world.topology import Graph
from support import draws

pytestmark = pytest.mark.random

SOUND: dict[type[Any], dict[str, Any]] = {
    WorldSettings: {},
    Population: {},
    Experiment: {},
    SwarmSettings: {},
    Graph: {"links": frozenset({(0, 1)})},
    FrameFormat: {},
    Subjects: {},
    NodeSettings: {"id": 3},
    RadioSettings: {
        "controller": RobotRecord(0, "mirror", 0.75, TickConfig(filter=Filter.OFF)),
        "neighbours": (),
        "swarm": SwarmSettings(robots=1, flawed=0),
        "subjects": Subjects(),
    },
    Fault: {"kind": FaultKind.LOSS},
}
"""Public dataclasses of the tools that people fill in, and what they must be given."""

NAMES = {
    "start": "from",
    "stop": "to",
    "faults": "fault",
    "steps_per_second": "steps-per-second",
    "telemetry_period": "telemetry-period",
}
"""Names of fields in messages where they are others."""

WRONG: list[Any] = [
    *(None, True, False, -1, 0, 1, 2, 3.0, 2.5, 10**30, -(10**400)),
    *(
        float("nan"),
        float("inf"),
        -float("inf"),
        Decimal("NaN"),
        Decimal("sNaN"),
        Decimal("0.25"),
        Decimal(10),
    ),
    *("", "x", "\0", "0.5", "²", "30%", "nan%", "1e999%", "none", "dynamic", "0 0", "3 >", "loss", "loss=2"),
    *(b"x", [], [1], (), (1, 2), {}, {"a": 1}, set(), {1, 200}, frozenset({"a"}), [None], [[1, 2]]),
    *(1j, object(), int, len, Fraction(1, 3), np.float32(0.5), np.int64(7), np.bool_(True), np.zeros(3)),
    *(
        Filter.ALWAYS,
        Filtering.NONE,
        Topology.DYNAMIC,
        Floor.CODE,
        Drift.WIENER,
        FaultKind.DELAY,
        FrameFormat(7),
    ),
]

FIELDS = [(kind, field.name) for kind in SOUND for field in fields(kind)]


def attempt(kind: type[Any], name: str, value: Any) -> None:
    """Either an instance with a value of the right type, or a UsageError that explains."""
    sound = SOUND[kind]
    try:
        made = kind(**{**sound, name: value})
    except UsageError as error:
        assert not isinstance(value, Exception)
        words = str(error)
        assert name in words or NAMES.get(name, name) in words, words
        assert ";" in words or ":" in words, f"no fix: {words}"
    else:
        default = getattr(kind(**sound), name)
        if isinstance(default, Enum | bool | int | float | str | Decimal) and name not in (
            "topology",
            "graph",
        ):
            assert type(getattr(made, name)) is type(default), (kind, name, value)


@pytest.mark.parametrize(("kind", "name"), FIELDS, ids=lambda each: getattr(each, "__name__", each))
def test_a_wrong_value_is_coerced_or_refused(kind: type[Any], name: str) -> None:
    for value in WRONG:
        attempt(kind, name, value)


ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.binary() | st.decimals()
    | st.fractions() | st.complex_numbers(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=2),
    max_leaves=4,
)  # fmt: skip


@settings(deadline=None, max_examples=draws(600))
@given(st.sampled_from(FIELDS), ANYTHING)
def test_anything_is_coerced_or_refused(place: tuple[type[Any], str], value: Any) -> None:
    attempt(*place, value)


def test_what_is_unambiguous_is_coerced() -> None:
    given: dict[str, Any] = {
        "robots": Decimal(8),
        "steps": np.int64(100),
        "filter": "asdf-minus",
        "omega": 0.25,
    }
    made = Experiment(**given, fill_ratio=1)
    assert (made.robots, made.steps, made.filter) == (8, 100, Filtering.ASDF_MINUS)
    assert (type(made.robots), type(made.steps), type(made.fill_ratio)) == (int, int, float)
    given = {"kind": "delay", "ticks": 2.0, "robots": [3, 1], "stop": np.uint8(9)}
    assert Fault(**given) == Fault(FaultKind.DELAY, ticks=2, robots=frozenset({1, 3}), stop=9)
    given = {"subject": 3000.0, "priority": np.int8(1)}
    assert FrameFormat(**given) == FrameFormat(3000, 1)


@pytest.mark.parametrize(
    ("kind", "values", "words"),
    [
        (Experiment, {"filter": "asdf_plus"}, "filter is 'asdf_plus'; choose one of none, asdf-minus"),
        (Experiment, {"topology": "ring"}, "topology is 'ring'; choose one of fully-connected"),
        (Experiment, {"flawed": True}, "flawed is True; give a count, 0 to 20, or a share"),
        (SwarmSettings, {"filter": "plus"}, "filter is 'plus'; choose one of none, asdf-minus"),
        (SwarmSettings, {"faults": "loss=0.1"}, "faults is 'loss=0.1'; give several in a list or tuple"),
        (SwarmSettings, {"faults": [3]}, "faults is 3; give a Fault"),
        (Fault, {"kind": "lost"}, "kind is 'lost'; choose one of loss, burst"),
        (FrameFormat, {"subject": None}, "subject is None; give a number"),
        (grid, {"filter": []}, "filter makes 0 experiments; give 1 to 100000"),
        (grid, {"filtre": "none"}, "unknown key 'filtre'; known are robots, topology"),
    ],
)  # fmt: skip
def test_messages_name_field_value_and_fix(kind: Any, values: dict[str, Any], words: str) -> None:
    with pytest.raises(UsageError, match=re.escape(words)):
        kind(**values)


@pytest.mark.parametrize("kind", [MirrorRobot, NativeRobot, ReferenceRobot])
@pytest.mark.parametrize("name", [field.name for field in fields(Config)])
def test_a_robot_refuses_a_wrong_config_by_name(kind: Any, name: str) -> None:
    """With the firmware's own error or, for a value that is no integer, a TypeError that names it."""
    for value in WRONG:
        config = {"filter": Filter.OFF, name: value}
        try:
            kind(Config(**config), 1, 0.75)
        except (FirmwareError, TypeError) as error:
            assert name in str(error), (value, error)


@pytest.mark.parametrize(
    "experiment",
    [
        Experiment(topology="graph", graph="0 1", robots=2),
        Experiment(latency=1),
        Experiment(observation_period=2),
        Experiment(topology="dynamic", white_offset=-0.1),
        Experiment(firmware="mirror"),
    ],
    ids=["graph", "latency", "observations", "two accuracies", "firmware"],
)
def test_the_engine_in_c_refuses_what_it_lacks(experiment: Experiment) -> None:
    with pytest.raises(UsageError, match="the engine in C"):
        native.run(experiment, 0, 1)
