"""Everything the README and the docs show works: commands run, programs compile, links lead somewhere."""

from __future__ import annotations

import html
import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from browser import new_page, until
from mcp_asdf_tools.cli import main as cli
from support import PAGES, ROOT, block_with, blocks, require, run, version_of_header
from targets.c_node import SANITIZED_BUILD, node_command

if TYPE_CHECKING:
    from playwright.sync_api import Browser

COMMANDS_AND_OUTPUT = re.compile(r"^```sh\n(.*?)^```\n\n```text\n(.*?)^```$", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\]\((?!https?:)([^)#\s]+)")

SHOWN = (
    *("FAILED at call", "FAILED: 0 of 45", "calls made and compared", "1 0.000000000", '{"3000":'),
    *("PASS scenarios", "call 0 status", "tick 1000: robot 2", "6 flawed, none:"),
)
"""How the blocks of text begin that a program prints; every other line of text is a command."""

RUN_ELSEWHERE = {
    "data_frames.md": "tests/test_data_frames.py",
    "experiment_tutorial.md": "tests/test_experiment_pages.py",
    "experiments.md": "tests/test_experiment_pages.py",
    "extending.md": "tests/host_tools/test_extending.py",
    "installing.md": "tests/test_newcomer.py",
    "khepera.md": "tests/targets/test_khepera.py",
    "porting.md": "tests/c_ref/test_porting.py",
    "reproduce.md": "tests/test_experiment_pages.py",
    "robot_tutorial.md": "tests/test_tutorials.py",
}
"""Pages whose commands another test runs."""

PROGRAMS_RUN_ELSEWHERE = ("data_frames.md", "experiment_tutorial.md", "experiments.md")
"""Pages whose Python programs are run by the test of their commands."""

NOT_RUN = {
    "^make ": "sets up or tests everything",
    r"can0\b|modprobe": "wants a CAN interface or root; tests/socketcan has both in a guest",
    r"^mcp_asdf_node --interface udp": "wants a robot; tests/targets/test_multicast.py",
    "build/loop": "wants an emulated board; tests/targets/test_firmware_in_the_loop.py",
    "udp_multicast": "wants two terminals; test_remote_robot.py and test_verification.py in tests/host_tools",
    r"robot\.c|\./robot": "the tests of the README's program below",
    "golden_vectors": "writes the project's own files; tests/targets/test_targets.py",
    "can_logconvert|tshark": "tests/host_tools/recording/test_recording.py",
    r"--slcan|:2000\d": "waits for a program; tests/host_tools/bus/test_yakut.py and tests/targets have some",
    r"mcp-asdf view \S+$|--view$": "ends with Ctrl-C; tests/host_tools/view/test_browser.py",
    "reproduce(?!.*--quick)": "takes minutes",
    r"study\.(toml|parquet)": "takes minutes",
    r"theirs\.(parquet|png)": "wants the authors' trials; tests/host_tools/cli/test_convert.py",
    r"mcp_asdf_tools\.studies": "tests/host_tools/studies/test_study_program.py",
    r"benchmarks\.pages": "tests/host_tools/studies/test_pages.py",
    r"benchmarks\.robust_judge": "tests/benchmarks/test_robust_judge.py",
    r"(advice|knobs)\.(toml|parquet)": "takes a minute; tests/host_tools/test_advice.py sweeps the same",
    r"^colcon|^ros2|^\. install/setup": "wants ROS 2; tests/c_ref/test_ros2.py runs the node over stubs",
    r"^argos3 |check_log|cmake -S \. |cmake --build build$": "wants ARGoS3; tests/c_ref/test_argos.py",
    "--latency 1 --filter asdf-minus": "tests/host_tools/experiments/test_argos_results.py runs more of it",
    "^dask|tcp://head": "wants several machines; tests/host_tools/experiments/test_sweep_cluster.py",
}
"""Commands that no test runs as they stand, by a part of them, and why."""

PAGES_WITH_CHECKED_OUTPUT = (
    *("can_tools.md", "elsewhere.md", "linux.md", "radio.md", "swarm.md", "threats.md", "view.md"),
)
"""Pages that show what their commands print."""
LONG_PAGES = (*PAGES_WITH_CHECKED_OUTPUT, "crosscheck.md", "api.md", "small_messages.md", "targets.md")
"""Pages whose commands are for ``make verify``: they are many, or take long."""
CASES = [
    pytest.param(page, id=page.name, marks=[pytest.mark.slow] if page.name in LONG_PAGES else [])
    for page in PAGES
]

NEEDED = {
    "aarch64-linux-gnu": ("aarch64-linux-gnu-gcc", "gcc-aarch64-linux-gnu libc6-dev-arm64-cross"),
    "rustc": ("rustc", "rustc"),
    "bindgen": ("bindgen", "bindgen"),
    "--preset cortex-m3": ("arm-none-eabi-gcc", "gcc-arm-none-eabi"),
    "ctest": ("qemu-system-arm", "qemu-system-arm"),
}
"""Programs and packages that commands need besides Python and a C compiler, by a part of the command."""


def outputs_of(page: Path) -> dict[str, str]:
    """Return what the page shows as output, by the block of commands that stands directly above it."""
    return dict(COMMANDS_AND_OUTPUT.findall(page.read_text(encoding="utf-8")))


def commands_in(block: str) -> list[str]:
    """Return the commands in a block: its lines without comments, and with continued lines joined."""
    commands = []
    for line in re.sub(r"\\\n\s*", "", block).splitlines():
        command = re.sub(r"(^|\s+)#.*$", "", line).strip()
        if command:
            commands.append(command)
    return commands


def scripts(page: Path) -> list[list[str]]:
    """Return the commands of each block of commands of a page."""
    outputs = outputs_of(page).values()
    return [
        commands_in(block)
        for block in blocks(page, "sh", "console", "text")
        if block not in outputs and not block.startswith(SHOWN)
    ]


def all_commands(page: Path) -> list[str]:
    return [command for script in scripts(page) for command in script]


ALL_COMMANDS = sorted({command for page in PAGES for command in all_commands(page)})


def is_run(page: Path, command: str) -> bool:
    """Return whether the test of a page's commands runs this one."""
    return page.name not in RUN_ELSEWHERE and not any(re.search(part, command) for part in NOT_RUN)


def commands_that_are_not_run() -> list[str]:
    """Return the commands of mcp-asdf on all pages that no test runs."""
    commands = set[str]()
    for page in PAGES:
        if page.name not in RUN_ELSEWHERE:
            commands |= {command for command in all_commands(page) if not is_run(page, command)}
    return sorted(command for command in commands if command.startswith("mcp-asdf "))


def test_every_page_of_the_docs_is_in_the_navigation() -> None:
    """Pages in folders are left out, as other pages lead to them, and so is the README."""
    settings = (ROOT / ".ci/mkdocs.yml").read_text(encoding="utf-8")
    _before, _nav, navigation = settings.partition("\nnav:\n")
    names_in_navigation = re.findall(r"[\w/]+\.md$", navigation, re.MULTILINE)

    pages = [page.name for page in PAGES if page.parent == ROOT / "docs"]

    assert sorted(names_in_navigation) == sorted(pages)


def test_as_many_commands_and_programs_are_found_in_the_pages_as_there_are_today() -> None:
    """Other tests run each that is found: if none were found, nothing would be tested."""
    command_count = run_count = program_count = 0
    for page in PAGES:
        commands = all_commands(page)
        command_count += len(commands)
        run_count += sum(is_run(page, command) for command in commands)
        if RUN_ELSEWHERE.get(page.name) == "tests/test_experiment_pages.py":
            run_count += len(commands)
        program_count += len(blocks(page, "python"))

    assert command_count >= 130, "commands on all pages"
    assert run_count >= 45, "here or by test_experiment_pages.py; others need a network or much time"
    assert program_count >= 12


@pytest.fixture(scope="module")
def workplace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the commands expect to find in the project's own."""
    folder = tmp_path_factory.mktemp("docs")
    for name in ("tables", "c_ref", "tests/targets"):
        shutil.copytree(ROOT / name, folder / name)
    return folder


def printed_as_shown(page: Path, script: list[str], printed: str) -> bool:
    """Return whether commands print what the page shows below them, where dots stand for anything."""
    shown_texts = [text for code, text in outputs_of(page).items() if commands_in(code) == script]
    shown = shown_texts[0] if shown_texts else ""
    pattern = re.escape(shown).replace(re.escape("..."), ".*?")
    without_trailing_spaces = re.sub(" +$", "", printed, flags=re.MULTILINE)
    return re.search(pattern, without_trailing_spaces, re.DOTALL) is not None


@pytest.mark.parametrize("page", CASES)
def test_the_commands_of_a_page_work_and_print_what_it_shows(page: Path, workplace: Path) -> None:
    """Each block of commands runs in a shell of its own. Commands that other tests run are left out.

    What is printed is compared on pages that show it, if no command of the block is left out.
    """
    for script in scripts(page):
        lines = [command for command in script if is_run(page, command)]
        for tool, packages in NEEDED.items():
            if any(tool in line for line in lines):
                require(*packages)

        printed = run("sh", "-exc", "\n".join(lines), cwd=workplace, MPLBACKEND="Agg")

        if page.name in PAGES_WITH_CHECKED_OUTPUT and lines == script:
            assert printed_as_shown(page, script, printed), printed


@pytest.mark.parametrize("command", commands_that_are_not_run())
def test_a_command_of_the_docs_that_no_test_runs_has_options_that_are_there(command: str) -> None:
    """Such a command wants a network or minutes. An unknown option would end this test by SystemExit."""
    _program, name, *options = shlex.split(command)
    # The private functions make the parser of a command's options, as the program does.
    parser = cli._parser_for(name, cli._load(name))
    parser.parse_args(options)


@pytest.mark.parametrize(
    "command", [command for command in ALL_COMMANDS if re.search("(^|[|] )mcp_asdf_node ", command)]
)
def test_the_c_node_understands_the_commands_of_the_docs(
    command: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """It takes all options, and ends as the CAN interface, the sensor or the file is not there.

    A command may be a pipe, in which the node is the last program.
    """
    with_names_that_are_not_there = re.sub(r"v?can0", "none0", command).replace("/sys/", "/none/")
    *_programs_before, command_of_node = with_names_that_are_not_there.split("| ")
    program, *options = command_of_node.split()
    assert program == "mcp_asdf_node"
    node = node_command(SANITIZED_BUILD, tmp_path_factory)

    done = subprocess.run(
        [*node, *options], stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )

    wrong_usage = 2
    assert done.returncode == wrong_usage
    assert re.match(
        r"mcp_asdf_node: (there is no CAN interface none0|cannot open (/none/|\w+\.txt))", done.stderr
    )


@pytest.mark.parametrize("command", [command for command in ALL_COMMANDS if command.startswith("make ")])
def test_make_knows_the_targets_that_the_docs_name(command: str) -> None:
    """With -n make says what it would do, and fails for a target that the Makefile does not have."""
    _make, *targets = command.split()
    run(require("make", "make"), "-n", *targets)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The documentation, built."""
    folder = tmp_path_factory.mktemp("site")
    lines = run(require("make", "make"), "-n", "--no-print-directory", "docs").splitlines()
    (command,) = (line for line in lines if "mkdocs build" in line)
    _, *words = shlex.split(command)  # without the variable before it
    assert "--strict" in words
    assert "--quiet" not in words, "then mkdocs does not count warnings, and nothing is strict"
    run(require(Path(words[0]).name), *words[1:], "--site-dir", folder)
    return folder


def text_of(page: Path) -> str:
    """Return the text of a page in HTML, without its tags."""
    return html.unescape(re.sub(r"<[^>]+>", "", page.read_text(encoding="utf-8")))


@pytest.mark.slow
def test_the_built_docs_list_every_command(site: Path) -> None:
    """The page is made from the commands' own help."""
    page = text_of(site / "cli.html")
    for name in cli.COMMANDS:
        assert f"mcp-asdf {name}" in page


@pytest.mark.slow
def test_the_built_docs_list_the_functions_of_the_c_headers(site: Path) -> None:
    """mcp_asdf_settle, which ends a round, is one of them."""
    assert "mcp_asdf_settle(mcp_asdf_t *robot)" in text_of(site / "headers.html")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("page", "included_text"),
    [
        pytest.param("elsewhere", "radiolinkSendP2PPacketBroadcast", id="a file that the page names"),
        pytest.param("world", "mcp_asdf_tools.world.settings.WorldSettings", id="the Python API"),
        pytest.param("advice", f"mcp-asdf {version_of_header()}</title>", id="the version in the title"),
    ],
)
def test_the_built_docs_have_what_comes_from_other_files(page: str, included_text: str, site: Path) -> None:
    """The page is built from Markdown, in which a plain reference stands in its place."""
    [path] = site.rglob(f"{page}.html")
    assert included_text in path.read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_built_docs_have_formulas_that_a_browser_shows(site: Path) -> None:
    """They are MathML. If a formula were not converted, its dollars would be left in the text.

    The page docs/method.md has most of them.
    """
    assert "$" not in text_of(site / "method.html")


@pytest.mark.slow
def test_the_built_docs_have_the_playground(site: Path) -> None:
    """It is a page that simulates a swarm in the browser, and has its program in it."""
    assert (site / "play.html").stat().st_size > 100_000, "bytes, with its program"


@pytest.mark.slow
def test_the_built_docs_load_nothing_from_elsewhere_and_have_no_diagram_as_text(site: Path) -> None:
    """A diagram would be left as text if its program were not loaded."""
    for path in sorted(site.rglob("*.html")):
        page = path.read_text(encoding="utf-8")
        assert not re.search(r'<script[^>]*src="https?:', page), path
        assert not re.search("flowchart|sequenceDiagram|<pre class=.mermaid", page), path


@pytest.mark.slow
def test_no_page_of_the_built_docs_is_wider_than_a_phone(site: Path, chromium: Browser) -> None:
    """What is wider in it, such as a table, is scrolled by itself. 404.html is no page of ours.

    The playground has a test of its own.
    """
    phone_width = 390
    pages = set(site.rglob("*.html")) - {site / "play.html", site / "404.html"}
    with new_page(chromium, width=phone_width) as browser:
        for path in sorted(pages):
            browser.goto(path.as_uri(), wait_until="domcontentloaded")
            assert browser.evaluate("document.documentElement.scrollWidth") <= phone_width, path.stem


@pytest.mark.slow
@pytest.mark.parametrize(
    ("page", "word", "found_page"), [("index", "liars", "threats"), ("api/world", "figure", "reproduce")]
)
def test_the_search_of_the_built_docs_works_without_a_server_and_shows_guides_first(
    page: str, word: str, found_page: str, site: Path, chromium: Browser
) -> None:
    """A reader types ``word`` on a page, and ``found_page`` has to be among the results.

    Those of the Python API, which are in the folder api, come later.
    """
    # JavaScript for the list of the addresses of the results.
    addresses = "[...document.querySelectorAll('.md-search-result__link')].map((link) => link.href)"
    with new_page(chromium) as browser:
        browser.goto((site / f"{page}.html").as_uri())
        browser.locator(".md-search__input").press_sequentially(word)
        until(browser, f"{addresses}.some((address) => address.includes('/{found_page}.html'))")

        first, second, third, *_later_results = browser.evaluate(addresses)

    for address in (first, second, third):
        assert "/api/" not in address


def test_links_of_the_readme_lead_somewhere() -> None:
    """Links of the pages, and their anchors, are checked where the documentation is built."""
    for name in LINK.findall((ROOT / "README.md").read_text(encoding="utf-8")):
        assert (ROOT / name).exists(), name


README = ROOT / "README.md"
README_OUTPUT = block_with(README, "share of black 0.685", "text")


def test_the_commands_of_the_readme_build_and_run_its_c_program_in_an_empty_folder(tmp_path: Path) -> None:
    """The three commands get the firmware, compile the program, and start it.

    The compiler treats all warnings as errors here, so that the program and the firmware have none.
    """
    [program] = blocks(README, "c")
    (tmp_path / "robot.c").write_text(program)
    get_firmware, build, start = block_with(README, "robot.c", "sh").splitlines()

    get_firmware_silently = f"{get_firmware} >/dev/null"
    strict_build = build.replace("-std=c99", "-std=c99 -pedantic-errors -Wall -Wextra -Werror")
    assert strict_build != build
    printed = run("sh", "-ec", "\n".join([get_firmware_silently, strict_build, start]), cwd=tmp_path)

    assert printed == README_OUTPUT


def test_the_readme_shows_what_its_first_command_prints_as_the_page_on_swarms_does() -> None:
    """The page compares the filters in the same swarm, and a test compares its text with what is printed."""
    [line] = block_with(README, "Mean error on the same seed", "text").splitlines()
    assert line in (ROOT / "docs/swarm.md").read_text(encoding="utf-8").splitlines()


def test_the_output_in_the_readme_is_what_the_paper_s_equation_gives() -> None:
    """n of t tiles seem black, 2 of 3, and a sensor with the accuracy b is right in 95 of 100 cases.

    Equation 3 makes the share of black tiles of these three numbers.
    """
    n, t, b = 2, 3, 0.95
    share_of_black = (n / t + b - 1) / (2 * b - 1)
    assert f"{share_of_black:.3f}" in README_OUTPUT


RUN_FILES = """
import runpy, sys
for name in sys.argv[1:]:
    runpy.run_path(name, run_name="__main__")
"""


@pytest.mark.parametrize("page", CASES[1:])
def test_the_python_programs_of_a_page_run(page: Path, tmp_path: Path) -> None:
    """They run one after the other in one process, so that libraries are loaded once.

    run() raises if one fails. Some pages are left out, whose programs other tests run.
    """
    names = []
    if page.name not in PROGRAMS_RUN_ELSEWHERE:
        for index, program in enumerate(blocks(page, "python")):
            name = f"program_{index}.py"
            (tmp_path / name).write_text(program)
            names.append(name)

    run(sys.executable, "-c", RUN_FILES, *names, cwd=tmp_path)


def code_cells_of_notebook() -> list[dict[str, Any]]:
    """Return the cells of the docs' notebook that have code, each with its outputs."""
    notebook = json.loads((ROOT / "docs/notebook.ipynb").read_text(encoding="utf-8"))
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


@pytest.mark.slow
def test_the_notebook_prints_what_it_shows(tmp_path: Path) -> None:
    """All of its cells run in one process, in their order."""
    shown, program = "", ""
    for cell in code_cells_of_notebook():
        program += "".join(cell["source"]) + "\n"
        for output in cell["outputs"]:
            if output["output_type"] == "stream":
                shown += "".join(output["text"])

    assert run(sys.executable, "-c", program, cwd=tmp_path) == shown


def test_the_notebook_has_a_picture() -> None:
    """A cell of code may have it among its outputs, in the format PNG."""
    pictures = []
    for cell in code_cells_of_notebook():
        for output in cell["outputs"]:
            if "image/png" in output.get("data", {}):
                pictures.append(output)
    assert len(pictures) > 0


def test_the_example_of_the_python_api_prints_what_it_shows() -> None:
    """It is the program of docs/api.md that makes a NativeRobot, and lets it run for 1000 ticks."""
    page = ROOT / "docs/api.md"
    code = block_with(page, "NativeRobot", "python")
    shown_output = block_with(page, "tick 1000", "text")

    assert run(sys.executable, "-c", code) == shown_output


def words_of(page: str) -> str:
    """Return a page as one line, however its own lines are broken."""
    return " ".join((ROOT / page).read_text(encoding="utf-8").split())


def figures_of_how_much_it_helps() -> list[list[float]]:
    """Return the numbers in each line of what a program of docs/experiments.md prints; a test compares that.

    The lines are about: no filter, ASDF-, the robust filter; a line more for each, with half of them flawed.
    """
    lines = block_with(ROOT / "docs/experiments.md", "6 flawed, none:", "text").splitlines()
    return [[float(number) for number in re.findall(r"\d+\.\d*", line)] for line in lines]


def test_the_readme_states_the_errors_that_a_program_of_the_docs_prints() -> None:
    """These are errors of the estimated share of black. The second figure of each line is their median.

    docs/experiments.md shows what the program prints: first lines about no filter, ASDF- and the robust one.
    """
    no_filter, asdf_minus, robust_filter, *_lines_of_more_flawed_robots = figures_of_how_much_it_helps()
    _, error_without_filter, *_ = no_filter
    _, error_with_asdf_minus, *_ = asdf_minus
    _, error_with_robust_filter, *_ = robust_filter

    sentence = (
        f"the error is {error_without_filter:.3f} without a filter, {error_with_asdf_minus:.3f} with ASDF-, "
        f"and {error_with_robust_filter:.3f} with the robust filter"
    )
    assert sentence in words_of("README.md")


def test_the_advice_states_how_many_times_smaller_the_error_is_as_a_program_of_the_docs_prints_it() -> None:
    """docs/experiments.md shows what the program prints. The last line but one is about ASDF-.

    Half of the robots are flawed there, and the fifth figure of the line is the ratio of errors.
    """
    *_, half_flawed_with_asdf_minus, _with_robust_filter = figures_of_how_much_it_helps()
    _, _, _, _, times_smaller, *_ = half_flawed_with_asdf_minus
    assert f"it makes the error at the end {times_smaller} times smaller" in words_of("docs/advice.md")


def test_the_readme_and_the_advice_state_how_often_the_robust_filter_harms() -> None:
    """The last line that a program of docs/experiments.md prints has the percentage, of 200 trials."""
    assert "trials=200" in words_of("docs/experiments.md")
    *_, last_line = block_with(ROOT / "docs/experiments.md", "6 flawed, none:", "text").splitlines()
    [harmed] = re.findall(r"larger in (\d+)%", last_line)

    in_readme = f"in {harmed} % of 200 such worlds it makes the error larger"
    assert in_readme in words_of("README.md")
    in_advice = f"The robust filter makes it larger in [{harmed} % of these worlds]"
    assert in_advice in words_of("docs/advice.md")


def test_the_readme_and_the_advice_lead_to_the_page_with_their_figures() -> None:
    """Its section "How much it helps" has the program that prints them."""
    assert "](docs/experiments.md#how-much-it-helps)" in words_of("README.md")
    assert "](experiments.md#how-much-it-helps)" in words_of("docs/advice.md")


@pytest.mark.parametrize("page", ["README.md", ".github/CONTRIBUTING.md", "Makefile"])
def test_all_state_the_same_time_for_the_tests(page: str) -> None:
    """It is what ``make test`` takes once everything is installed, and stands there once."""
    text = (ROOT / page).read_text(encoding="utf-8")
    stated_minutes = re.findall(r"(\d+) minutes once set up", text)
    assert stated_minutes == ["2"]
