"""The command line's frame: overview, errors, exit codes, signals, and what is loaded when."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from unittest.mock import Mock

import pytest

from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.signals import INTERRUPTED, stopping
from support import ROOT, interruptible

Capture = pytest.CaptureFixture[str]
CHECK = "table --check tables/t_table_omega05_q30.c"


def python(*arguments: str, stdout: int = subprocess.PIPE) -> subprocess.CompletedProcess[str]:
    """Run the interpreter with its output buffered, whatever the caller set."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    run = partial(subprocess.run, cwd=ROOT, env=environment, check=False, text=True)
    return run([sys.executable, *arguments], stdout=stdout, stderr=subprocess.PIPE)


def fake_command(monkeypatch: pytest.MonkeyPatch, work: Mock | Callable[[], int]) -> None:
    """Make ``mcp-asdf table`` do this."""
    command = SimpleNamespace(EPILOG="", add_arguments=lambda parser: None, run=lambda args: work())
    monkeypatch.setattr(cli, "_load", lambda name: command)


def test_the_overview_has_every_command(capsys: Capture) -> None:
    assert (cli.main([]), cli.main(["--help"])) == (2, 0)
    for text in capsys.readouterr():
        assert all(f"\n  {name} " in text and line in text for name, line in cli.COMMANDS.items())
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("mcp-asdf ")


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("tabel", "no command is called 'tabel'; did you mean table?"),
        ("xyz --json", "no command is called 'xyz'"),
        ("help", "no command is called 'help'; did you mean --help?"),
        ("--versoin", "no such option: --versoin; did you mean --version?"),
        ("swarm --robtos=3", "no such option: --robtos=3; did you mean --robots?"),
        ("swarm --robots=3 7", "no such argument: 7"),
        ("node --id 3 --interface socketcn", "; did you mean socketcan?"),
        ("plot a.parquet b.png --kind boxs", "; did you mean boxes?"),
        ("table --output . --neighbours many", "argument --neighbours: invalid int value: 'many'"),
    ],
)
def test_a_slip_of_the_pen_takes_two_lines(line: str, told: str, capsys: Capture) -> None:
    assert cli.main(line.split()) == 2
    out, err = capsys.readouterr()
    name = line.split(maxsplit=1)[0]
    program = f"mcp-asdf {name}" if name in cli.COMMANDS else "mcp-asdf"
    first, second = err.splitlines()
    assert out == "" and first.startswith(f"{program}: error: ") and first.endswith(told)
    assert second == f"See '{program} --help'."


@pytest.mark.parametrize(
    ("outcome", "code", "told"),
    [
        (0, 0, ""),
        (1, 1, ""),
        (UsageError("the value is 7; give 6"), 2, "error: the value is 7; give 6\n"),
        (FileNotFoundError(2, "No such file", "x"), 2, "error: cannot use x: No such file; give another\n"),
        (
            ImportError("no", name="pyarrow.lib"),
            2,
            "error: this needs pyarrow, which is not installed; run",
        ),
        (KeyboardInterrupt(), 130, "interrupted\n"),
    ],
)
def test_what_a_command_comes_to_is_the_exit_code(
    outcome: int | BaseException, code: int, told: str, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    fake_command(monkeypatch, Mock(side_effect=[outcome]))
    assert cli.main(["table"]) == code
    assert capsys.readouterr().err.startswith(f"mcp-asdf table: {told}" if told else "")


@pytest.mark.parametrize("error", [ZeroDivisionError(), ImportError("no", name="of_nowhere")])
def test_other_errors_are_not_hidden(error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    fake_command(monkeypatch, Mock(side_effect=error))
    with pytest.raises(type(error)):
        cli.main(["table"])


ENDINGS = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}


@pytest.mark.parametrize("number", ENDINGS)
@interruptible()
def test_every_signal_that_asks_to_end_acts_as_ctrl_c(
    number: signal.Signals, monkeypatch: pytest.MonkeyPatch, capsys: Capture
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


@interruptible()
def test_commands_that_end_by_themselves_tell_the_signal_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second signal changes nothing, but Ctrl-C acts at once."""

    def work() -> int:
        with stopping() as is_asked:
            assert not is_asked()
            for _ in range(2):
                os.kill(os.getpid(), signal.SIGTERM)
            assert is_asked()
            with pytest.raises(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGINT)
        return INTERRUPTED

    fake_command(monkeypatch, work)
    assert cli.main(["table"]) == 143


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
def test_ctrl_c_within_an_import_waits_for_its_end(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
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


def test_a_reader_that_leaves_ends_the_program_quietly() -> None:
    read_end, write_end = os.pipe()
    os.close(read_end)
    result = python("-m", "mcp_asdf_tools.cli.main", *CHECK.split(), stdout=write_end)
    os.close(write_end)
    assert (result.returncode, result.stderr) == (141, "")


@pytest.mark.parametrize(
    ("line", "code", "told"),
    [
        (f"{CHECK} >/dev/full", 2, "table: error: cannot write to standard output: No space left on device"),
        ("--help >/dev/full", 2, ": error: cannot write to standard output: No space left on device"),
        ("table --neighbours 0 --output . 2>&-", 2, ""),
        ("table --neighbours 0 --output . 2>/dev/full", 2, ""),
    ],
)
def test_output_that_cannot_be_written_is_no_failed_check(line: str, code: int, told: str) -> None:
    command = f"{shlex.quote(sys.executable)} -m mcp_asdf_tools.cli.main {line}"
    result = python("-c", f"import os; os.execl('/bin/sh', 'sh', '-c', {command!r})")
    assert (result.returncode, result.stdout, told in result.stderr) == (code, "", True)
    assert result.stderr.count("\n") == bool(told)


def test_a_command_loads_only_the_libraries_that_it_uses() -> None:
    """Each takes about as long to load as all that an overview needs, or much longer."""
    base = ["can", "mpmath", "numpy", "rich"]
    steps = [
        ("--help", []),
        ("tabel", []),
        ("table --help", ["mpmath"]),
        (CHECK, ["mpmath"]),
        ("dbc --help", ["can", "mpmath"]),
        *((f"{name} --help", base) for name in ("node", "radio", "replay", "swarm")),
        ("swarm --steps 1 --quiet", base),
    ]
    script = (
        "import sys; from mcp_asdf_tools.cli.main import main\n"
        f"for line in {[line for line, _ in steps]}:\n"
        "    main(line.split())\n"
        "    print('LOADED', *sorted({*sys.modules} & {'can', 'matplotlib', 'mpmath', 'numpy', 'pyarrow',\n"
        "        'rich', 'scipy'}))"
    )
    lines = [line for line in python("-c", script).stdout.splitlines() if line.startswith("LOADED")]
    assert [line.split()[1:] for line in lines] == [loaded for _, loaded in steps]


def examples(name: str) -> list[str]:
    """The examples of a command, without the program's name and comments."""
    lines = (line for line in cli._load(name).EPILOG.splitlines() if line.startswith("  mcp-asdf "))
    return [line.partition("  #")[0].removeprefix("  mcp-asdf ").strip() for line in lines]


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_every_command_explains_itself_with_examples_that_it_accepts(name: str, capsys: Capture) -> None:
    assert cli.main([name, "--help"]) == 0
    out = capsys.readouterr().out
    assert "--json" in out and "(default )" not in out
    called = [shlex.split(line.partition(" > ")[0], comments=True) for line in examples(name)]
    assert name in {words[0] for words in called}
    for command, *options in called:
        cli._parser_for(command, cli._load(command)).parsed(options)
