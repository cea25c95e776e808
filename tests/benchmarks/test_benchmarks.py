"""Every benchmark and generator of a page ends, in its shortest form; test_robust has robust_page."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

from benchmarks import ageing_page, engine, fidelity, scale_page, shared_bus, study_page
from host_tools.reproduction.test_report import run_of
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.reproduction import report, resampling, robust, scaling
from mcp_asdf_tools.reproduction.study import PAPER, Part
from multicast import multicast

pytestmark = pytest.mark.slow


def test_all_are_known() -> None:
    scripts = {path.stem for path in Path(__file__).parent.glob("*.py")}
    measured = {"engine", "fidelity", "shared_bus"}
    pages = {"ageing_page", "robust_page", "scale_page", "study_page"}
    assert scripts == measured | pages | {"test_benchmarks", "test_cost"}


def test_the_engine_is_measured(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(engine, "REPEATS", 1)
    for name in ("FULL", "MOVING"):
        monkeypatch.setattr(engine, name, replace(getattr(engine, name), steps=1000))
    engine.main()
    out = capsys.readouterr().out
    assert out.count("robot-steps/s") == 5 and out.count("\n") == 5 + 5 * 4 + 2 + 2 * 4
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


def test_the_page_of_the_study_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resampling, "RESAMPLES", 50)
    monkeypatch.setattr(report, "pictures", lambda study, scale: [])
    page, verdicts = tmp_path / "page.md", tmp_path / "verdicts.csv"
    shutil.copy(study_page.PAGE, page)
    monkeypatch.setattr(study_page, "PAGE", page)
    monkeypatch.setattr(study_page, "VERDICTS", verdicts)
    monkeypatch.setattr("sys.argv", ["study_page.py", str(tmp_path)])
    run = run_of(1, "90 - P / 2", Part.DYNAMIC)
    report.write_report(tmp_path, [run], PAPER)
    assert study_page.main() == 0
    assert len(verdicts.read_text().splitlines()) == 1 + len(run.decided)
    before, after = (
        path.read_text(encoding="utf-8") for path in (study_page.ROOT / "docs/reproduce.md", page)
    )
    assert f"of {len(run.decided)} claims hold" in after
    assert after.partition(study_page.END)[2] == before.partition(study_page.END)[2] != ""


@pytest.mark.parametrize(
    ("part", "page", "grid"),
    [
        ("ageing", ageing_page, '[[grid]]\n[[grid]]\ndrift = "linear"\ndrift_rate = -1e-5\n'),
        (
            "scale",
            scale_page,
            'topology = "dynamic"\n[[grid]]\n[[grid]]\n'
            "fill_ratio = 0.95\ntrue_accuracy = 0.55\nflawed_accuracy = 0.95\n",
        ),
    ],
)
def test_tables_and_picture_of_a_page_are_written(
    part: str, page: ModuleType, grid: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between their marks alone."""
    (tmp_path / f"{part}.toml").write_text(f'robots = 4\nsteps = 4000\nfilter = ["none", "robust"]\n{grid}')
    monkeypatch.setattr(robust, "STUDIES", tmp_path)
    monkeypatch.setattr(resampling, "RESAMPLES", 50)
    monkeypatch.setattr(scaling, "_ROBOT_STEPS", 1000)
    options = ["--part", part, "--trials", "2", "--workers", "1", "--output", str(tmp_path)]
    assert main(["reproduce", *options]) == 0
    shutil.copy(tmp_path / f"{part}.parquet", tmp_path / "peers.parquet")
    before = page.PAGE.read_text(encoding="utf-8")
    copy, picture = Path(shutil.copy(page.PAGE, tmp_path / "page.md")), tmp_path / "picture.webp"
    monkeypatch.setattr(page, "PAGE", copy)
    monkeypatch.setattr(page, "PICTURE", picture)
    monkeypatch.setattr("sys.argv", [f"{part}_page.py", str(tmp_path)])
    assert page.main() == 0
    after = copy.read_text(encoding="utf-8")
    assert after != before and [each for each in after.splitlines() if each[:1] != "|"] == [
        each for each in before.splitlines() if each[:1] != "|"
    ]
    assert picture.read_bytes()[8:12] == b"WEBP"
