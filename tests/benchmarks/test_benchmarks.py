"""Every benchmark, and generator of a page, ends in its shortest form; test_robust has its page."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks import engine, fidelity, pages, shared_bus
from host_tools.reproduction.test_report import run_of
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.reproduction import report, resampling, robust, scaling
from mcp_asdf_tools.reproduction.study import PAPER, QUICK, Part
from multicast import multicast
from support import ROOT

pytestmark = pytest.mark.slow


def test_all_are_known() -> None:
    scripts = {path.stem for path in Path(__file__).parent.glob("*.py")}
    assert scripts == {"engine", "fidelity", "pages", "shared_bus", "test_benchmarks", "test_cost"}


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


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder for pages, with the present ones in it."""
    root = tmp_path / "root"
    (root / "tests/data").mkdir(parents=True)
    (root / "docs/images").mkdir(parents=True)
    for page in ("ageing", "reproduce", "robust"):
        shutil.copy(ROOT / f"docs/{page}.md", root / "docs")
    monkeypatch.setattr(pages, "ROOT", root)
    monkeypatch.setattr(resampling, "RESAMPLES", 50)
    return root


def lines_around(page: Path) -> list[str]:
    """All of a page but the rows of its tables."""
    return [each for each in page.read_text(encoding="utf-8").splitlines() if each[:1] != "|"]


def put(part: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr("sys.argv", ["pages.py", part, str(folder)])
    return pages.main()


def test_the_page_of_the_study_is_written(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report, "pictures", lambda study, scale: [])
    run = run_of(1, "90 - P / 2", Part.DYNAMIC)
    report.write_report(tmp_path, [run], QUICK)
    assert put("study", tmp_path, monkeypatch) == 1
    report.write_report(tmp_path, [run], PAPER)
    assert put("study", tmp_path, monkeypatch) == 0
    assert len((root / "tests/data/study_verdicts.csv").read_text().splitlines()) == 1 + len(run.decided)
    before, after = (
        (each / "docs/reproduce.md").read_text(encoding="utf-8").partition("<!-- end -->")
        for each in (ROOT, root)
    )
    assert f"of {len(run.decided)} claims hold" in after[0]
    assert after[2] == before[2] != ""


WRONG = "fill_ratio = 0.95\ntrue_accuracy = 0.55\nflawed_accuracy = 0.95\n"


@pytest.mark.parametrize(
    ("part", "grid"),
    [
        ("ageing", '[[grid]]\n[[grid]]\ndrift = "linear"\ndrift_rate = -1e-5\n'),
        ("scale", f'topology = "dynamic"\n[[grid]]\n[[grid]]\n{WRONG}'),
    ],
)
def test_tables_and_picture_of_a_page_are_written(
    part: str, grid: str, root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between their marks alone."""
    (tmp_path / f"{part}.toml").write_text(f'robots = 4\nsteps = 4000\nfilter = ["none", "robust"]\n{grid}')
    monkeypatch.setattr(robust, "STUDIES", tmp_path)
    monkeypatch.setattr(scaling, "_ROBOT_STEPS", 1000)
    options = ["--part", part, "--trials", "2", "--workers", "1", "--output", str(tmp_path)]
    assert main(["reproduce", *options]) == 0
    shutil.copy(tmp_path / f"{part}.parquet", tmp_path / "peers.parquet")
    assert put(part, tmp_path, monkeypatch) == 0
    before, after = (each / "docs" / pages.PAGES[part][0] for each in (ROOT, root))
    assert after.read_bytes() != before.read_bytes() and lines_around(after) == lines_around(before)
    assert (root / f"docs/images/{part}.webp").read_bytes()[8:12] == b"WEBP"
