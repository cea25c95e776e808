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
from typing import TYPE_CHECKING

import pytest

from browser import new_page, until
from mcp_asdf_tools.cli import main as cli
from support import PAGES, ROOT, TABLE, block_with, blocks, require, run, version_of_header
from targets.c_node import SANITIZED_BUILD, node_command

if TYPE_CHECKING:
    from playwright.sync_api import Browser

COMMANDS_AND_OUTPUT = re.compile(r"^```sh\n(.*?)^```\n\n```text\n(.*?)^```$", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\]\((?!https?:)([^)#\s]+)")

SHOWN = (
    "FAILED at call",
    "FAILED: 0 of 45",
    "calls made and compared",
    "1 0.000000000",
    '{"3000":',
    "PASS scenarios",
    "call 0 status",
    "tick 1000: robot 2",
    "6 flawed, none:",
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
    r"robot\.c|\./robot": "test_the_c_program_of_the_readme_runs",
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

LONG_PAGES = (
    "crosscheck.md",
    "can_tools.md",
    "api.md",
    "elsewhere.md",
    "linux.md",
    "radio.md",
    "small_messages.md",
    "swarm.md",
    "targets.md",
    "threats.md",
    "view.md",
)
"""Pages whose commands are for ``make verify``: they are many, or take long."""
CASES = [
    pytest.param(page, id=page.name, marks=[pytest.mark.slow] if page.name in LONG_PAGES else [])
    for page in PAGES
]

PAGES_WITH_CHECKED_OUTPUT = (
    "can_tools.md",
    "elsewhere.md",
    "linux.md",
    "radio.md",
    "swarm.md",
    "threats.md",
    "view.md",
)
"""Pages that show what their commands print."""

NEEDED = {
    "aarch64-linux-gnu": ("aarch64-linux-gnu-gcc", "gcc-aarch64-linux-gnu libc6-dev-arm64-cross"),
    "rustc": ("rustc", "rustc"),
    "bindgen": ("bindgen", "bindgen"),
    "--preset cortex-m3": ("arm-none-eabi-gcc", "gcc-arm-none-eabi"),
    "ctest": ("qemu-system-arm", "qemu-system-arm"),
}
"""Programs and packages that commands need besides Python and a C compiler, by a part of the command."""


def outputs_of(page: Path) -> dict[str, str]:
    """The blocks of text that directly follow blocks of commands, by the latter: what these print."""
    return dict(COMMANDS_AND_OUTPUT.findall(page.read_text(encoding="utf-8")))


def commands_in(block: str) -> list[str]:
    """The lines of a block, comments cut, continued lines joined."""
    joined = re.sub(r"\\\n\s*", "", block)
    stripped = (re.sub(r"\s+#.*$", "", line).strip() for line in joined.splitlines())
    return [line for line in stripped if line and not line.startswith("#")]


def scripts(page: Path) -> list[list[str]]:
    """The page's blocks of commands."""
    outputs = outputs_of(page).values()
    shown = [
        block
        for block in blocks(page, "sh", "console", "text")
        if block not in outputs and not block.startswith(SHOWN)
    ]
    return [commands_in(block) for block in shown]


def all_commands(page: Path) -> list[str]:
    return [command for script in scripts(page) for command in script]


def is_run(page: Path, command: str) -> bool:
    """True for commands of the page's own test."""
    return page.name not in RUN_ELSEWHERE and not any(re.search(part, command) for part in NOT_RUN)


def test_every_page_is_in_the_navigation_or_in_a_folder_of_further_pages() -> None:
    navigation = (ROOT / ".ci/mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:\n")[2]
    names = re.findall(r"[\w/]+\.md$", navigation, re.MULTILINE)
    assert sorted(names) == sorted(page.name for page in PAGES[1:] if page.parent == ROOT / "docs")


def test_the_pages_have_commands_and_programs() -> None:
    """A test of each of them is no test where none is found."""
    commands = [(page, command) for page in PAGES for command in all_commands(page)]
    commands_that_are_run = [
        command
        for page, command in commands
        if is_run(page, command) or RUN_ELSEWHERE.get(page.name) == "tests/test_experiment_pages.py"
    ]
    programs = [code for page in PAGES for code in blocks(page, "python")]
    assert len(commands) >= 130 and len(commands_that_are_run) >= 45 and len(programs) >= 12


@pytest.fixture(scope="module")
def workplace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the commands expect to find in the project's own."""
    folder = tmp_path_factory.mktemp("docs")
    for name in ("tables", "c_ref", "tests/targets"):
        shutil.copytree(ROOT / name, folder / name)
    return folder


@pytest.mark.parametrize("page", CASES)
def test_commands_of_the_page_work(page: Path, workplace: Path) -> None:
    """Each block of commands runs in a shell of its own, and prints the lines that the page shows."""
    for script in scripts(page):
        lines = [command for command in script if is_run(page, command)]
        for tool, packages in NEEDED.items():
            if any(tool in line for line in lines):
                require(*packages)
        printed = run("sh", "-exc", "\n".join(lines), cwd=workplace, MPLBACKEND="Agg")
        if page.name in PAGES_WITH_CHECKED_OUTPUT and lines == script:
            shown = next((text for code, text in outputs_of(page).items() if commands_in(code) == script), "")
            pattern = re.escape(shown).replace(re.escape("..."), ".*?")  # dots stand for what is left out
            assert re.search(pattern, re.sub(" +$", "", printed, flags=re.MULTILINE), re.DOTALL)


@pytest.mark.parametrize(
    "command",
    sorted(
        {
            command
            for page in PAGES
            for command in all_commands(page)
            if command.startswith("mcp-asdf ")
            and not is_run(page, command)
            and page.name not in RUN_ELSEWHERE
        }
    ),
)
def test_what_is_not_run_is_parsed(command: str) -> None:
    _, name, *words = shlex.split(command)
    cli._parser_for(name, cli._load(name)).parse_args(words)


def test_the_c_node_understands_the_commands(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Each gets as far as the interface, the sensor or the file, which are not there by that name."""
    node = node_command(SANITIZED_BUILD, tmp_path_factory)
    shown = [command for page in PAGES for command in all_commands(page)]
    for command in [each for each in shown if re.search("(^|[|] )mcp_asdf_node ", each)]:
        words = re.sub(r"v?can0", "none0", command.split("| ")[-1]).replace("/sys/", "/none/").split()
        assert words[0] == "mcp_asdf_node"
        done = subprocess.run(
            [*node, *words[1:]],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 2
        assert re.match(
            r"mcp_asdf_node: (there is no CAN interface none0|cannot open (/none/|\w+\.txt))", done.stderr
        )


@pytest.mark.parametrize(
    "command", sorted({c for page in PAGES for c in all_commands(page) if c.startswith("make ")})
)
def test_make_knows_the_target(command: str) -> None:
    run(require("make", "make"), "-n", *command.split()[1:])


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


@pytest.mark.slow
def test_the_documentation_is_built(site: Path) -> None:
    """Every name that the pages of the Python API ask for is there, and links and anchors lead somewhere."""
    texts = {path.stem: path.read_text(encoding="utf-8") for path in sorted(site.rglob("*.html"))}
    commands, headers, method = (
        html.unescape(re.sub(r"<[^>]+>", "", texts[page])) for page in ("cli", "headers", "method")
    )
    assert all(f"mcp-asdf {name}" in commands for name in cli.COMMANDS)
    assert "mcp_asdf_settle(mcp_asdf_t *robot)" in headers
    assert "$" not in method, "formulas are MathML"
    assert "radiolinkSendP2PPacketBroadcast" in texts["elsewhere"], "the page shows the files that it names"
    assert (site / "play.html").stat().st_size > 100_000
    assert "mcp_asdf_tools.world.settings.WorldSettings" in texts["world"]
    advice = texts["advice"]
    assert f"mcp-asdf {version_of_header()}</title>" in advice
    assert "md-footer__link--prev" in advice and "md-footer__link--next" in advice
    for name, text in texts.items():
        assert not re.search(r'<script[^>]*src="https?:', text), f"{name} loads something from elsewhere"
        assert not re.search("flowchart|sequenceDiagram|<pre class=.mermaid", text), name


@pytest.mark.slow
def test_no_page_is_wider_than_a_phone(site: Path, chromium: Browser) -> None:
    """Each row of a table stands by itself there, and each cell names its column."""
    with new_page(chromium, width=390) as browser:
        for path in sorted(set(site.rglob("*.html")) - {site / "play.html", site / "404.html"}):
            browser.goto(path.as_uri(), wait_until="domcontentloaded")
            wide = browser.evaluate(
                "[document.documentElement, ...document.querySelectorAll('.md-typeset table:not([class]), "
                ".md-typeset table:not([class]) td')].map((each) => each.scrollWidth).filter((w) => w > 390)"
            )
            assert wide == [], path.stem
        browser.goto((site / "advice.html").as_uri())
        label = "getComputedStyle(document.querySelectorAll('td')[1], '::before').content"
        assert "if yes" in browser.evaluate(label)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("page", "words", "found"), [("index", "liars", "threats"), ("api/world", "figure", "reproduce")]
)
def test_the_search_works_in_files_and_ranks_guides_first(
    page: str, words: str, found: str, site: Path, chromium: Browser
) -> None:
    links = "[...document.querySelectorAll('.md-search-result__link')].map((link) => link.href)"
    with new_page(chromium) as browser:
        browser.goto((site / f"{page}.html").as_uri())
        browser.locator(".md-search__input").fill(words[:-1])
        browser.locator(".md-search__input").press_sequentially(words[-1])
        until(browser, f"{links}.some((address) => address.includes('/{found}.html'))")
        assert not any("/api/" in address for address in browser.evaluate(links)[:3])


def test_links_of_the_readme_lead_somewhere() -> None:
    """Those of the pages, and their anchors, are checked where the documentation is built."""
    for name in LINK.findall((ROOT / "README.md").read_text(encoding="utf-8")):
        assert (ROOT / name).exists(), name


@pytest.mark.parametrize("source", ["copied", "written"])
def test_the_c_program_of_the_readme_runs(source: str, tmp_path: Path) -> None:
    """In an empty folder, by the commands that the README prints, and with files copied by hand."""
    readme, flags = ROOT / "README.md", "-pedantic-errors -Wall -Wextra -Werror"
    (code,) = blocks(readme, "c")
    (tmp_path / "robot.c").write_text(code)
    write, build, start = block_with(readme, "robot.c", "sh").splitlines()
    if source == "copied":
        shutil.copytree(ROOT / "c_ref/src", tmp_path / "vendor/mcp_asdf")
        shutil.copy(TABLE, tmp_path / "vendor/mcp_asdf")
        write, build = ":", build.replace("-std=c99", f"-std=c99 {flags}")
    printed = run("sh", "-ec", f"{write} >/dev/null\n{build}\n{start}", cwd=tmp_path)
    assert printed == block_with(readme, "share of black 0.685", "text")
    x = (2 / 3 + 0.95 - 1) / (2 * 0.95 - 1)
    assert f"{x:.3f}" in printed


@pytest.mark.parametrize("page", CASES[1:])
def test_python_programs_of_the_page_run(page: Path, tmp_path: Path) -> None:
    """One after the other in one process, which loads libraries once, but each in a module of its own."""
    programs = [] if page.name in PROGRAMS_RUN_ELSEWHERE else blocks(page, "python")
    script = f'for code in {programs!r}: exec(compile(code, "example", "exec"), {{"__name__": "__main__"}})'
    if programs:
        run(sys.executable, "-c", script, cwd=tmp_path)


@pytest.mark.slow
def test_the_notebook_prints_what_it_shows(tmp_path: Path) -> None:
    """Its pictures are there, too."""
    notebook = json.loads((ROOT / "docs/notebook.ipynb").read_text(encoding="utf-8"))
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    outputs = [output for cell in cells for output in cell["outputs"]]
    shown = "".join("".join(output["text"]) for output in outputs if output["output_type"] == "stream")
    assert (
        run(sys.executable, "-c", "\n".join("".join(cell["source"]) for cell in cells), cwd=tmp_path) == shown
    )
    assert any("image/png" in output.get("data", {}) for output in outputs)


def test_the_example_of_the_python_api_prints_what_it_shows() -> None:
    page = ROOT / "docs/api.md"
    code = block_with(page, "NativeRobot", "python")
    assert run(sys.executable, "-c", code) == block_with(page, "tick 1000", "text")


def test_the_readme_and_the_advice_say_how_much_it_helps_as_the_page_does() -> None:
    """The page's figures are those of its program; the others round them no further."""
    experiments = ROOT / "docs/experiments.md"
    readme, advice, page = (
        " ".join(path.read_text(encoding="utf-8").split())
        for path in (ROOT / "README.md", ROOT / "docs/advice.md", experiments)
    )
    assert "trials=200" in page
    for text, folder in ((readme, "docs/"), (advice, "")):
        assert f"]({folder}experiments.md#how-much-it-helps)" in text
    lines = block_with(experiments, "6 flawed, none:", "text").splitlines()
    figures = [[float(number) for number in re.findall(r"\d+\.\d*", line)] for line in lines]
    none, minus, robust, _, half_minus, _ = figures
    error = "the error is {:.3f} without a filter, {:.3f} with ASDF-, and {:.3f} with the robust filter"
    assert error.format(none[1], minus[1], robust[1]) in readme
    assert f"it makes the error at the end {half_minus[4]} times smaller" in advice
    (harmed,) = re.findall(r"larger in (\d+)%", lines[-1])
    assert f"of 200 worlds like it, the error is larger than without a filter in {harmed} %" in readme
    assert f"The robust filter makes it larger in [{harmed} % of these worlds]" in advice


def test_all_state_the_same_time_for_the_tests() -> None:
    """The README, the guide for contributors and the help of make."""
    texts = (
        (ROOT / name).read_text(encoding="utf-8")
        for name in ("README.md", ".github/CONTRIBUTING.md", "Makefile")
    )
    assert [re.findall(r"(\d+) minutes once set up", text) for text in texts] == [["2"]] * 3
