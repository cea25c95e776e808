"""The base installation: what works without the extras, and how a missing one is named."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.common.extras import EXTRAS, missing_extra
from support import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
HIDING = f"""\
import sys

class Finder:
    def find_spec(self, name, path, target=None):
        if name.partition(".")[0] in {sorted(EXTRAS)}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Finder())
"""


def in_base(folder: Path, code: str) -> subprocess.CompletedProcess[str]:
    """Run code in a Python that has none of the extras."""
    command = [sys.executable, "-c", HIDING + code]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=120)


def commands(*lines: str) -> str:
    """A program that runs commands one after the other and prints their exit codes."""
    return (
        "from mcp_asdf_tools.cli.main import main\n"
        f"print('codes', *[main(line.split()) for line in {list(lines)}])"
    )


def names(requirements: list[str]) -> set[str]:
    """Names of distributions, in one spelling."""
    return {re.split(r"[^\w.-]", each)[0].lower().replace("_", "-") for each in requirements}


def test_every_extra_is_named_for_its_modules() -> None:
    distributions = packages_distributions()
    for module, extra in EXTRAS.items():
        (distribution, *_) = distributions[module]
        wanted = PROJECT["optional-dependencies"][extra]
        assert distribution.lower().replace("_", "-") in names(wanted), module
        assert distribution.lower() not in names(PROJECT["dependencies"])
    brought = {
        name
        for extra in ("study", "view", "cluster")
        for name in names(PROJECT["optional-dependencies"][extra])
    }
    assert len(brought - {"mcp-asdf"}) == len(EXTRAS)


def test_the_base_runs_robots(tmp_path: Path) -> None:
    done = in_base(
        tmp_path,
        commands(
            "swarm --robots 4 --steps 30 --filter-period 10 --quiet --log run.log",
            "swarm --robots 4 --steps 5 --topology dynamic --quiet",
            "replay run.log",
            "view run.log --export run.html",
            "table --output tables --neighbours 4",
            "radio --id 3 --robots 3 --steps 1 --steps-per-second 500",
            "firmware vendor",
            "dbc --output mcp_asdf.dbc",
        ),
    )
    assert done.stdout.splitlines()[-1:] == ["codes" + " 0" * 8], done.stderr


def test_the_base_crosschecks(tmp_path: Path) -> None:
    done = in_base(tmp_path, commands("crosscheck --replay robot:2:1:64:0:2147483648,step:1"))
    assert done.stdout.splitlines()[-1:] == ["codes 0"], done.stderr


def test_the_base_knows_all_options(tmp_path: Path) -> None:
    """Of commands, too, that need more to run."""
    done = in_base(tmp_path, commands(*(f"{name} --help" for name in cli.COMMANDS), "completion bash"))
    assert done.stdout.splitlines()[-1:] == ["codes" + " 0" * (len(cli.COMMANDS) + 1)], done.stderr
    assert "--record" in done.stdout


@pytest.mark.parametrize(
    ("line", "module", "extra"),
    [
        ("simulate --steps 1000 --trials 1", "pyarrow", "study"),
        ("sweep physical --output physical.parquet", "pyarrow", "study"),
        ("score x.parquet", "pyarrow", "study"),
        ("plot x.parquet x.png", "matplotlib", "study"),
        ("reproduce --quick", "pyarrow", "study"),
        ("swarm --steps 3 --plot x.png", "matplotlib", "study"),
        ("swarm --steps 3 --view", "uvicorn", "view"),
    ],
)
def test_a_missing_extra_is_named_in_one_line(line: str, module: str, extra: str, tmp_path: Path) -> None:
    (tmp_path / "authors.yml").write_text("numRobots: 10\n")
    done = in_base(tmp_path, commands(line))
    assert done.stdout.splitlines()[-1:] == ["codes 2"]
    assert done.stderr.count("\n") == 1
    assert module in done.stderr and f"pip install 'mcp-asdf[{extra}]'" in done.stderr


def test_other_modules_are_no_extras() -> None:
    assert missing_extra(ImportError("no", name="of_nowhere")) is None
    assert missing_extra(ImportError("no")) is None
