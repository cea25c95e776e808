"""How to install the project is said in one way everywhere, and workflows pin what they use of others."""

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
from support import ROOT, run

INSTALLING = ROOT / "docs/installing.md"
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))

# "pip install", options, and this project: its folder or its name, perhaps with extras.
INSTALLS_PROJECT = re.compile(
    r"pip (?:-\S+ )*install (?:-\S+ )*['\"]?(?:\.|mcp[-_]asdf)(?:\[[^\]]*\])?(?=['\"`\s]|$)"
)
OTHER_MENTIONS = {
    ".github/CONTRIBUTING.md": "the set-up of developers, who always have a clone",
    "docs/platforms/extending.md": "installs the reader's own package",
    "CHANGELOG.md": "tells what was once written",
}

ACTION_OR_CONTAINER = re.compile(r"^\s*(?:- )?(?:uses|container|image): +(.+)$", re.MULTILINE)
PINNED_BY_HASH = re.compile(r"[\w./-]+@(?:[0-9a-f]{40} # v\d+\.\d+\.\d+|sha256:[0-9a-f]{64} # \d+)")


def listed_texts() -> dict[str, str]:
    """Return the text of each file that git lists, by its path, but for tests and files that are no text."""
    texts = dict[str, str]()
    for name in run("git", "ls-files", "-z", "--", ":!tests").split("\0"):
        path = ROOT / name
        if path.is_file():
            content = path.read_bytes()
            if b"\0" not in content:
                texts[name] = content.decode("utf-8")
    return texts


def test_only_two_pages_have_the_command_that_installs_the_project() -> None:
    """So it is changed in few places. Messages take it from a function, and other pages lead to these.

    OTHER_MENTIONS lists files that write it for developers, or about the past, with the reason.
    """
    names = {name for name, text in listed_texts().items() if INSTALLS_PROJECT.search(text)}
    assert names - set(OTHER_MENTIONS) == {"docs/installing.md", "docs/radio.md"}


@pytest.mark.parametrize(
    "command",
    [
        "pip install mcp-asdf",
        "pip install 'mcp-asdf[study]'",
        "`pip install .`",
        "pip -q install -e '.[all]'",
    ],
)
def test_each_form_of_the_command_is_recognised(command: str) -> None:
    """The test that only two pages have the command has to find it, however a page writes it."""
    assert INSTALLS_PROJECT.search(command)


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
    "unsafe_pin", ["actions/checkout@v4", "debian:12", "debian@sha256:813017f3 # 12", "a/b@main"]
)
def test_what_is_pinned_by_a_tag_or_half_a_hash_is_refused(unsafe_pin: str) -> None:
    """A full hash has 40 or 64 digits, and the tag stands behind it in a comment."""
    assert not PINNED_BY_HASH.fullmatch(unsafe_pin)


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
