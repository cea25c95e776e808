"""The command line: overview, errors, exit codes, help, logs, and which libraries a command needs."""

from __future__ import annotations

import errno
import json
import logging
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

from mcp_asdf_tools import Experiment, SwarmSettings, emulate, simulate
from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.extras import install_instruction
from support import HIDING, ROOT, slow

Capture = pytest.CaptureFixture[str]


def python(*arguments: str, cwd: Path = ROOT) -> subprocess.CompletedProcess[str]:
    """Run the Python interpreter in the folder ``cwd``, and return its exit code and output."""
    return subprocess.run([sys.executable, *arguments], cwd=cwd, capture_output=True, check=False, text=True)


def replace_command_table(
    monkeypatch: pytest.MonkeyPatch, work: Mock | Callable[[], int], libraries: tuple[str, ...] = ()
) -> None:
    """Replace the command ``mcp-asdf table``: it imports ``libraries``, and then does ``work``.

    ``work`` returns the exit code of the command.
    """
    command = SimpleNamespace(
        EPILOG="", LIBRARIES=libraries, add_arguments=lambda parser: None, run=lambda args: work()
    )
    monkeypatch.setattr(cli, "_load", lambda name: command)


def test_help_lists_every_command_with_its_purpose_under_three_titles(capsys: Capture) -> None:
    """A command stands in a line such as "  node        run one robot on a CAN bus", and a title above."""
    assert cli.main(["--help"]) == 0
    text = capsys.readouterr().out
    lines = text.splitlines()
    titles = re.findall("^([A-Z].*):$", text, re.MULTILINE)

    for name, purpose in cli.COMMANDS.items():
        assert f"  {name:10}  {purpose}" in lines
    assert titles == ["See a swarm calibrate itself", "Put the firmware into robots", "Experiments"]


def test_mcp_asdf_without_arguments_prints_the_list_of_commands_as_an_error(capsys: Capture) -> None:
    """The list goes to standard error, and the exit code is 2."""
    assert cli.main([]) == 2
    out, err = capsys.readouterr()

    assert out == ""
    assert err.startswith("usage: mcp-asdf ")
    assert "See a swarm calibrate itself:" in err, "the title of the first commands"


def test_version_prints_the_program_and_three_numbers(capsys: Capture) -> None:
    """It may print "mcp-asdf 1.2.3". A mark of a version before a release may follow, as in "1.2.3rc1"."""
    assert cli.main(["--version"]) == 0
    assert re.fullmatch(r"mcp-asdf \d+\.\d+\.\d+\S*\n", capsys.readouterr().out)


@pytest.mark.parametrize(
    "line", ["--channel can0", "--channel=can0", "-c can0", "-ccan0", "-c=can0", "-vccan0", "-vvc can0"]
)
def test_an_option_counts_as_typed_by_its_long_name_in_each_form_that_is_accepted(line: str) -> None:
    """The option ``--channel`` may be typed as ``-c``, and behind other options that have no values."""
    args = cli._parser_for("view", cli._load("view")).parse_all(line.split())
    assert args.channel == "can0"
    assert args.typed_options - {"--verbose"} == {"--channel"}


@pytest.mark.parametrize("arguments", [[], ["--", "-ccan0"], ["--", "--channel"]])
def test_a_file_with_the_name_of_an_option_does_not_count_as_one(arguments: list[str]) -> None:
    """The shell passes such a name behind ``--``."""
    args = cli._parser_for("view", cli._load("view")).parse_all(arguments)
    assert args.typed_options == set()


MISTAKES = [
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


def program_named_by_errors(line: str) -> str:
    """Return the name under which a command line's errors are reported."""
    command = line.split(maxsplit=1)[0]
    return f"mcp-asdf {command}" if command in cli.COMMANDS else "mcp-asdf"


@pytest.mark.parametrize(("wrong_line", "expected_message_end"), MISTAKES)
def test_a_mistake_in_a_command_line_is_reported_in_two_lines(
    wrong_line: str, expected_message_end: str, capsys: Capture
) -> None:
    """The lines about ``swarm --fault los=0.1``, for example, are these.

    mcp-asdf swarm: error: fault 'los=0.1': no kind is called 'los'; did you mean loss?
    See 'mcp-asdf swarm --help'.
    """
    assert cli.main(wrong_line.split()) == 2
    out, err = capsys.readouterr()
    first_line, second_line = err.splitlines()

    assert out == ""
    program = program_named_by_errors(wrong_line)  # "mcp-asdf swarm", or "mcp-asdf" for no known command
    assert first_line.startswith(f"{program}: error: ")
    assert first_line.endswith(expected_message_end)
    assert second_line == f"See '{program} --help'."


@pytest.mark.parametrize(
    ("wrong_line", "expected_program", "expected_message"),
    [
        ("tabel", "mcp-asdf", "no command is called 'tabel'; did you mean table?"),
        ("swarm --robtos=3", "mcp-asdf swarm", "no such option: --robtos=3; did you mean --robots?"),
        ("replay x.log.events", "mcp-asdf replay", "x.log.events is what happened to the robots of a log"),
    ],
    ids=["no command", "no option", "refused by the command"],
)
def test_a_mistake_in_a_command_line_is_reported_in_one_line_of_json_if_asked_for(
    wrong_line: str, expected_program: str, expected_message: str, capsys: Capture
) -> None:
    """The line goes to standard error, and has the keys "command", "error" and "exit_code"."""
    assert cli.main([*wrong_line.split(), "--json"]) == 2
    out, err = capsys.readouterr()
    report = json.loads(err)

    assert out == ""
    assert err.count("\n") == 1, "one line"
    assert report.keys() == {"command", "error", "exit_code"}
    assert report["command"] == expected_program
    assert report["error"].startswith(expected_message)
    assert report["exit_code"] == 2


@pytest.mark.parametrize(
    ("error", "expected_exit_code", "expected_message"),
    [
        (UsageError("the value is 7; give 6"), 2, "error: the value is 7; give 6\n"),
        (FileNotFoundError(2, "No such file", "x"), 2, "error: cannot use x: No such file; give another\n"),
        (
            OSError(errno.EMFILE, "Too many open files"),
            2,
            "error: the operating system reports: Too many open files; resolve that and run the command",
        ),
        # The pipe is one to another program, and not the standard output.
        (BrokenPipeError(errno.EPIPE, "Broken pipe"), 2, "error: the operating system reports: Broken pipe"),
        (ImportError("no", name="pyarrow.lib"), 2, "error: this needs pyarrow, which is not installed;"),
        (KeyboardInterrupt(), 128 + signal.SIGINT, "interrupted\n"),
    ],
)
def test_an_error_that_a_command_raises_becomes_an_exit_code_and_a_message(
    error: BaseException,
    expected_exit_code: int,
    expected_message: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Capture,
) -> None:
    """For example, UsageError("the value is 7") becomes exit code 2 and the message "error: the value is 7".

    The command ``table`` is replaced by one that raises the error.
    """
    raise_error = Mock(side_effect=error)
    replace_command_table(monkeypatch, raise_error)

    assert cli.main(["table"]) == expected_exit_code
    assert capsys.readouterr().err.startswith(f"mcp-asdf table: {expected_message}")


@pytest.mark.parametrize("exit_code", [0, 1])
def test_the_exit_code_that_a_command_returns_is_that_of_the_program(
    exit_code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command ``table`` is replaced by one that only returns the exit code, which ``main`` returns."""
    replace_command_table(monkeypatch, Mock(return_value=exit_code))
    assert cli.main(["table"]) == exit_code


@pytest.mark.parametrize("error", [ZeroDivisionError(), ImportError("no", name="of_nowhere")])
def test_an_error_that_is_a_mistake_of_the_program_is_raised(
    error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The user cannot mend it, so Python prints a traceback. Here the command ``table`` raises the error.

    A division by zero is such a mistake, and so is the import of a module that nothing could install.
    """
    raise_error = Mock(side_effect=error)
    replace_command_table(monkeypatch, raise_error)

    with pytest.raises(type(error)):
        cli.main(["table"])


@pytest.mark.parametrize(
    ("line", "expected_program"),
    [("table --check tables/t_table_omega05_q30.c", "mcp-asdf table"), ("--help", "mcp-asdf")],
)
def test_a_command_whose_output_goes_to_a_full_disk_fails_with_the_reason(
    line: str, expected_program: str, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    """Linux's device /dev/full stands for the full disk."""
    reason = "cannot write to standard output: No space left on device; send it elsewhere"
    with open("/dev/full", "w") as full, monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", full)
        assert cli.main(line.split()) == 2

    assert capsys.readouterr().err.startswith(f"{expected_program}: error: {reason}\n")


def print_with_rich() -> int:
    """Print with the library rich, which would end the program on a broken pipe by itself."""
    Console().print("a table")
    return 0


def write_to_standard_output() -> int:
    """Write directly, as ``mcp-asdf dbc`` does."""
    sys.stdout.write("a line\n")
    return 0


@pytest.mark.parametrize("work", [print_with_rich, write_to_standard_output])
def test_a_command_ends_silently_when_the_program_that_reads_its_output_has_ended(
    work: Callable[[], int], monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    """The reader may be ``head``. Here standard output is a pipe whose reading end is closed.

    The command ``table`` is replaced by one whose ``work`` is to print with rich or by itself. The exit code
    is what a shell reports of a program that the signal SIGPIPE has ended.
    """
    read_end, write_end = os.pipe()
    os.close(read_end)
    replace_command_table(monkeypatch, work)

    with open(write_end, "w") as stream, monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", stream)
        assert cli.main(["table"]) == 128 + signal.SIGPIPE

    assert capsys.readouterr().err == ""


def run_in_shell(shell_command: str) -> tuple[int, str]:
    """Run a command of the shell, in which mcp-asdf is this project's; return its exit code and its errors.

    The errors are what it writes to standard error.
    """
    program = shlex.join([sys.executable, "-m", "mcp_asdf_tools.cli.main"])
    script = shell_command.replace("mcp-asdf", program)
    result = subprocess.run(["sh", "-c", script], cwd=ROOT, capture_output=True, check=False, text=True)
    return result.returncode, result.stderr


@pytest.mark.parametrize("options", ["--help", *slow(["dbc", "swarm --robots 3 --steps 5"])])
def test_a_command_whose_standard_output_is_closed_succeeds(options: str) -> None:
    """The shell closes it by ``>&-``. What the command would print is thrown away."""
    exit_code, errors = run_in_shell(f"mcp-asdf {options} >&-")
    assert exit_code == 0
    assert errors == ""


def test_a_mistake_in_a_command_line_has_exit_code_2_without_a_standard_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Python sets ``sys.stderr`` to None if it is closed. No command is called "tabel"."""
    monkeypatch.setattr(sys, "stderr", None)
    assert cli.main(["tabel"]) == 2


def test_a_mistake_in_a_command_line_has_exit_code_2_if_its_message_goes_to_a_full_disk() -> None:
    """No command is called "tabel". Linux's device /dev/full stands for the full disk."""
    exit_code, errors = run_in_shell("mcp-asdf tabel 2>/dev/full")
    assert exit_code == 2
    assert errors == ""


def run_commands_without_extras(lines: Iterable[str], folder: Path) -> tuple[list[int], list[str]]:
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


def help_of(name: str, capsys: Capture) -> str:
    """Return what a command prints if it is called with --help."""
    assert cli.main([name, "--help"]) == 0
    return capsys.readouterr().out


def test_the_help_of_a_command_ends_with_its_examples(capsys: Capture) -> None:
    """The examples of a command are a text in its module."""
    examples = cli._load("swarm").EPILOG
    assert help_of("swarm", capsys).endswith(f"\n{examples}\n")


def test_the_help_of_a_command_begins_with_the_options_and_files_that_it_needs(capsys: Capture) -> None:
    """The first line names them: one of two options, an id, two files, or for ``swarm`` nothing."""
    expected_usages = {
        "table": "usage: mcp-asdf table (--output DIR | --check FILE [FILE ...]) [OPTION ...]",
        "radio": "usage: mcp-asdf radio --id ID [OPTION ...]",
        "plot": "usage: mcp-asdf plot [OPTION ...] FILE PICTURE",
        "swarm": "usage: mcp-asdf swarm [OPTION ...]",
    }
    for name, expected_usage in expected_usages.items():
        usage, *_further_lines = help_of(name, capsys).splitlines()
        assert usage == expected_usage


def test_help_lists_the_common_parameters_of_a_swarm_before_further_ones(capsys: Capture) -> None:
    """The number of robots, for example, is common, and the threshold omega is not.

    The ellipsis behind three firmwares stands for the firmwares of extensions.
    """
    text = help_of("swarm", capsys)

    common_parameters, further_parameters = text.split("\nfurther parameters:")
    assert "\n  --robots" in common_parameters
    assert "\n  --omega" in further_parameters
    assert "--firmware {native,mirror,reference,...}" in text


def test_commands_for_swarms_and_robots_need_no_library_of_the_extra_study(tmp_path: Path) -> None:
    """The libraries of the extra, such as pyarrow, are needed for experiments and pictures only."""
    lines = [
        "swarm --robots 4 --steps 10 --topology dynamic --quiet --log run.log",
        "replay run.log",
        "view run.log --export run.html",
        "table --output tables --neighbours 4",
        "radio --id 3 --robots 3 --steps 1 --steps-per-second 500 --interface virtual",
        "firmware vendor",
        "dbc --output mcp_asdf.dbc",
        "crosscheck --replay robot:2:1:64:0:2147483648,step:1",
    ]
    exit_codes, errors = run_commands_without_extras(lines, tmp_path)

    assert exit_codes == [0] * len(lines), errors


MISSING_MODULES_BY_COMMAND_LINE = {
    "simulate --steps 1000 --trials 1": "pyarrow",
    "sweep physical --output physical.parquet": "pyarrow",
    "score x.parquet": "pyarrow",
    "plot x.parquet x.png": "matplotlib",
    "export x.parquet x.csv": "pyarrow",
    "reproduce --quick": "matplotlib",
    "swarm --firmware reference --log reference.log": "scipy",
}
"""Command lines that need the extra "study", and the module of that extra that each of them lacks."""


@pytest.mark.slow
def test_commands_whose_libraries_are_not_installed_say_how_to_install_them_and_write_no_file(
    tmp_path: Path,
) -> None:
    """One of the commands is ``simulate``, which needs pyarrow. The libraries belong to the extra "study".

    Each command prints two lines, and the second one names --help.
    """
    lines = MISSING_MODULES_BY_COMMAND_LINE.keys()
    missing_modules = MISSING_MODULES_BY_COMMAND_LINE.values()

    exit_codes, error_lines = run_commands_without_extras(lines, tmp_path)

    messages = error_lines[::2]  # every first line, without those that name --help
    how_to_install = install_instruction("study")
    assert exit_codes == [2] * len(lines)
    assert list(tmp_path.iterdir()) == []
    for module, message in zip(missing_modules, messages, strict=True):
        assert message.endswith(f"this needs {module}, which is not installed; {how_to_install}")


@pytest.mark.slow
@pytest.mark.parametrize(
    "call",
    [
        "m.simulate(m.Experiment(steps=1000, trials=1))",
        "m.plot_boxes([])",
        "m.read_table('x.parquet')",
        "m.emulate(m.SwarmSettings(firmware='reference', steps=10))",
    ],
)
def test_a_function_whose_library_is_not_installed_raises_an_error_that_says_how_to_install_it(
    call: str,
) -> None:
    """One function is ``read_table``, which needs pyarrow. The error is the last line that Python prints.

    HIDING is a piece of program that hides such libraries.
    """
    result = python("-c", f"{HIDING}\nimport mcp_asdf_tools as m\n{call}\n")
    *_traceback, last_line = result.stderr.splitlines()

    assert "UsageError: " in last_line
    assert last_line.endswith(install_instruction("study"))


SLOW_LIBRARIES = ["can", "cffi", "matplotlib", "mpmath", "numpy", "pyarrow", "rich", "scipy"]
"""Slow libraries: each one takes longer to import than everything that a help text needs."""


def libraries_loaded_by(lines: Iterable[str]) -> dict[str, list[str]]:
    """Run commands one by one in a new Python; return the slow libraries loaded after each, sorted."""
    script = (
        "import sys; from mcp_asdf_tools.cli.main import main\n"
        f"for line in {[*lines]}:\n"
        "    main(line.split())\n"
        f"    print('LOADED', *[name for name in {SLOW_LIBRARIES} if name in sys.modules])\n"
    )
    output = python("-c", script).stdout.splitlines()
    lists_of_libraries = [line.removeprefix("LOADED") for line in output if line.startswith("LOADED")]
    return {line: names.split() for line, names in zip(lines, lists_of_libraries, strict=True)}


HELPS = ["--help", *(f"{name} --help" for name in cli.COMMANDS)]


@pytest.fixture(scope="module")
def loaded_libraries() -> dict[str, list[str]]:
    """Command lines, and the slow libraries that one Python has loaded when it has run them one by one."""
    return libraries_loaded_by(["tabel", *HELPS, "table --check tables/t_table_omega05_q30.c"])


@pytest.mark.parametrize("line", ["tabel", *HELPS])
def test_neither_a_help_nor_a_word_that_is_no_command_loads_a_slow_library(
    line: str, loaded_libraries: dict[str, list[str]]
) -> None:
    """No slow library such as numpy is in ``sys.modules`` after the line: "tabel", or a command and --help.

    ``loaded_libraries`` has the libraries by line.
    """
    assert loaded_libraries[line] == []


def test_the_check_of_a_table_loads_no_slow_library_but_mpmath(
    loaded_libraries: dict[str, list[str]],
) -> None:
    """``mcp-asdf table --check`` calculates thresholds again with mpmath, which has any number of digits."""
    assert loaded_libraries["table --check tables/t_table_omega05_q30.c"] == ["mpmath"]


@pytest.mark.slow
def test_a_swarm_loads_neither_matplotlib_nor_pyarrow_nor_scipy() -> None:
    """Of the libraries that take long to load it loads only these four: can, mpmath, numpy and rich."""
    line = "swarm --steps 1 --quiet"
    libraries_by_line = libraries_loaded_by([line])
    assert libraries_by_line[line] == ["can", "mpmath", "numpy", "rich"]


def is_accepted(command: str, options: list[str]) -> bool:
    """Return whether a command's parser accepts options; a parser that refuses ends the program."""
    try:
        cli._parser_for(command, cli._load(command)).parse_all(options)
    except SystemExit:
        return False
    return True


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_the_examples_below_a_help_are_accepted_by_their_commands(name: str) -> None:
    """An example of ``name`` may call another command. At least one of them calls the command itself."""
    examples = examples_of(name)
    for example in examples:
        assert is_accepted(example.command, example.options), example
    assert name in [example.command for example in examples]


@pytest.fixture
def folder_with_readings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in a folder with readings.csv, which an example reads: 20 over each colour of tiles."""
    monkeypatch.chdir(tmp_path)
    lines = [f"{200 + 7 * number},black\n{400 + 13 * number},white\n" for number in range(1, 21)]
    Path("readings.csv").write_text("".join(lines))


@pytest.mark.usefixtures("folder_with_readings")
@pytest.mark.parametrize(
    "name", [*sorted(cli.COMMANDS.keys() - {"node", "radio", "crosscheck"}), *slow(["crosscheck"])]
)
def test_examples_below_a_help_print_the_lines_that_the_help_shows_below_them(
    name: str, capsys: Capture
) -> None:
    """The examples of the command ``name`` are run, up to the last one whose output is shown.

    Earlier ones may make files that it reads. Those of node and radio would need a second program.
    """
    examples = examples_of(name)
    while examples and not examples[-1].shown_lines:
        examples.pop()
    for example in examples:
        assert cli.main([example.command, *example.options]) == 0
        printed_lines = [line.strip() for line in capsys.readouterr().out.splitlines()]
        for shown_line in example.shown_lines:
            assert shown_line in printed_lines, example


class Example(NamedTuple):
    """An example below a help: the name of a command, its options, and the lines shown of its output."""

    command: str
    options: list[str]
    shown_lines: list[str]


def examples_of(name: str) -> list[Example]:
    """Return the examples below a command's help; what one prints stands further to the right below it.

    Comments are left out.
    """
    matches = re.findall(r"^  mcp-asdf (.*)\n((?:      .*\n)*)", cli._load(name).EPILOG, re.MULTILINE)
    examples = []
    for line, output in matches:
        command, *options = shlex.split(line, comments=True)
        shown_lines = [shown_line.strip() for shown_line in output.splitlines()]
        examples.append(Example(command, options, shown_lines))
    return examples


SHORT = "--robots 4 --steps 30 --filter-period 10"
EXPERIMENT = "robots = 3\nsteps = 20\nfilter_period = 10\ntrials = 2\n"
SHORT_RADIO = "radio --id 3 --interface virtual --robots 3 --steps 2 --steps-per-second 500"


LINES_AND_OPTIONS_IN_FRONT = [
    (f"swarm {SHORT} --flawed 50% --fault 'loss=0.5,robots=0+2' --fault liar,robots=3,x=1", "--seed=1"),
    (f"swarm {SHORT} --seed=7 --true-accuracy=0.30000000000000004 --latency=1 --compare", ""),
    (f"{SHORT_RADIO} --fault loss=0.3", "--seed=1"),
    (f"simulate {SHORT} --trials 2 --drift linear --drift-rate=-1e-5", "--seed=1"),
    ("simulate --output results.parquet one.toml --seed 3", ""),
    ("sweep grid.toml --workers 1 --output 'two words.parquet'", "--seed=1"),
    ("table --output tables --omega 0.10 --neighbours 3", ""),
    ("table --output tables", "--omega=0.05 --neighbours=127"),
    (f"{SHORT_RADIO} --seed=1", ""),
    ("sweep --seed=1 grid.toml --workers 1", ""),
    ("sweep seeds.toml --workers 1", ""),  # --seed would replace both seeds of the file
]
"""Command lines, and the options that a command adds to one when it prints the line to run again."""


@pytest.fixture
def experiment_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in a folder with one.toml, which has one experiment; grid.toml and seeds.toml have two each."""
    monkeypatch.chdir(tmp_path)
    Path("one.toml").write_text(EXPERIMENT)
    Path("grid.toml").write_text(f'{EXPERIMENT}[[grid]]\nfilter = ["none", "asdf-plus"]\n')
    Path("seeds.toml").write_text(f"{EXPERIMENT}seed = [1, 2]\n")


@pytest.mark.usefixtures("experiment_files")
@pytest.mark.parametrize(("line", "options_in_front"), LINES_AND_OPTIONS_IN_FRONT)
def test_a_command_prints_the_line_that_gives_the_same_results_again(
    line: str, options_in_front: str, capsys: Capture
) -> None:
    """The printed line is the typed line, with options in front for chosen defaults, such as ``--seed=1``.

    It stands behind "again: ".
    """
    command, *options = shlex.split(line)
    assert cli.main([command, *options]) == 0
    output_lines = capsys.readouterr().out.splitlines()
    [line_to_run_again] = [output_line for output_line in output_lines if output_line.startswith("again: ")]

    line_with_options_in_front = shlex.join([command, *options_in_front.split(), *options])
    assert line_to_run_again == f"again: mcp-asdf {line_with_options_in_front}"


@pytest.mark.usefixtures("experiment_files")
@pytest.mark.parametrize("line", [SHORT_RADIO, "sweep grid.toml --workers 1", "table --output tables"])
def test_a_command_with_the_option_json_prints_json_and_nothing_else(line: str, capsys: Capture) -> None:
    """``radio``, ``sweep`` and ``table`` are tried. Otherwise a script could not read their output."""
    assert cli.main([*shlex.split(line), "--json"]) == 0

    report = json.loads(capsys.readouterr().out)  # fails if anything else is printed
    assert isinstance(report, dict)


def messages_of(err: str) -> list[str]:
    """Return the lines that are logged on standard error, without their times.

    Such a line begins with date and time: ``2026-03-01 12:00:00,000 INFO ...``.
    """
    logged_lines = [line for line in err.splitlines() if line.startswith("20")]
    return [line.split(maxsplit=2)[2] for line in logged_lines]


def run_swarm_and_return_log(*options: str, capsys: Capture) -> list[str]:
    """Run a swarm of three robots for five steps with further options, and return what it logs."""
    command = "swarm --robots 3 --steps 5 --filter-period 1 --quiet"
    assert cli.main([*command.split(), *options]) == 0
    return messages_of(capsys.readouterr().err)


def test_a_system_that_cannot_say_which_processors_a_process_may_use_runs_a_worker_on_each(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    """Such a system is macOS. Here it has three processors."""
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: 3)
    assert "(default 3: one per processor)" in " ".join(help_of("sweep", capsys).split())


def test_a_command_logs_nothing_without_the_option_v(capsys: Capture) -> None:
    """The first swarm logs. The second one must not go on with that, although it is in the same process.

    It opens a port for other programs (``--slcan``), which it would log with ``-v``.
    """
    assert run_swarm_and_return_log("-v", capsys=capsys) != []
    assert run_swarm_and_return_log("--slcan", "0", capsys=capsys) == []


def test_v_logs_versions_first_then_the_command_line_and_at_last_the_exit_code(capsys: Capture) -> None:
    """The last message is "INFO mcp_asdf_tools.cli: exit code 0 after 0.1 s", for example."""
    first_message, second_message, *_, last_message = run_swarm_and_return_log("-v", capsys=capsys)
    assert first_message.startswith("INFO mcp_asdf_tools.cli: mcp-asdf "), "and its version"
    assert second_message.startswith("INFO mcp_asdf_tools.cli: command line: mcp-asdf swarm --robots 3")
    assert last_message.startswith("INFO mcp_asdf_tools.cli: exit code 0 after ")


def test_v_logs_the_buses_that_a_swarm_opens_its_robots_and_the_files_that_it_writes(
    tmp_path: Path, capsys: Capture
) -> None:
    """Three robots have a bus each, called v0 to v2. No robot is in another process or on a device.

    A swarm with a log writes a summary of its results in JSON as well.
    """
    log = tmp_path / "run.log"
    messages = run_swarm_and_return_log("--channel", "v{robot}", "--log", str(log), "-v", capsys=capsys)

    for channel in ("v0", "v1", "v2"):
        assert f"INFO mcp_asdf_tools.bus.interfaces: opened the bus virtual {channel}" in messages
    assert "INFO mcp_asdf_tools.cli.swarm: 3 robots are up, 0 of them elsewhere" in messages
    assert f"INFO mcp_asdf_tools.common.files: wrote {log}.json" in messages


def test_vv_also_logs_the_values_of_all_options(capsys: Capture) -> None:
    """The helper starts the swarm with ``--filter-period 1``, which is one of them."""
    messages = run_swarm_and_return_log("-vv", capsys=capsys)
    [options] = [message for message in messages if " options: " in message]
    assert "'filter_period': 1," in options


@pytest.mark.usefixtures("experiment_files")
def test_vv_logs_each_batch_of_trials_that_a_sweep_has_finished(capsys: Capture) -> None:
    """grid.toml has two experiments of two trials each, and each experiment is run in one batch."""
    assert cli.main(["sweep", "grid.toml", "--workers", "1", "-vv"]) == 0
    messages = messages_of(capsys.readouterr().err)
    start, first_batch, second_batch = [message for message in messages if "experiments.sweep: " in message]

    assert start.endswith("4 trials to run on this process")
    assert "finished trials 0 to 1 of Experiment(robots=3, " in first_batch
    assert "finished trials 0 to 1 of Experiment(robots=3, " in second_batch


def test_vv_also_logs_what_python_can_says_of_a_bus_that_cannot_be_opened(capsys: Capture) -> None:
    """python-can logs the channel and settings that the driver gets. The channel nowhere0 does not exist."""
    options = ["--interface", "socketcan", "--channel", "nowhere0"]
    assert cli.main(["swarm", *options, "-vv"]) == 2
    messages = messages_of(capsys.readouterr().err)

    [settings_of_the_bus] = [message for message in messages if message.startswith("DEBUG can: ")]
    assert "'channel': 'nowhere0'" in settings_of_the_bus


def test_vv_logs_where_an_error_was_raised(capsys: Capture) -> None:
    """An omega of 3 is wrong. A traceback is logged, and the message for the user remains at the end."""
    assert cli.main(["table", "--output", "tables", "--omega", "3", "-vv"]) == 2
    err = capsys.readouterr().err
    assert "ended by UsageError\nTraceback (most recent call last):" in err
    assert err.endswith("\nSee 'mcp-asdf table --help'.\n")


def test_a_result_in_json_has_no_logged_lines_in_it(capsys: Capture) -> None:
    """Logged lines go to standard error, and the result to standard output."""
    assert cli.main(["table", "--check", "tables/t_table_omega05_q30.c", "-v", "--json"]) == 0
    out, err = capsys.readouterr()

    assert json.loads(out)["ok"] is True
    assert messages_of(err) != []


def test_a_program_that_uses_the_library_gets_no_output_of_it(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    """Python shows warnings of programs that configure no logging, so the library logs nothing as severe.

    It logs, for example, that it wrote a file of results.
    """
    with caplog.at_level(logging.DEBUG, "mcp_asdf_tools"):
        emulate(SwarmSettings(robots=3, steps=5, filter_period=1))
        simulate(Experiment(robots=3, steps=5, trials=1), tmp_path / "results.parquet")

    out, err = capfd.readouterr()
    assert out == ""
    assert err == ""
    assert any(record.message.startswith("wrote ") for record in caplog.records)
    for record in caplog.records:
        assert record.levelno < logging.WARNING
