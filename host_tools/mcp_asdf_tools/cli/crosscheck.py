"""``mcp-asdf crosscheck``: the C against its mirror, against exact arithmetic, and the claims about cost."""

from __future__ import annotations

import argparse
import sys
from functools import partial
from typing import TYPE_CHECKING, Any, cast

from mcp_asdf.robot import Status
from mcp_asdf_tools.cli.output import json_report, print_again
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.signals import INTERRUPTED

if TYPE_CHECKING:
    from mcp_asdf_tools.crosscheck.audit import Audit
    from mcp_asdf_tools.crosscheck.compare import CheckScenario, Failure, Firmware
    from mcp_asdf_tools.crosscheck.report import CrosscheckReport
    from mcp_asdf_tools.crosscheck.scenario import Scenario

EPILOG = """\
examples:
  mcp-asdf crosscheck --steps 2000                  # the default, 25000 steps, takes some ten seconds
      native and mirror agree in every bit
  mcp-asdf crosscheck --steps 100000000 --seed 7    # hours; Ctrl-C prints the results so far
  mcp-asdf crosscheck --replay robot:2:1:64:0:2147483648,step:1
Random and adversarial scenarios run in the C code and in its Python mirror. The first bit of state, output or
status that differs ends the run. The report then has the shortest scenario that shows it, and its line for
--replay.
exit code: 0 all is well, 1 a check failed, 2 bad usage, 128 + signal if
interrupted (results so far are printed)"""
LIBRARIES = ("mpmath", "rich.console")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare ``--steps`` and ``--seed`` of the whole check, and ``--replay``, one scenario in its place."""
    parser.add_argument(
        "--steps",
        type=int,
        metavar="N",
        default=25_000,
        help="make and compare this many calls (default %(default)s)",
    )
    parser.add_argument(
        "--seed",
        type=int,
        metavar="S",
        default=1,
        help="seed of the random scenarios, 0 or more (default %(default)s)",
    )
    parser.add_argument("--replay", metavar="LINE", help="run only the scenario that a failed check printed")


def run(args: argparse.Namespace) -> int:
    """Replay one scenario, or run the whole check; return exit code 1 if a check failed, otherwise 0.

    Raises UsageError for options out of range, and for ones that do not go together. An interrupted check
    returns INTERRUPTED.
    """
    from mcp_asdf_tools.crosscheck.scenario import parse_scenario

    if args.replay is not None:
        if args.typed_options & {"--steps", "--seed"}:
            raise UsageError("--replay runs one scenario; it does not go with --steps or --seed")
        return _replay(parse_scenario(args.replay), args.json)
    if args.steps < 1:
        raise UsageError(f"--steps is {args.steps}; choose 1 or more")
    if args.seed < 0:
        raise UsageError(f"--seed is {args.seed}; choose 0 or more")
    return _check_all(args)


def _load_comparable(name: str) -> Firmware:
    """Return the class of robots of a firmware that can be compared with another, "native" or "mirror"."""
    from mcp_asdf_tools.robots.firmwares import load_firmware

    return cast("Firmware", load_firmware(name))


def _make_scenario_check(audit: Audit) -> CheckScenario:
    """Return a function that runs a scenario on native and mirror, and returns its first failure or None.

    A failure is a call after which the two firmwares differ, or for whose results ``audit``, which compares
    them with the paper's equations in exact fractions, reports a problem. The errors of the results are
    collected in ``audit``.
    """
    from mcp_asdf_tools.crosscheck.compare import compare_firmwares
    from mcp_asdf_tools.crosscheck.oracle import check_call

    native, mirror = _load_comparable("native"), _load_comparable("mirror")

    def check_scenario(scenario: Scenario) -> Failure | None:
        """Run a scenario through both, and return the first failure; None if there is none."""
        return compare_firmwares(scenario, native, mirror, partial(check_call, audit=audit))

    return check_scenario


def _replay(scenario: Scenario, as_json: bool) -> int:
    """Run one scenario through native and mirror, and print whether they agree, as JSON with ``as_json``.

    They agree, too, if both refuse the settings of the scenario's robot. Returns exit code 0 if they agree,
    and 1 if they differ.
    """
    from mcp_asdf_tools.crosscheck.audit import Audit
    from mcp_asdf_tools.crosscheck.compare import RobotUnderTest

    check_scenario = _make_scenario_check(Audit())
    failure = check_scenario(scenario)
    # Both may refuse the settings of the robot: then they agree, and make no call.
    native_robot = RobotUnderTest(_load_comparable("native"), scenario.setup)
    status = native_robot.last_result.outcome  # the outcome of making it
    if as_json:
        print(json_report(_replay_report(scenario, failure, status)))
    elif failure is not None:
        print(failure)
    elif status == Status.OK.name:
        print(f"native and mirror agree in every bit over {len(scenario.calls)} calls")
    else:
        print(f"native and mirror both refuse to make this robot ({status}); no call was made")
    return 0 if failure is None else 1


def _replay_report(scenario: Scenario, failure: Failure | None, status: str) -> dict[str, Any]:
    """Return the outcome of one scenario as plain values; ``calls`` is the number of calls that were made.

    The call that failed was the last one. ``status`` is the outcome of making the robot: if it is not OK,
    both firmwares have refused the robot, and no call was made.
    """
    if failure is not None:
        call_count = len(failure.scenario.calls)
    elif status == Status.OK.name:
        call_count = len(scenario.calls)
    else:
        call_count = 0
    return {
        "ok": failure is None,
        "status": status,
        "calls": call_count,
        "failure": None if failure is None else failure.as_dict(),
    }


def _check_all(args: argparse.Namespace) -> int:
    """Run random scenarios of ``--steps`` calls, and the checks of cost and storage; print the report.

    A failure is reported with the shortest scenario that shows it. Returns exit code 1 if a check failed, and
    INTERRUPTED if Ctrl-C ended it before that.
    """
    from mcp_asdf_tools.common.progress_bar import progress
    from mcp_asdf_tools.crosscheck.audit import Audit
    from mcp_asdf_tools.crosscheck.compare import run_crosscheck
    from mcp_asdf_tools.crosscheck.operation_count import count_operations, measure_storage
    from mcp_asdf_tools.crosscheck.report import CrosscheckReport

    audit = Audit()
    counts = count_operations()
    with progress("calls", args.steps, args.json) as report_progress:
        result = run_crosscheck(_make_scenario_check(audit), args.seed, args.steps, report_progress)
    if result.failure is not None:
        # A short scenario is easier to understand than the random one that failed.
        result.failure = _find_shortest(result.failure)
    report = CrosscheckReport(args.seed, result, audit, counts, measure_storage())
    _print_report(report, args)
    if not report.is_good:
        return 1
    return INTERRUPTED if result.interrupted else 0


def _print_report(report: CrosscheckReport, args: argparse.Namespace) -> None:
    """Print the report of a check: tables and a verdict, or JSON with --json.

    If all is good, the last line says how to repeat the check. Otherwise the verdict ends with the line that
    replays the failure.
    """
    from rich.console import Console

    if args.json:
        print(json_report(report.as_dict()))
        return
    Console(soft_wrap=True).print(report.tables())
    print(report.verdict())
    if report.is_good:
        print_again(args, steps=args.steps, seed=args.seed)


def _find_shortest(failure: Failure) -> Failure:
    """Return the failure with the shortest scenario that shows it.

    If Ctrl-C ends the search, return the failure as it is, and say so on standard error.
    """
    from mcp_asdf_tools.crosscheck.audit import Audit
    from mcp_asdf_tools.crosscheck.compare import shrink

    try:
        # With an audit of its own, as the calls of this search do not count as checked.
        check_scenario = _make_scenario_check(Audit())
        return shrink(failure, check_scenario)
    except KeyboardInterrupt:
        print("mcp-asdf crosscheck: interrupted; a shorter scenario may show the same", file=sys.stderr)
        return failure
