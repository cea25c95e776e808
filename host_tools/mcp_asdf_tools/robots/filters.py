"""The filters that a swarm can have: which robots re-estimate their assumed accuracy, and by which test.

A robot with a filter tests its neighbours' estimates against its own every ``filter_period`` steps, and
re-estimates b_hat, the accuracy that it assumes of its sensor, if the test rejects. `FILTERS` holds one
object for each filter, with all that the tools know of it. To add a filter to the tools, add an object here.
The words "firmware filter" mean a value of ``mcp_asdf.robot.Filter``, which one robot's firmware is set to.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Literal, get_args

from mcp_asdf.robot import Filter

Activation = Literal["adaptive", "always"]
"""When a robot re-estimates b_hat, every ``filter_period`` steps: if the test rejects (eq. 12), or always."""


class FilteringRobots(Enum):
    """Robots of a swarm whose filter is on."""

    NONE = "none"
    FLAWED = "flawed"
    ALL = "all"


@dataclass(frozen=True, kw_only=True)
class SwarmFilter:
    """A choice of ``--filter``: its names, its meaning, and what it sets in the firmware of each robot.

    Attributes:
        name: Value of the option and of the parameter ``filter``.
        term: Name in reports, in ASCII; the paper's where the paper has one.
        meaning: Line of the command line's help: which robots recalibrate, and what speaks for or against it.
        description: Line for reports: the term, and which robots of the swarm recalibrate.
        robot_description: The same of a single robot, of which nobody knows whether it is flawed.
        filtering_robots: The robots that re-estimate b_hat.
        firmware_filter: Firmware filter of these robots; all others have ``Filter.OFF``.
        firmware_filter_without_test: Firmware filter of these robots if ``activation`` is always: if they
            re-estimate b_hat at each filter step, whatever a test would say. None for a filter without
            this mode.
        order_matters: Whether a robot's state depends on the order in which it receives the messages of a
            round.
        colour: Colour of its first series in a picture, as ``#rrggbb``; None for the next free one of the
            palette.
        unused_parameters: Parameters of a population that have no effect, with the reason.
        is_baseline: Whether ``swarm --compare`` runs the same swarm with it, too.
    """

    name: str
    term: str
    meaning: str
    description: str
    robot_description: str
    filtering_robots: FilteringRobots
    firmware_filter: Filter
    firmware_filter_without_test: Filter | None = None
    order_matters: bool = False
    colour: str | None = None
    unused_parameters: Mapping[str, str] = field(default_factory=dict)
    is_baseline: bool = False

    @property
    def typeset_term(self) -> str:
        """The term for pictures and pages, with a minus sign in place of the hyphen."""
        return self.term.replace("-", "\N{MINUS SIGN}")

    @property
    def is_on(self) -> bool:
        """True if any robot re-estimates b_hat."""
        return self.filtering_robots is not FilteringRobots.NONE

    def applies_to(self, is_flawed: bool) -> bool:
        """Return whether a robot re-estimates b_hat: with ASDF- only one that is flawed does.

        A robot is flawed if its b_hat is wrong at the start.
        """
        if self.filtering_robots is FilteringRobots.FLAWED:
            return is_flawed
        return self.filtering_robots is FilteringRobots.ALL

    def firmware_filter_of(self, is_flawed: bool, activation: Activation) -> Filter:
        """Return the firmware filter of a robot; ``Filter.OFF`` if it does not re-estimate b_hat.

        The ``activation`` "always" selects the firmware filter without a test, if the swarm's filter has one;
        "adaptive" selects the firmware filter with a test.
        """
        if not self.applies_to(is_flawed):
            return Filter.OFF
        if activation == "always" and self.firmware_filter_without_test is not None:
            return self.firmware_filter_without_test
        return self.firmware_filter

    def unused_parameters_with(self, activation: Activation) -> dict[str, str]:
        """Return the parameters that have no effect with this filter: the reason, a text, by their name.

        With the ``activation`` "always" the paper's filters make no test, so omega has no effect, either.
        """
        unused_parameters = dict(self.unused_parameters)
        if self._has_no_test(activation):
            # Omega is the tolerance of the test that is left out.
            unused_parameters["omega"] = "activation is always, without a test"
        return unused_parameters

    def describe(self, activation: Activation, *, is_single_robot: bool = False) -> str:
        """Return the line for reports of a swarm with the filter, or of a single robot.

        It says so if the filter re-estimates without a test, as the paper's do if ``activation`` is "always".
        """
        description = self.robot_description if is_single_robot else self.description
        if self._has_no_test(activation):
            return f"{description}, in every filter step without a test"
        return description

    def _has_no_test(self, activation: Activation) -> bool:
        """Return whether robots re-estimate b_hat without a test, as the paper's filters do by "always"."""
        return activation == "always" and self.firmware_filter_without_test is not None


_NO_FILTER = SwarmFilter(
    name="none",
    term="no filter",
    meaning="no robot",
    description="no filter: no robot recalibrates",
    robot_description="no filter: the robot does not recalibrate",
    filtering_robots=FilteringRobots.NONE,
    firmware_filter=Filter.OFF,
    colour="#999999",
    unused_parameters={"omega": "filter is none", "activation": "filter is none"},
    is_baseline=True,
)
_ASDF_MINUS = SwarmFilter(
    name="asdf-minus",
    term="ASDF-",
    meaning="only the flawed robots, with the paper's filter: if you know which to suspect",
    description="ASDF-: only the flawed robots recalibrate",
    robot_description="ASDF: the robot recalibrates, by the paper's filter",
    filtering_robots=FilteringRobots.FLAWED,
    firmware_filter=Filter.ADAPTIVE,
    firmware_filter_without_test=Filter.ALWAYS,
    is_baseline=True,
)
_ASDF_PLUS = SwarmFilter(
    name="asdf-plus",
    term="ASDF+",
    meaning="all robots, with the paper's filter: it may spoil healthy robots",
    description="ASDF+: all robots recalibrate",
    robot_description="ASDF: the robot recalibrates, by the paper's filter",
    filtering_robots=FilteringRobots.ALL,
    firmware_filter=Filter.ADAPTIVE,
    firmware_filter_without_test=Filter.ALWAYS,
)
_ROBUST = SwarmFilter(
    name="robust",
    term="robust",
    meaning="all robots, with this project's filter: if fewer than two in five may be wrong",
    description="robust: all robots recalibrate, by this project's own filter",
    robot_description="robust: the robot recalibrates, by this project's own filter",
    filtering_robots=FilteringRobots.ALL,
    firmware_filter=Filter.ROBUST,
    order_matters=True,  # robots whose ids are equal modulo 32 share a slot, which keeps the latest estimate
    colour="#009e73",
    unused_parameters={
        "omega": "filter is robust, with a test of its own",
        "activation": "filter is robust, with a test of its own",
    },
    is_baseline=True,
)

FILTERS: dict[str, SwarmFilter] = {
    swarm_filter.name: swarm_filter for swarm_filter in (_NO_FILTER, _ASDF_MINUS, _ASDF_PLUS, _ROBUST)
}
"""The filters by name, in the order of legends and reports: from fewer robots that recalibrate to more."""


def filter_of_one_robot(firmware_filter: Filter) -> SwarmFilter:
    """Return the filter of a swarm that sets the firmware of every robot to this value.

    That is never ASDF-, which leaves some robots without a filter. Raises ValueError if there is none.
    """
    match = _filter_that_sets({firmware_filter})
    if match is None:
        raise ValueError(f"no filter of a swarm sets {firmware_filter!r}; add it to FILTERS")
    swarm_filter, _activation = match
    return swarm_filter


def describe_filters(firmware_filters: Iterable[Filter]) -> str:
    """Describe for reports, in ASCII, which robots recalibrate and how, by what their firmware is set to.

    ``firmware_filters`` has a firmware filter for each robot. A single robot has "ASDF", since only a swarm
    can have ASDF- or ASDF+. If no filter of a swarm sets such a mixture, the result lists it as mixed.
    """
    filter_by_robot = list(firmware_filters)
    match = _filter_that_sets(set(filter_by_robot))
    if match is None:
        names = sorted(firmware_filter.name.lower() for firmware_filter in set(filter_by_robot))
        return f"mixed: robots with the filters {', '.join(names)}"
    swarm_filter, activation = match
    return swarm_filter.describe(activation, is_single_robot=len(filter_by_robot) == 1)


def _filter_that_sets(firmware_filters: set[Filter]) -> tuple[SwarmFilter, Activation] | None:
    """Return the filter and activation of a swarm whose robots have exactly these filters, or None."""
    activations: tuple[Activation, ...] = get_args(Activation)
    for swarm_filter in FILTERS.values():
        for activation in activations:
            filters_of_swarm = {
                swarm_filter.firmware_filter_of(is_flawed=True, activation=activation),
                swarm_filter.firmware_filter_of(is_flawed=False, activation=activation),
            }
            if filters_of_swarm == firmware_filters:
                return swarm_filter, activation
    return None
