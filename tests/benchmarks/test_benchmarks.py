"""Every benchmark ends, in its shortest form; the generator of pages is tested with the studies."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks import engine, fidelity, shared_bus
from multicast import multicast

pytestmark = pytest.mark.slow


def test_each_benchmark_has_a_test() -> None:
    """A new script in this folder needs a test here, but for ``argos`` and ``pages``.

    These two have theirs beside what they are about, in tests/host_tools.
    """
    scripts = {path.stem for path in Path(__file__).parent.glob("*.py") if not path.stem.startswith("test_")}
    assert scripts == {"argos", "engine", "fidelity", "pages", "shared_bus"}


@pytest.fixture
def short_worlds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the benchmark of the engine measure once, in trials of 1000 steps."""
    monkeypatch.setattr(engine, "REPEATS", 1)
    monkeypatch.setattr(engine, "FULL", replace(engine.FULL, steps=1000))
    monkeypatch.setattr(engine, "MOVING", replace(engine.MOVING, steps=1000))


@pytest.mark.usefixtures("short_worlds")
def test_the_benchmark_of_the_engine_prints_positive_rates_of_each_program_in_five_worlds(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A rate is in steps of robots a second. A world has a line of titles, then a line for each program.

    One of the programs is a physics simulator, whose rate was measured before.
    """
    engine.main()

    lines = capsys.readouterr().out.splitlines()
    title_lines = [line for line in lines if "robot-steps/s" in line]
    lines_of_programs = [line for line in lines if line not in title_lines]
    assert len(title_lines) == 5
    # Each world has four programs. In two worlds all robots hear all others: there is a fifth program. In two
    # more worlds robots move: there are three more programs.
    programs_by_world = [4 + 1, 4 + 3, 4 + 1, 4, 4 + 3]
    assert len(lines_of_programs) == sum(programs_by_world)
    for line in lines_of_programs:
        *_, last_number = line.split()  # the rate, or its ratio to another program's rate
        assert float(last_number) > 0, line
    assert any(engine.SIMULATOR in line for line in lines_of_programs)


def test_the_benchmark_of_a_bus_compares_one_connection_for_a_swarm_with_one_for_each_robot(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """It fails if the robots' final states differ, and prints the ratio of times of each swarm in one line.

    A swarm of 3 robots and one of 20 run for 12 steps.
    """
    multicast(group=249)  # only skips the test where multicast, which the benchmark uses, does not work
    shared_bus.main(["--robots", "3", "20", "--steps", "12"])
    assert capsys.readouterr().out.count(" times\n") == 2


@pytest.fixture
def short_fidelity(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the benchmark of fidelity compare one experiment of each of its two parts, with four trials."""
    first_experiments = {
        path: fidelity.read_stored_experiments(path)[:1] for path, _trials in fidelity.PARTS.values()
    }
    parts = {part: (path, 4) for part, (path, _trials) in fidelity.PARTS.items()}
    monkeypatch.setattr(fidelity, "PARTS", parts)
    monkeypatch.setattr(fidelity, "read_stored_experiments", first_experiments.__getitem__)


@pytest.mark.usefixtures("short_fidelity")
def test_the_benchmark_of_fidelity_compares_three_scores_of_each_experiment(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """It finds no difference. For each of its two parts it prints a line with the smallest probability."""
    exit_code = fidelity.main()

    assert exit_code == 0
    assert capsys.readouterr().out.count("by Holm's correction over 3 tests") == 2, "lines of parts"
