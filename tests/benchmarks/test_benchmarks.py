"""Every benchmark ends, in its shortest form; the generator of pages is tested with the studies."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks import engine, fidelity, shared_bus
from multicast import multicast

pytestmark = pytest.mark.slow


def test_all_are_known() -> None:
    """The table of ``argos`` and ``robust_judge`` have tests of their own."""
    scripts = {path.stem for path in Path(__file__).parent.glob("*.py") if not path.stem.startswith("test_")}
    assert scripts == {"argos", "engine", "fidelity", "pages", "shared_bus"}


def test_the_benchmark_of_the_engine_prints_a_table_of_rates_for_each_world(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Five tables, each with a title and four rows; two have one row more, and two three rows more."""
    monkeypatch.setattr(engine, "REPEATS", 1)
    for name in ("FULL", "MOVING"):
        monkeypatch.setattr(engine, name, replace(getattr(engine, name), steps=1000))

    engine.main()

    lines = capsys.readouterr().out.splitlines()
    titles = [line for line in lines if "robot-steps/s" in line]
    assert len(titles) == 5
    assert len(lines) == 5 + 5 * 4 + 2 * 1 + 2 * 3
    assert any(engine.SIMULATOR in line for line in lines)
    for line in lines:
        if "/s" not in line:
            assert float(line.split()[-1]) > 0, line


def test_one_connection_for_a_swarm_is_compared_with_one_for_each(capsys: pytest.CaptureFixture[str]) -> None:
    """Their robots end in the same bits, or it fails."""
    multicast(249)
    shared_bus.main(["--robots", "3", "20", "--steps", "12"])
    assert capsys.readouterr().out.count(" times\n") == 2


def test_the_benchmark_of_fidelity_compares_distributions(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With one case of each of the two parts of the study, and four trials."""
    cases = {path: fidelity.read_cells(path)[:1] for path, _trials in fidelity.PARTS.values()}
    parts = {part: (path, 4) for part, (path, _trials) in fidelity.PARTS.items()}
    monkeypatch.setattr(fidelity, "PARTS", parts)
    monkeypatch.setattr(fidelity, "read_cells", lambda path: cases[path])

    exit_code = fidelity.main()

    assert exit_code == 0
    assert capsys.readouterr().out.count("by Holm's correction over 3 tests") == 2
