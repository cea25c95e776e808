"""The command line: overview, errors, exit codes, help, logs, and which libraries a command needs."""

from __future__ import annotations

import errno
import json
import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple
from unittest.mock import Mock

import pytest
from rich.console import Console

from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.extras import install_instruction
from support import HIDING, ROOT, slow

Capture = pytest.CaptureFixture[str]
CHECK = "table --check tables/t_table_omega05_q30.c"
EXIT_CODE_OF_BROKEN_PIPE = 128 + signal.SIGPIPE
"""What a shell reports of a program whose reader, such as ``head``, has left."""


def python(*arguments: str, cwd: Path = ROOT) -> subprocess.CompletedProcess[str]:
    """Run the Python interpreter in the folder ``cwd``, and return its exit code and output."""
    return subprocess.run([sys.executable, *arguments], cwd=cwd, capture_output=True, check=False, text=True)


def fake_command(
    monkeypatch: pytest.MonkeyPatch, work: Mock | Callable[[], int], libraries: tuple[str, ...] = ()
) -> None:
    """Let ``mcp-asdf table`` import ``libraries``, and then call ``work``, which returns its exit code."""
    command = SimpleNamespace(
        EPILOG="", LIBRARIES=libraries, add_arguments=lambda parser: None, run=lambda args: work()
    )
    monkeypatch.setattr(cli, "_load", lambda name: command)


def test_help_lists_every_command_with_its_purpose(capsys: Capture) -> None:
    assert cli.main(["--help"]) == 0
    text = capsys.readouterr().out
    for name, purpose in cli.COMMANDS.items():
        assert f"\n  {name:10}  {purpose}\n" in f"{text}\n"


def test_help_groups_commands_by_purpose(capsys: Capture) -> None:
    assert cli.main(["--help"]) == 0
    titles = re.findall("^([A-Z].*):$", capsys.readouterr().out, re.MULTILINE)
    assert titles == ["See a swarm calibrate itself", "Put the firmware into robots", "Experiments"]


def test_no_arguments_at_all_print_the_overview_as_an_error(capsys: Capture) -> None:
    assert cli.main([]) == 2
    out, err = capsys.readouterr()

    assert out == ""
    assert err.startswith("usage: mcp-asdf ")
    assert "See a swarm calibrate itself:" in err


def test_version_prints_program_and_version(capsys: Capture) -> None:
    assert cli.main(["--version"]) == 0
    assert re.fullmatch(r"mcp-asdf \d+\.\d+\.\d+\S*\n", capsys.readouterr().out)


SLIPS = [
    ("tabel", "no command is called 'tabel'; did you mean table?"),
    ("xyz", "no command is called 'xyz'"),
    ("swarm --fault los=0.1", "fault 'los=0.1': no kind is called 'los'; did you mean loss?"),
    ("swarm --fault loss,robot=1", "loss has no option 'robot'; did you mean robots?"),
    ("radio --id 3", "the bus virtual vcan0 is inside this process, where nothing else is"),
    ("replay run.log.events", "is what happened to the robots of a log; give the log, run.log"),
    ("help", "no command is called 'help'; did you mean --help?"),
    ("--versoin", "no such option: --versoin; did you mean --version?"),
    ("swarm --robtos=3", "no such option: --robtos=3; did you mean --robots?"),
    ("swarm --robots=3 7", "no such argument: 7"),
    ("node --id 3 --interface socketcn", "; did you mean socketcan?"),
    ("plot a.parquet b.png --kind boxs", "; did you mean boxes?"),
    ("table --omega 3 --output .", "decimal places, for example 0.05"),
    ("table --output . --neighbours many", "argument --neighbours: invalid int value: 'many'"),
]
"""Command lines with a mistake, and how the message about it ends."""


def program_of(line: str) -> str:
    """Return the name under which a command line's errors are reported."""
    command = line.split(maxsplit=1)[0]
    return f"mcp-asdf {command}" if command in cli.COMMANDS else "mcp-asdf"


@pytest.mark.parametrize(("line", "message_end"), SLIPS)
def test_bad_usage_is_reported_in_two_lines(line: str, message_end: str, capsys: Capture) -> None:
    assert cli.main(line.split()) == 2
    out, err = capsys.readouterr()
    first, second = err.splitlines()

    assert out == ""
    assert first.startswith(f"{program_of(line)}: error: ")
    assert first.endswith(message_end)
    assert second == f"See '{program_of(line)} --help'."


@pytest.mark.parametrize("line", [line for line, _ in SLIPS])
def test_bad_usage_is_the_same_message_in_one_line_of_json_if_asked_for(line: str, capsys: Capture) -> None:
    cli.main(line.split())
    first_line = capsys.readouterr().err.splitlines()[0]
    message = first_line.removeprefix(f"{program_of(line)}: error: ")

    assert cli.main([*line.split(), "--json"]) == 2
    out, err = capsys.readouterr()

    assert out == ""
    assert err.count("\n") == 1
    assert json.loads(err) == {"command": program_of(line), "error": message, "exit_code": 2}


@pytest.mark.parametrize(
    ("error", "exit_code", "message"),
    [
        (UsageError("the value is 7; give 6"), 2, "error: the value is 7; give 6\n"),
        (FileNotFoundError(2, "No such file", "x"), 2, "error: cannot use x: No such file; give another\n"),
        (ImportError("no", name="pyarrow.lib"), 2, "error: this needs pyarrow, which is not installed;"),
        (KeyboardInterrupt(), 128 + signal.SIGINT, "interrupted\n"),
    ],
)
def test_an_error_of_a_command_becomes_an_exit_code_and_a_message(
    error: BaseException,
    exit_code: int,
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Capture,
) -> None:
    fake_command(monkeypatch, Mock(side_effect=error))
    assert cli.main(["table"]) == exit_code
    assert capsys.readouterr().err.startswith(f"mcp-asdf table: {message}")


@pytest.mark.parametrize("exit_code", [0, 1])
def test_a_command_that_ends_by_itself_decides_on_its_exit_code(
    exit_code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake_command(monkeypatch, lambda: exit_code)
    assert cli.main(["table"]) == exit_code


@pytest.mark.parametrize("error", [ZeroDivisionError(), ImportError("no", name="of_nowhere")])
def test_an_error_of_the_program_itself_is_raised(error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    fake_command(monkeypatch, Mock(side_effect=error))
    with pytest.raises(type(error)):
        cli.main(["table"])


@pytest.mark.parametrize(("line", "program"), [(CHECK, "mcp-asdf table"), ("--help", "mcp-asdf")])
def test_output_to_a_full_disk_is_an_error(
    line: str, program: str, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    reason = "cannot write to standard output: No space left on device; send it elsewhere"
    with open("/dev/full", "w") as full, monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", full)
        assert cli.main(line.split()) == 2

    assert capsys.readouterr().err.splitlines()[0] == f"{program}: error: {reason}"


def test_a_command_whose_output_nobody_reads_any_more_ends_as_if_by_sigpipe(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    read_end, write_end = os.pipe()
    os.close(read_end)
    with open(write_end, "w") as stream, monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", stream)
        assert cli.main(CHECK.split()) == EXIT_CODE_OF_BROKEN_PIPE

    assert capsys.readouterr().err == ""


def test_a_usage_error_has_its_exit_code_without_a_standard_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", None)
    assert cli.main(["tabel"]) == 2


def test_a_usage_error_has_its_exit_code_if_standard_error_is_full(monkeypatch: pytest.MonkeyPatch) -> None:
    with open("/dev/full", "w") as full, monkeypatch.context() as patch:
        patch.setattr(sys, "stderr", full)
        assert cli.main(["tabel"]) == 2


def test_an_operating_system_error_without_a_file_is_reported_as_such(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    fake_command(monkeypatch, Mock(side_effect=OSError(errno.EMFILE, "Too many open files")))
    assert cli.main(["table"]) == 2
    reason = "the operating system reports: Too many open files; resolve that and run the command again"
    assert capsys.readouterr().err.splitlines()[0] == f"mcp-asdf table: error: {reason}"


def test_a_broken_pipe_that_is_not_standard_output_is_an_error(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    fake_command(monkeypatch, Mock(side_effect=BrokenPipeError(errno.EPIPE, "Broken pipe")))
    assert cli.main(["table"]) == 2
    assert "the operating system reports: Broken pipe" in capsys.readouterr().err


def print_a_table() -> int:
    """Print with rich, which would end the program on a broken pipe by itself; return exit code 0."""
    Console().print("a table")
    return 0


def write_a_line() -> int:
    """Write to standard output directly, as ``dbc`` does; return exit code 0."""
    sys.stdout.write("a line\n")
    return 0


@pytest.mark.parametrize("work", [print_a_table, write_a_line])
def test_a_reader_that_leaves_ends_the_command_however_it_prints(
    work: Callable[[], int], monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    read_end, write_end = os.pipe()
    os.close(read_end)
    fake_command(monkeypatch, work)
    with open(write_end, "w") as stream, monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", stream)
        assert cli.main(["table"]) == EXIT_CODE_OF_BROKEN_PIPE

    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("line", ["dbc", "--help", CHECK, "swarm --robots 3 --steps 5"])
def test_a_command_succeeds_without_a_standard_output(line: str) -> None:
    """The shell closes it (>&-); the command goes on as if its output were thrown away."""
    program = shlex.join([sys.executable, "-m", "mcp_asdf_tools.cli.main"])
    result = subprocess.run(
        ["sh", "-c", f"{program} {line} >&-"], cwd=ROOT, capture_output=True, check=False, text=True
    )

    assert result.returncode == 0
    assert result.stderr == ""


@pytest.mark.parametrize("target", ["&-", "/dev/full"])
def test_a_usage_error_has_its_exit_code_even_if_it_cannot_be_printed(target: str) -> None:
    """The shell closes standard error (2>&-), or sends it to a full disk."""
    program = shlex.join([sys.executable, "-m", "mcp_asdf_tools.cli.main"])
    result = subprocess.run(
        ["sh", "-c", f"{program} tabel 2>{target}"],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        check=False,
        text=True,
    )

    assert result.returncode == 2
    assert result.stdout == ""


def run_without_extras(lines: Iterable[str], folder: Path) -> tuple[list[int], list[str]]:
    """Run commands one after the other in one Python that finds no module of the extras.

    Returns the exit codes, and the lines that all commands together wrote on standard error.
    """
    script = (
        f"{HIDING}\n"
        "from mcp_asdf_tools.cli.main import main\n"
        f"exit_codes = [main(line.split()) for line in {list(lines)}]\n"
        "print('exit codes:', *exit_codes)\n"
    )
    result = python("-c", script, cwd=folder)
    _, exit_codes = result.stdout.splitlines()[-1].split("exit codes: ")
    return [int(exit_code) for exit_code in exit_codes.split()], result.stderr.splitlines()


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_help_has_every_option_and_all_examples(name: str, capsys: Capture) -> None:
    assert cli.main([name, "--help"]) == 0
    text = capsys.readouterr().out
    parser = cli._parser_for(name, cli._load(name))
    options = [action.option_strings[-1] for action in parser._actions if action.option_strings]
    shown_options = re.findall(r"^  (?:-\w.*?, )?(--[\w-]+)", text, re.MULTILINE)

    assert sorted(shown_options) == sorted(options)
    assert text.endswith(f"\n{parser.epilog}\n")


def test_help_begins_with_what_the_command_cannot_do_without(capsys: Capture) -> None:
    usages = []
    for name in ("table", "radio", "plot", "swarm"):
        cli.main([name, "--help"])
        usages.append(capsys.readouterr().out.splitlines()[0])

    assert usages == [
        "usage: mcp-asdf table (--output DIR | --check FILE [FILE ...]) [OPTION ...]",
        "usage: mcp-asdf radio --id ID [OPTION ...]",
        "usage: mcp-asdf plot [OPTION ...] FILE PICTURE",
        "usage: mcp-asdf swarm [OPTION ...]",
    ]


def test_help_has_common_parameters_before_all_others(capsys: Capture) -> None:
    cli.main(["swarm", "--help"])
    text = capsys.readouterr().out
    assert text.index("\n  --robots") < text.index("\nfurther parameters:") < text.index("\n  --omega")


def test_help_shows_the_firmwares_of_the_project_and_that_there_may_be_more(capsys: Capture) -> None:
    cli.main(["simulate", "--help"])
    assert "--firmware {native,mirror,reference,...}" in capsys.readouterr().out


def test_commands_for_robots_and_all_helps_need_no_libraries_of_the_studies(tmp_path: Path) -> None:
    lines = [
        "swarm --robots 4 --steps 30 --filter-period 10 --quiet --log run.log",
        "swarm --robots 4 --steps 5 --topology dynamic --quiet",
        "replay run.log",
        "view run.log --export run.html",
        "table --output tables --neighbours 4",
        "radio --id 3 --robots 3 --steps 1 --steps-per-second 500 --interface virtual",
        "firmware vendor",
        "dbc --output mcp_asdf.dbc",
        "crosscheck --replay robot:2:1:64:0:2147483648,step:1",
        *(f"{name} --help" for name in cli.COMMANDS),
    ]
    exit_codes, errors = run_without_extras(lines, tmp_path)

    assert exit_codes == [0] * len(lines), errors


LINES_AND_MISSING_MODULES = [
    ("simulate --steps 1000 --trials 1", "pyarrow"),
    ("sweep physical --output physical.parquet", "pyarrow"),
    ("score x.parquet", "pyarrow"),
    ("plot x.parquet x.png", "matplotlib"),
    ("export x.parquet x.csv", "pyarrow"),
    ("reproduce --quick", "matplotlib"),
    ("swarm --firmware reference --log reference.log", "scipy"),
]
"""Command lines that need the extra "study", each with the module of it that is missing."""


@pytest.mark.slow
def test_a_command_that_lacks_a_library_names_it_before_it_writes_anything(tmp_path: Path) -> None:
    lines = [line for line, _ in LINES_AND_MISSING_MODULES]
    exit_codes, errors = run_without_extras(lines, tmp_path)
    exit_code_of_usage_error = 2
    assert exit_codes == [exit_code_of_usage_error] * len(lines)
    assert list(tmp_path.iterdir()) == []
    messages = errors[::2]  # each error has two lines, and the second one names --help
    for message, (_, module) in zip(messages, LINES_AND_MISSING_MODULES, strict=True):
        assert message.endswith(
            f"this needs {module}, which is not installed; {install_instruction('study')}"
        )


@pytest.mark.slow
def test_a_function_that_lacks_a_library_names_it_as_the_command_does(tmp_path: Path) -> None:
    calls = (
        "m.simulate(m.Experiment(steps=1000, trials=1))",
        "m.plot_boxes([])",
        "m.read_table('x.parquet')",
        "m.to_frame('x.parquet')",
        "m.emulate(m.SwarmSettings(firmware='reference', steps=10))",
    )
    script = (
        f"{HIDING}\n"
        "import mcp_asdf_tools as m\n"
        f"for call in {calls}:\n"
        "    try:\n"
        "        eval(call)\n"
        "    except m.UsageError as error:\n"
        "        print(error)\n"
    )
    messages = python("-c", script, cwd=tmp_path).stdout.splitlines()

    assert len(messages) == len(calls)
    assert all(message.endswith(install_instruction("study")) for message in messages)


SLOW_LIBRARIES = ["can", "cffi", "matplotlib", "mpmath", "numpy", "pyarrow", "rich", "scipy"]
"""Libraries of which each takes longer to import than all that a help needs."""


def libraries_loaded_by(lines: Iterable[str]) -> list[list[str]]:
    """Run commands one by one in a new Python; return the slow libraries loaded after each, sorted."""
    script = (
        "import sys; from mcp_asdf_tools.cli.main import main\n"
        f"for line in {[*lines]}:\n"
        "    main(line.split())\n"
        f"    print('LOADED', *[name for name in {SLOW_LIBRARIES} if name in sys.modules])\n"
    )
    output = python("-c", script).stdout.splitlines()
    lists_of_libraries = [line.removeprefix("LOADED") for line in output if line.startswith("LOADED")]
    return [names.split() for names in lists_of_libraries]


def test_no_help_loads_a_slow_library() -> None:
    lines = ["--help", *(f"{name} --help" for name in cli.COMMANDS)]
    assert libraries_loaded_by(lines) == [[]] * len(lines)


def test_a_name_that_is_no_command_loads_no_slow_library() -> None:
    assert libraries_loaded_by(["tabel"]) == [[]]


def test_the_check_of_a_table_loads_mpmath_alone() -> None:
    assert libraries_loaded_by([CHECK]) == [["mpmath"]]


@pytest.mark.slow
def test_a_swarm_loads_neither_matplotlib_nor_pyarrow_nor_scipy() -> None:
    assert libraries_loaded_by(["swarm --steps 1 --quiet"]) == [["can", "mpmath", "numpy", "rich"]]


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_every_command_has_examples_that_it_accepts(name: str) -> None:
    commands = examples_of(name)
    assert any(command == name for command, _ in commands)
    for command, options in commands:
        cli._parser_for(command, cli._load(command)).parse_all(options)


@pytest.mark.parametrize(
    "name", [*sorted(cli.COMMANDS.keys() - {"node", "radio", "crosscheck"}), *slow(["crosscheck"])]
)
def test_examples_print_what_the_help_shows(
    name: str, capsys: Capture, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Not those of node and radio, which want a second program."""
    monkeypatch.chdir(tmp_path)
    write_readings(tmp_path / "readings.csv")  # which an example reads

    examples = examples_with_output(name)
    # The last ones may show nothing; the first ones may make the files that a later one reads.
    while examples and not examples[-1].shown_lines:
        examples.pop()
    for example in examples:
        assert cli.main(shlex.split(example.command, comments=True)) == 0
        printed_lines = [line.strip() for line in capsys.readouterr().out.splitlines()]
        assert set(example.shown_lines) <= set(printed_lines), example.command


def write_readings(path: Path) -> None:
    """Write readings of a sensor over 20 black and 20 white tiles."""
    lines = [f"{200 + 7 * number},black\n{400 + 13 * number},white\n" for number in range(1, 21)]
    path.write_text("".join(lines))


class Example(NamedTuple):
    """An example below a help: the command without "mcp-asdf", and the lines shown of its output."""

    command: str
    shown_lines: list[str]


def examples_with_output(name: str) -> list[Example]:
    """Return the examples below a command's help; what they print stands further to the right below them."""
    matches = re.findall(r"^  mcp-asdf (.*)\n((?:      .*\n)*)", cli._load(name).EPILOG, re.MULTILINE)
    return [Example(command, [line.strip() for line in output.splitlines()]) for command, output in matches]


def examples_of(name: str) -> list[tuple[str, list[str]]]:
    """Return the examples below a command's help: the command of each, and its options.

    Comments, and files to which a shell would write the output, are left out.
    """
    examples = []
    for line in cli._load(name).EPILOG.splitlines():
        if line.startswith("  mcp-asdf "):
            line_without_output_file, _, _ = line.partition(" > ")
            _, command, *options = shlex.split(line_without_output_file, comments=True)
            examples.append((command, options))
    return examples


SHORT = "--robots 4 --steps 30 --filter-period 10"
EXPERIMENT = "robots = 3\nsteps = 20\nfilter_period = 10\ntrials = 2\n"


REPEATABLE = [
    (f"swarm {SHORT} --flawed 50% --fault 'loss=0.5,robots=0+2' --fault liar,robots=3,x=1", "--seed=1"),
    (f"swarm {SHORT} --seed=7 --true-accuracy=0.30000000000000004 --latency=1 --compare", ""),
    (
        "radio --id 3 --interface virtual --robots 3 --steps 2 --steps-per-second 500 --fault loss=0.3",
        "--seed=1",
    ),
    (f"simulate {SHORT} --trials 2 --drift linear --drift-rate=-1e-5", "--seed=1"),
    ("simulate --output results.parquet one.toml --seed 3", ""),
    ("sweep grid.toml --output 'two words.parquet'", "--seed=1"),
    ("table --output tables --omega 0.10 --neighbours 3", ""),
    ("table --output tables", "--omega=0.05 --neighbours=127"),
]
"""Command lines, and the options that the line for the same run has in front of what was typed."""


def with_settled_options(line: str, settled_options: str) -> list[str]:
    """Return the words of a command line with options inserted behind the command."""
    command, *options = shlex.split(line)
    return [command, *settled_options.split(), *options]


@pytest.fixture
def experiment_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in a folder with one.toml, a small experiment, and grid.toml, two of them."""
    monkeypatch.chdir(tmp_path)
    Path("one.toml").write_text(EXPERIMENT)
    Path("grid.toml").write_text(f'{EXPERIMENT}[[grid]]\nfilter = ["none", "asdf-plus"]\n')


@pytest.mark.usefixtures("experiment_files")
@pytest.mark.parametrize(("line", "settled_options"), REPEATABLE)
def test_a_run_ends_with_the_line_for_the_same_run(line: str, settled_options: str, capsys: Capture) -> None:
    assert cli.main(shlex.split(line)) == 0
    lines_for_the_same_run = [
        output_line
        for output_line in capsys.readouterr().out.splitlines()
        if output_line.startswith("again: ")
    ]
    same_run = with_settled_options(line, settled_options)

    assert lines_for_the_same_run == [f"again: mcp-asdf {shlex.join(same_run)}"]


@pytest.mark.usefixtures("experiment_files")
@pytest.mark.parametrize(("line", "settled_options"), REPEATABLE)
def test_the_printed_line_for_the_same_run_prints_itself_again(
    line: str, settled_options: str, capsys: Capture
) -> None:
    same_run = with_settled_options(line, settled_options)
    assert cli.main(same_run) == 0
    assert f"again: mcp-asdf {shlex.join(same_run)}\n" in capsys.readouterr().out


@pytest.mark.usefixtures("experiment_files")
@pytest.mark.parametrize(("line", "settled_options"), REPEATABLE)
def test_a_run_prints_json_alone_if_asked_to(line: str, settled_options: str, capsys: Capture) -> None:
    assert cli.main([*shlex.split(line), "--json"]) == 0
    assert isinstance(json.loads(capsys.readouterr().out), dict)


QUIET_SWARM = ["swarm", "--robots", "3", "--steps", "5", "--filter-period", "1", "--quiet"]


def messages_of(err: str) -> list[str]:
    """Return the lines that are logged on standard error, without their times.

    Such a line begins with date and time: ``2026-03-01 12:00:00,000 INFO ...``.
    """
    logged_lines = [line for line in err.splitlines() if line.startswith("20")]
    return [line.split(maxsplit=2)[2] for line in logged_lines]


def test_a_command_logs_nothing_unless_asked_to(capsys: Capture) -> None:
    assert cli.main([*QUIET_SWARM, "--slcan", "0"]) == 0
    assert messages_of(capsys.readouterr().err) == []


def test_v_logs_versions_first_then_the_command_line_and_at_last_the_exit_code(capsys: Capture) -> None:
    assert cli.main([*QUIET_SWARM, "-v"]) == 0
    messages = messages_of(capsys.readouterr().err)

    assert messages[0].startswith("INFO mcp_asdf_tools.cli: mcp-asdf ")
    assert messages[1].startswith("INFO mcp_asdf_tools.cli: command line: mcp-asdf swarm --robots 3")
    assert messages[-1].startswith("INFO mcp_asdf_tools.cli: exit code 0 after ")


def test_v_logs_each_bus_that_is_opened(capsys: Capture) -> None:
    assert cli.main([*QUIET_SWARM, "--channel", "v{robot}", "-v"]) == 0
    messages = messages_of(capsys.readouterr().err)
    for channel in ("v0", "v1", "v2"):
        assert f"INFO mcp_asdf_tools.bus.interfaces: opened the bus virtual {channel}" in messages


def test_v_logs_the_robots_that_are_up_and_the_files_that_are_written(
    tmp_path: Path, capsys: Capture
) -> None:
    log = tmp_path / "run.log"
    assert cli.main([*QUIET_SWARM, "--log", str(log), "-v"]) == 0
    messages = messages_of(capsys.readouterr().err)

    assert "INFO mcp_asdf_tools.cli.swarm: 3 robots are up, 0 of them elsewhere" in messages
    assert f"INFO mcp_asdf_tools.common.files: wrote {log}.json" in messages


def test_vv_logs_all_options_too(capsys: Capture) -> None:
    assert cli.main([*QUIET_SWARM, "-vv"]) == 0
    options = [line for line in messages_of(capsys.readouterr().err) if " options: " in line]
    assert len(options) == 1
    assert "'filter_period': 1," in options[0]


def test_vv_logs_each_batch_of_trials(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    """Two experiments of two trials each; trials as short as these make one batch for each experiment."""
    monkeypatch.chdir(tmp_path)
    Path("grid.toml").write_text(
        'robots = 3\nsteps = 20\nfilter_period = 10\ntrials = 2\n[[grid]]\nfilter = ["none", "asdf-plus"]\n'
    )
    assert cli.main(["sweep", "grid.toml", "--workers", "1", "-vv"]) == 0

    logger = "mcp_asdf_tools.experiments.sweep"
    messages = [message for message in messages_of(capsys.readouterr().err) if logger in message]
    first_message, *messages_of_batches = messages
    assert first_message == f"INFO {logger}: 4 trials to run on this process"
    assert len(messages_of_batches) == 2
    batch_of_first_experiment = messages_of_batches[0]
    assert batch_of_first_experiment.startswith(
        f"DEBUG {logger}: finished trials 0 to 1 of Experiment(robots=3, "
    )


def test_vv_logs_where_an_error_was_raised(capsys: Capture) -> None:
    assert cli.main(["table", "--output", "nowhere/tables", "--omega", "3", "-vv"]) == 2
    err = capsys.readouterr().err
    assert "ended by UsageError\nTraceback (most recent call last):" in err
    assert err.splitlines()[-1] == "See 'mcp-asdf table --help'."


def test_logging_does_not_disturb_the_json_of_a_result(capsys: Capture) -> None:
    assert cli.main(["table", "--check", "tables/t_table_omega05_q30.c", "-v", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["ok"] is True


def test_logging_is_off_again_in_the_next_command(capsys: Capture) -> None:
    """Both commands run in this process."""
    assert cli.main([*QUIET_SWARM, "-v"]) == 0
    capsys.readouterr()
    assert cli.main(QUIET_SWARM) == 0
    assert capsys.readouterr().err == ""


def test_the_library_is_silent_where_logging_is_not_configured() -> None:
    code = "import mcp_asdf_tools as m; m.emulate(m.SwarmSettings(robots=3, steps=5, filter_period=1))"
    result = python("-c", code)

    assert result.returncode == 0
    assert result.stdout == ""
    assert result.stderr == ""
