"""Messages say how to install the project as the pages do; workflows pin what they use of others."""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.extras import EXTRAS, install_command, install_instruction
from mcp_asdf_tools.experiments import trials
from mcp_asdf_tools.experiments.cluster import connect_cluster
from mcp_asdf_tools.robots.firmwares import load_firmware
from support import ROOT

INSTALLING = ROOT / "docs/installing.md"
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))

ACTION_OR_CONTAINER = re.compile(r"^\s*(?:- )?(?:uses|container|image): +(.+)$", re.MULTILINE)
PINNED_BY_HASH = re.compile(r"[\w./-]+@(?:[0-9a-f]{40} # v\d+\.\d+\.\d+|sha256:[0-9a-f]{64} # \d+)")


def test_the_table_of_extras_has_the_commands_that_messages_give() -> None:
    """An extra is a set of further packages. The first row is for the project without any of them."""
    page = INSTALLING.read_text(encoding="utf-8")
    extras = PYPROJECT["project"]["optional-dependencies"]

    commands_in_table = re.findall(r"^\| `(pip install [^`]+)` \|", page, re.MULTILINE)

    command_without_extra = install_command()
    assert commands_in_table == [command_without_extra, *(install_command(extra) for extra in extras)]


def test_messages_name_only_extras_that_there_are() -> None:
    """EXTRAS has the extra, a set of packages that pip installs, for each module that may be missing."""
    extras_in_pyproject = set(PYPROJECT["project"]["optional-dependencies"])
    assert set(EXTRAS.values()) <= extras_in_pyproject


def test_the_workflow_for_users_installs_as_the_messages_say() -> None:
    """docs/radio.md proposes it for the users' own projects."""
    page = (ROOT / "docs/radio.md").read_text(encoding="utf-8")
    assert f"          .venv/bin/python -m {install_command()}\n" in page


def test_a_message_says_where_to_run_the_command() -> None:
    """It does so for an extra, a set of further packages, and for the project without any."""
    assert install_instruction("study") == "in a clone of mcp-asdf run: pip install '.[study]'"
    assert install_instruction() == "in a clone of mcp-asdf run: pip install ."


def pins_in(path: Path) -> list[str]:
    """Return the actions and containers that the workflows in a file use, comments included."""
    return ACTION_OR_CONTAINER.findall(path.read_text(encoding="utf-8"))


def workflow_files() -> list[Path]:
    """Return the files of the project that hold workflows: its own, and pages that propose some."""
    pages = [path for path in sorted((ROOT / "docs").rglob("*.md")) if pins_in(path)]
    return [*sorted((ROOT / ".github").rglob("*.y*ml")), *pages]


def test_workflows_pin_actions_and_containers_by_hash() -> None:
    """A tag can be moved to other code, a hash cannot. The tag stands beside it, for people."""
    pins_by_file = {path.name: pins_in(path) for path in workflow_files()}

    assert len(pins_by_file["tests.yml"]) == 3, "so many are in it, and all are found"
    assert len(pins_by_file["radio.md"]) == 4, "pins of the workflow that the page proposes"
    for name, pins in pins_by_file.items():
        for pin in pins:
            assert PINNED_BY_HASH.fullmatch(pin), f"{name}: {pin}"


@pytest.mark.parametrize(
    ("module", "call", "extra"),
    [
        ("mcp_asdf.native", lambda: load_firmware("native"), ""),
        ("mcp_asdf_tools.experiments.engine.native", trials._load_engine, ""),
        ("distributed", lambda: connect_cluster("tcp://head:8786").__enter__(), "cluster"),
    ],
)
def test_the_error_for_a_module_that_is_not_installed_says_how_to_install_it(
    module: str, call: Callable[[], object], extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``call`` needs the module, which comes with an extra, or with the project itself if ``extra`` is ""."""
    monkeypatch.setitem(sys.modules, module, None)  # importing it fails from here on
    monkeypatch.delattr("mcp_asdf_tools.experiments.engine.native", raising=False)  # what was imported before

    with pytest.raises(UsageError) as refusal:
        call()

    assert str(refusal.value).endswith(install_instruction(extra))
