"""The committed cost table is what the compiler it names gives, and the budgets hold."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

pytest.importorskip("unicorn", reason="the emulator that counts instructions is not installed")
from benchmarks import cost

README = Path(__file__).parents[2] / "README.md"
TOLERANCE = 0.02

pytestmark = pytest.mark.skipif(
    shutil.which(cost.COMPILER) is None,
    reason=f"{cost.COMPILER} is not installed (apt-get install gcc-arm-none-eabi)",
)


@pytest.fixture(scope="module")
def results() -> dict[str, dict[str, object]]:
    return cost.measure_all()


def maximum(results: dict[str, dict[str, object]], target: str, call: str) -> int:
    instructions = results[target]["instructions"]
    assert isinstance(instructions, dict)
    return int(instructions[call]["max"])


@pytest.mark.parametrize(
    ("target", "call", "budget"),
    [
        ("Cortex-M4", "step", 150),
        ("Cortex-M4", "receive", 60),
        ("Cortex-M4", "step with test and update", 500),
        ("Cortex-M0+", "step", 400),
        ("Cortex-M0+", "receive", 185),
    ],
)
def test_instructions_stay_within_their_budget(
    results: dict[str, dict[str, object]], target: str, call: str, budget: int
) -> None:
    assert maximum(results, target, call) <= budget


def test_a_robot_takes_at_most_176_bytes(results: dict[str, dict[str, object]]) -> None:
    assert all(int(str(r["ram"])) <= 176 for r in results.values())


def numbers(line: str) -> list[float]:
    cells = line.replace("(", " ").replace(")", " ").replace(",", " ").split()
    return [float(cell) for cell in cells if cell.replace(".", "", 1).isdigit()]


def test_the_readme_tells_what_is_measured(results: dict[str, dict[str, object]]) -> None:
    committed = (
        README.read_text(encoding="utf-8").split(cost.START)[1].split(cost.END)[0].strip().splitlines()
    )
    version = cost.compiler_version()
    if version not in committed[0]:
        pytest.skip(
            f"the table in README.md was measured with {committed[0].split('|')[1].strip()}, not {version}"
        )
    fresh = cost.markdown(results, version).splitlines()
    assert len(committed) == len(fresh)
    for old, new in zip(committed, fresh, strict=True):
        assert numbers(old) == pytest.approx(numbers(new), rel=TOLERANCE), (
            f"run make cost: {old!r} is now {new!r}"
        )


def test_the_rows_hold_figures_to_compare() -> None:
    assert numbers("| step | 131 (149) | 348 (391) |") == [131, 149, 348, 391]
