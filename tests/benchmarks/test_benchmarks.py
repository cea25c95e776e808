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


def test_the_engine_is_measured(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(engine, "REPEATS", 1)
    for name in ("FULL", "MOVING"):
        monkeypatch.setattr(engine, name, replace(getattr(engine, name), steps=1000))
    engine.main()
    out = capsys.readouterr().out
    assert out.count("robot-steps/s") == 5 and out.count("\n") == 5 + 5 * 4 + 2 + 2 * 3
    assert all(float(line.split()[-1]) > 0 for line in out.splitlines() if "/s" not in line)
    assert engine.SIMULATOR in out


def test_one_connection_for_a_swarm_is_compared_with_one_for_each(capsys: pytest.CaptureFixture[str]) -> None:
    """Their robots end in the same bits, or it fails."""
    multicast(249)
    shared_bus.main(["--robots", "3", "20", "--steps", "12"])
    assert capsys.readouterr().out.count(" times\n") == 2


def test_distributions_are_compared(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    parts = {part: (path, 4) for part, (path, _) in fidelity.PARTS.items()}
    some = {path: fidelity.read_cells(path)[:1] for path, _ in parts.values()}
    monkeypatch.setattr(fidelity, "PARTS", parts)
    monkeypatch.setattr(fidelity, "read_cells", lambda path: some[path])
    assert fidelity.main() == 0
    assert capsys.readouterr().out.count("by Holm's correction over 3 tests") == 2
