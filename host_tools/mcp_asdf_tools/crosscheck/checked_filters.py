"""The filters that the cross-check knows, each with its scenarios and checks. A new filter is added here."""

from __future__ import annotations

from collections.abc import Callable, Set
from dataclasses import dataclass

from mcp_asdf.robot import Filter
from mcp_asdf_tools.crosscheck.asdf_oracle import check_asdf_call
from mcp_asdf_tools.crosscheck.audit import Audit
from mcp_asdf_tools.crosscheck.random_scenarios import random_scenario
from mcp_asdf_tools.crosscheck.robust_oracle import check_robust_call
from mcp_asdf_tools.crosscheck.robust_scenarios import robust_scenario
from mcp_asdf_tools.crosscheck.scenario import CallRecord, Scenario
from mcp_asdf_tools.crosscheck.workloads import RobustWorkload, Workload


@dataclass(frozen=True)
class CheckedFilter:
    """What it takes to check robots with a filter, or with one of several that have scenarios in common.

    Attributes:
        name: Name in reports; empty for the paper's filters.
        filters: The filters.
        make_scenario: Returns the random scenario of a seed and an index.
        scenarios_in_turn: Number of its scenarios before the next filter takes its turn.
        check_call: Checks in exact arithmetic what a call did, as far as that depends on the filter.
        workload: Class of the robots whose instructions are counted.
    """

    name: str
    filters: Set[Filter]
    make_scenario: Callable[[int, int], Scenario]
    scenarios_in_turn: int
    check_call: Callable[[CallRecord, Audit], list[str]]
    workload: type[Workload]

    def label(self, call_name: str) -> str:
        """Return the name of a call of robots with this filter, such as "settle, robust".

        The paper's filters have an empty name, and are left out of it: "settle".
        """
        return f"{call_name}, {self.name}" if self.name else call_name

    @property
    def images_key(self) -> str:
        """Key of the sizes of saved robots in the report: "images" for the paper's filters.

        For the robust filter it is "robust_images".
        """
        return f"{self.name}_images" if self.name else "images"


CHECKED_FILTERS = (
    CheckedFilter(
        name="",
        filters={Filter.ADAPTIVE, Filter.ALWAYS, Filter.OFF},
        make_scenario=random_scenario,
        scenarios_in_turn=3,
        check_call=check_asdf_call,
        workload=Workload,
    ),
    CheckedFilter(
        name="robust",
        filters={Filter.ROBUST},
        make_scenario=robust_scenario,
        scenarios_in_turn=1,
        check_call=check_robust_call,
        workload=RobustWorkload,
    ),
)


def checked_filter_of(filter_number: int) -> CheckedFilter:
    """Return the one entry of ``CHECKED_FILTERS`` that has this number of a `Filter`."""
    [checked_filter] = [checked for checked in CHECKED_FILTERS if filter_number in checked.filters]
    return checked_filter
