"""The command line's frame: overview, errors, exit codes, lazy imports, atomic files."""

from __future__ import annotations

import argparse
import json
import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.common import files, versions
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.signals import INTERRUPTED, stopping
from support import interruptible

ROOT = Path(__file__).resolve().parents[3]


def python(*arguments: str, stdout: int = subprocess.PIPE) -> subprocess.CompletedProcess[str]:
    """Run the interpreter with the project importable and its output buffered, whatever the caller set."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=ROOT,
        env=environment,
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )


def fake_command(monkeypatch: pytest.MonkeyPatch, outcome: int | BaseException | Callable[[], int]) -> None:
    """Make ``mcp-asdf table`` return ``outcome``, raise it or call it."""

    def run(args: argparse.Namespace) -> int:
        if isinstance(outcome, BaseException):
            raise outcome
        return outcome() if callable(outcome) else outcome

    command = SimpleNamespace(EPILOG="", add_arguments=lambda parser: None, run=run)
    monkeypatch.setattr(cli, "_load", lambda name: command)


def test_no_arguments_show_the_overview_and_fail(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    for name in cli.COMMANDS:
        assert f"\n  {name} " in err


def test_help_is_not_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--help"]) == 0
    assert cli.COMMANDS["table"] in capsys.readouterr().out


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("mcp-asdf ")


def test_version_of_a_source_tree_that_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(versions, "PROGRAM", "no-such-distribution")
    assert versions.software_versions()["mcp-asdf"] == versions.own_version() == "not installed"


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("tabel", "mcp-asdf: error: no command is called 'tabel'; did you mean table?"),
        ("xyz --json", "mcp-asdf: error: no command is called 'xyz'"),
        ("--versoin", "mcp-asdf: error: no such option: --versoin; did you mean --version?"),
        ("swarm --robtos 3", "mcp-asdf swarm: error: no such option: --robtos; did you mean --robots?"),
        ("swarm --robtos=3", "mcp-asdf swarm: error: no such option: --robtos=3; did you mean --robots?"),
        ("swarm 3", "mcp-asdf swarm: error: no such argument: 3"),
    ],
)
def test_a_slip_of_the_pen_takes_two_lines(line: str, told: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(line.split()) == 2
    program = told.partition(":")[0]
    assert capsys.readouterr().err.splitlines() == [told, f"See '{program} --help'."]


def test_unknown_option_is_told_by_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["table", "--output", ".", "--omga", "0.1"]) == 2
    err = capsys.readouterr().err
    assert "mcp-asdf table: error: " in err
    assert "--omga" in err


@pytest.mark.parametrize("code", [0, 1])
def test_the_commands_exit_code_is_the_programs(monkeypatch: pytest.MonkeyPatch, code: int) -> None:
    fake_command(monkeypatch, code)
    assert cli.main(["table"]) == code


def test_usage_error(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    fake_command(monkeypatch, UsageError("the value is 7; give 6"))
    assert cli.main(["table"]) == 2
    assert capsys.readouterr().err == "mcp-asdf table: error: the value is 7; give 6\n"


def test_interrupt(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    fake_command(monkeypatch, KeyboardInterrupt())
    assert cli.main(["table"]) == 130
    assert capsys.readouterr().err == "mcp-asdf table: interrupted\n"


ENDINGS = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}


@pytest.mark.parametrize("number", ENDINGS)
@interruptible()
def test_every_signal_that_asks_to_end_acts_as_ctrl_c(
    number: signal.Signals, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    saved = []

    def work() -> int:
        try:
            os.kill(os.getpid(), number)
            signal.pause()
        finally:
            for second in (signal.SIGTERM, signal.SIGHUP):  # as terminals and service managers send them
                os.kill(os.getpid(), second)
            saved.append("all")
        return 0

    handlers = [signal.getsignal(each) for each in ENDINGS]
    fake_command(monkeypatch, work)
    assert cli.main(["table"]) == ENDINGS[number]
    assert saved == ["all"]
    assert capsys.readouterr().err == "mcp-asdf table: interrupted\n"
    assert [signal.getsignal(each) for each in ENDINGS] == handlers


def test_commands_that_end_by_themselves_tell_the_signal_too(monkeypatch: pytest.MonkeyPatch) -> None:
    def work() -> int:
        with stopping() as is_asked:
            os.kill(os.getpid(), signal.SIGTERM)
            os.kill(os.getpid(), signal.SIGTERM)
            assert is_asked()
        return INTERRUPTED

    fake_command(monkeypatch, work)
    assert cli.main(["table"]) == 143


@interruptible()
def test_a_second_ctrl_c_acts_at_once() -> None:
    with pytest.raises(KeyboardInterrupt), stopping():
        os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGINT)


def test_what_the_program_was_started_to_ignore_stays_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    def work() -> int:
        os.kill(os.getpid(), signal.SIGHUP)
        with stopping() as is_asked:
            os.kill(os.getpid(), signal.SIGHUP)
            assert not is_asked()
        return 0

    fake_command(monkeypatch, work)
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as by nohup
    try:
        assert cli.main(["table"]) == 0
    finally:
        signal.signal(signal.SIGHUP, before)


@interruptible()
def test_ctrl_c_within_an_import_waits_for_its_end(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    done = []

    def importing(name: str) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        done.append(name)

    handler = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr(cli, "import_module", importing)
    assert cli.main(["swarm"]) == 130
    assert capsys.readouterr() == ("", "mcp-asdf swarm: interrupted\n")
    assert done == ["mcp_asdf_tools.cli.swarm"]
    assert signal.getsignal(signal.SIGINT) is handler


@pytest.mark.parametrize("library", ["numpy", "mcp_asdf_tools.recording.input_log"])
@interruptible()
def test_ctrl_c_while_libraries_load_shows_no_traceback(library: str) -> None:
    script = (
        "import os, signal, sys\n"
        "class Finder:\n"
        "    def find_spec(self, name, path, target=None):\n"
        f"        if name == {library!r}: os.kill(os.getpid(), signal.SIGINT)\n"
        "from mcp_asdf_tools.cli.main import main\n"
        "sys.meta_path.insert(0, Finder())\n"
        "sys.exit(main(['swarm', '--steps', '3']))"
    )
    result = python("-c", script)
    assert (result.returncode, result.stdout, result.stderr) == (130, "", "mcp-asdf swarm: interrupted\n")


def test_other_errors_are_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    fake_command(monkeypatch, ZeroDivisionError())
    with pytest.raises(ZeroDivisionError):
        cli.main(["table"])


def test_a_reader_that_leaves_ends_the_program_quietly() -> None:
    read_end, write_end = os.pipe()
    os.close(read_end)
    check = ["-m", "mcp_asdf_tools.cli.main", "table", "--check", "tables/t_table_omega05_q30.c"]
    result = python(*check, stdout=write_end)
    os.close(write_end)
    assert (result.returncode, result.stderr) == (141, "")


CHECK = ("table", "--check", "tables/t_table_omega05_q30.c")


@pytest.mark.parametrize("arguments", [CHECK, ("swarm", "--steps", "3"), ("--help",)])
def test_output_that_cannot_be_written_is_no_failed_check(arguments: tuple[str, ...]) -> None:
    title = " ".join(["mcp-asdf", *(word for word in arguments[:1] if word in cli.COMMANDS)])
    with open("/dev/full", "w") as full:
        result = python("-m", "mcp_asdf_tools.cli.main", *arguments, stdout=full.fileno())
    message = "cannot write to standard output: No space left on device; send it elsewhere"
    assert (result.returncode, result.stderr) == (2, f"{title}: error: {message}\n")


def shell(line: str) -> subprocess.CompletedProcess[str]:
    """Run ``mcp-asdf`` with the words and the redirections of ``line``."""
    command = f"{shlex.quote(sys.executable)} -m mcp_asdf_tools.cli.main {line}"
    return python("-c", f"import os; os.execl('/bin/sh', 'sh', '-c', {command!r})")


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("table --neighbours 0 --output . 2>&-", 2),
        ("table --neighbours 0 --output . 2>/dev/full", 2),
    ],
)
def test_what_cannot_be_told_changes_no_exit_code(line: str, code: int) -> None:
    result = shell(line)
    assert (result.returncode, result.stdout, result.stderr) == (code, "", "")


def test_a_closed_output_is_told() -> None:
    result = shell("table --check tables/t_table_omega05_q30.c >&-")
    assert (result.returncode, "standard output is closed" in result.stderr) == (2, True)


SLOW_TO_LOAD = ["can", "matplotlib", "mpmath", "numpy", "pyarrow", "rich", "scipy"]
"""Libraries that each take about as long to load as all that an overview needs, or much longer."""


@pytest.mark.parametrize(
    ("arguments", "loaded"),
    [
        ([], []),
        (["--help"], []),
        (["--version"], []),
        (["tabel"], []),
        (["table", "--help"], ["mpmath"]),
        (["table", "--check", "tables/t_table_omega05_q30.c"], ["mpmath"]),
        (["dbc", "--help"], ["can"]),
        (["node", "--help"], ["can", "mpmath", "numpy", "rich"]),
        (["radio", "--help"], ["can", "mpmath", "numpy", "rich"]),
        (["replay", "--help"], ["can", "mpmath", "numpy", "rich"]),
        (["swarm", "--help"], ["can", "mpmath", "numpy", "rich"]),
        (["swarm", "--steps", "1", "--quiet"], ["can", "mpmath", "numpy", "rich"]),
    ],
)
def test_a_command_loads_only_the_libraries_that_it_uses(arguments: list[str], loaded: list[str]) -> None:
    script = (
        "import sys; from mcp_asdf_tools.cli.main import main\n"
        f"main({arguments})\n"
        f"print([name for name in {SLOW_TO_LOAD} if name in sys.modules])"
    )
    result = python("-c", script)
    assert result.stdout.splitlines()[-1:] == [str(loaded)], result.stderr


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_every_command_explains_itself(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([name, "--help"]) == 0
    out = capsys.readouterr().out
    assert "--json" in out
    assert f"\n  mcp-asdf {name} " in out, "no example"


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_every_example_is_accepted(name: str) -> None:
    examples = [line for line in cli._load(name).EPILOG.splitlines() if line.startswith("  mcp-asdf")]
    assert examples
    for line in examples:
        _, called, *options = shlex.split(line.partition(" > ")[0], comments=True)
        cli._parser_for(called, cli._load(called)).parsed(options)


@pytest.mark.parametrize("data", ["k_m ≥ 1\n", b"\x00\xff"])
def test_write_atomically_replaces_the_whole_file(tmp_path: Path, data: str | bytes) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"something much longer than what comes next")
    files.write_atomically(path, data)
    assert path.read_bytes() == (data.encode() if isinstance(data, str) else data)
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]


def test_files_of_a_set_appear_together(tmp_path: Path) -> None:
    with files.FileSet() as together:
        together.write(tmp_path / "a", "1")
        together.write(tmp_path / "b", "2")
        assert not (tmp_path / "a").exists()
    assert {entry.name: entry.read_text() for entry in tmp_path.iterdir()} == {"a": "1", "b": "2"}


@pytest.mark.parametrize("lost", ["a", "b"])
def test_a_file_that_cannot_appear_keeps_back_its_set(lost: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=f"cannot write .*/{lost}: "), files.FileSet() as together:
        for name in ("a", "b"):
            together.write(tmp_path / name, "new")
        (tmp_path / lost).mkdir()
    assert [entry.name for entry in tmp_path.iterdir()] == [lost]


def test_a_folder_that_may_not_be_written_is_told_beforehand(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: path != tmp_path)  # root may do everything
    with pytest.raises(UsageError, match="you may not write to its folder"):
        files.check_target(tmp_path / "file")


def test_a_written_file_has_the_usual_permissions(tmp_path: Path) -> None:
    (tmp_path / "usual").touch()
    files.write_atomically(tmp_path / "file", "x")
    assert (tmp_path / "file").stat().st_mode == (tmp_path / "usual").stat().st_mode


def test_a_link_to_a_file_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "file")
    files.write_atomically(tmp_path / "link", "x")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "file").read_text() == "x"


@pytest.mark.parametrize("failure", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_failed_write_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failure: BaseException
) -> None:
    path = tmp_path / "file"
    path.write_text("old")

    def replace(source: Path, target: Path) -> None:
        assert source.parent == target.parent
        raise failure

    monkeypatch.setattr(os, "replace", replace)
    with pytest.raises(UsageError if isinstance(failure, OSError) else KeyboardInterrupt):
        files.write_atomically(path, "new")
    assert [(entry.name, entry.read_text()) for entry in tmp_path.iterdir()] == [("file", "old")]


def test_places_that_cannot_be_written_are_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path, tmp_path / "pipe", tmp_path / "file" / "below", tmp_path / "missing" / "file"):
        with pytest.raises(UsageError, match="cannot write") as caught:
            files.write_atomically(path, "x")
        assert str(path) in str(caught.value)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["file", "pipe"]


def test_json_is_an_option_of_every_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["table", "--output", str(tmp_path), "--neighbours", "2", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["q"] == 2
