"""Everything the README and the docs show works: commands run, programs compile, links lead somewhere."""

from __future__ import annotations

import html
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from mcp_asdf_tools.cli import main as cli
from support import PAGES, ROOT, blocks, require, run

LINK = re.compile(r"\]\((?!https?:)([^)#\s]+)")

SHOWN = (
    "FAILED at call",
    "FAILED: 21 of 37",
    "(0.000000) vcan0",
    "PASS scenarios",
    "call 0 status",
    "tick  50: share of black",
)
"""How the blocks of text begin that a program prints; every other line of text is a command."""

RUN_ELSEWHERE = {
    "development.md": "tests/test_setup.py",
    "extending.md": "tests/host_tools/test_extending.py",
    "firmware_in_the_loop.md": "tests/targets/test_firmware_in_the_loop.py",
    "porting.md": "tests/c_ref/test_porting.py",
    "robot_tutorial.md": "tests/test_tutorials.py",
}
"""Pages whose commands another test runs."""

NOT_RUN = {
    "^make ": "sets up or tests everything",
    r"can0\b|modprobe": "wants a CAN interface or root; tests/socketcan has both in a guest",
    "udp_multicast": "wants two terminals; test_remote_robot.py and test_verification.py in tests/host_tools",
    "golden_vectors": "writes the project's own files; tests/targets/test_targets.py",
    "can_logconvert|tshark": "tests/host_tools/recording/test_recording.py",
    r"--slcan|:2000\d": "waits for a program; tests/host_tools/bus/test_yakut.py and tests/targets have some",
    r"mcp-asdf view \S+$|--view$": "ends with Ctrl-C; tests/host_tools/view/test_browser.py",
    "reproduce(?!.*--quick)": "takes minutes",
    r"(study|explore)\.(toml|parquet)": "takes minutes",
    r"peers\.toml": "tests/host_tools/reproduction/test_robust.py",
    r"(advice|knobs)\.(toml|parquet)": "takes a minute; tests/host_tools/test_advice.py sweeps the same",
    "^dask|tcp://head": "wants several machines; tests/host_tools/experiments/test_sweep_cluster.py",
}
"""Commands that no test runs as they stand, by a part of them, and why."""

LONG_PAGES = (
    "crosscheck.md",
    "experiments.md",
    "reproduce.md",
    "socketcan.md",
    "swarm.md",
    "targets.md",
    "threats.md",
    "view.md",
)
"""Pages whose commands are for ``make verify``: they are many, or take long."""

NEEDED = {
    "cortex-a8.cmake": ("arm-linux-gnueabihf-gcc", "gcc-arm-linux-gnueabihf libc6-dev-armhf-cross"),
    "--preset cortex-m3": ("arm-none-eabi-gcc", "gcc-arm-none-eabi"),
    "ctest": ("qemu-system-arm", "qemu-system-arm"),
}
"""Programs and packages that commands need besides Python and a C compiler, by a part of the command."""


def commands_in(block: str) -> list[str]:
    """The lines of a block, comments cut, continued lines joined."""
    joined = re.sub(r"\\\n\s*", "", block)
    stripped = (re.sub(r"\s+#.*$", "", line).strip() for line in joined.splitlines())
    return [line for line in stripped if line and not line.startswith("#")]


def scripts(page: Path) -> list[list[str]]:
    """The page's blocks of commands."""
    shown = [block for block in blocks(page, "sh", "console", "text") if not block.startswith(SHOWN)]
    return [commands_in(block) for block in shown]


def all_commands(page: Path) -> list[str]:
    return [command for script in scripts(page) for command in script]


def is_run(page: Path, command: str) -> bool:
    """True for commands of the page's own test."""
    return page.name not in RUN_ELSEWHERE and not any(re.search(part, command) for part in NOT_RUN)


@pytest.fixture(scope="module")
def workplace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the commands expect to find in the project's own."""
    folder = tmp_path_factory.mktemp("docs")
    for name in ("tables", "c_ref", "tests/targets"):
        shutil.copytree(ROOT / name, folder / name)
    return folder


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, id=page.name, marks=[pytest.mark.slow] if page.name in LONG_PAGES else [])
        for page in PAGES
    ],
)
def test_commands_of_the_page_work(page: Path, workplace: Path) -> None:
    """Each block of commands runs in a shell of its own."""
    for script in scripts(page):
        lines = [command for command in script if is_run(page, command)]
        for tool, packages in NEEDED.items():
            if any(tool in line for line in lines):
                require(*packages)
        run("sh", "-exc", "\n".join(lines), cwd=workplace, MPLBACKEND="Agg")


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


def test_the_c_node_understands_the_commands(tmp_path: Path) -> None:
    """Each gets as far as the interface, the sensor or the file, which are not there by that name."""
    run(require("cmake"), "-S", ROOT / "c_ref/ports/linux", "-B", tmp_path)
    run("cmake", "--build", tmp_path)
    shown = [command for page in PAGES for command in all_commands(page)]
    for command in [each for each in shown if re.search("(^|[|] )mcp_asdf_node ", each)]:
        words = re.sub(r"v?can0", "none0", command.split("| ")[-1]).replace("/sys/", "/none/").split()
        done = subprocess.run(
            [tmp_path / words[0], *words[1:]],
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


def test_the_documentation_is_built(tmp_path: Path) -> None:
    """Every name that the page of the Python API asks for is there, and links and anchors lead somewhere."""
    *_, command = run(require("make", "make"), "-n", "--no-print-directory", "docs").splitlines()
    words = shlex.split(command)
    assert "--strict" in words
    assert "--quiet" not in words, "then mkdocs does not count warnings, and nothing is strict"
    run(require(Path(words[0]).name), *words[1:], "--site-dir", tmp_path)
    commands, headers, method = (
        html.unescape(re.sub(r"<[^>]+>", "", (tmp_path / page / "index.html").read_text(encoding="utf-8")))
        for page in ("cli", "headers", "method")
    )
    assert all(f"mcp-asdf {name}" in commands for name in cli.COMMANDS)
    assert "mcp_asdf_settle(mcp_asdf_t *robot)" in headers
    assert "$" not in method, "formulas are MathML"
    assert (tmp_path / "run.html").stat().st_size > 100_000


def test_links_of_the_readme_lead_somewhere() -> None:
    """Those of the pages, and their anchors, are checked where the documentation is built."""
    for name in LINK.findall((ROOT / "README.md").read_text(encoding="utf-8")):
        assert (ROOT / name).exists(), name


@pytest.mark.parametrize("source", ["copied", "written"])
def test_the_c_program_of_the_readme_runs(source: str, tmp_path: Path) -> None:
    """With the core and a table copied by hand, and as the command of the README writes them."""
    (code,) = blocks(ROOT / "README.md", "c")
    (tmp_path / "cli.c").write_text(code)
    core, tables = ROOT / "c_ref/src", ROOT / "tables"
    if source == "written":
        text = (ROOT / "README.md").read_text(encoding="utf-8")
        (arguments,) = re.findall(r"`mcp-asdf (firmware [^`]*)`", text)
        run("mcp-asdf", *arguments.split(), cwd=tmp_path)
        core = tables = tmp_path / arguments.split()[1]
    sources = [tmp_path / "cli.c", core / "mcp_asdf.c", tables / "t_table_omega05_q30.c"]
    compiler = shutil.which("cc") or "gcc"
    flags = ["-std=c99", "-pedantic-errors", "-Wall", "-Wextra", "-Werror", "-I", str(core)]
    subprocess.run([compiler, *flags, *map(str, sources), "-o", str(tmp_path / "robot")], check=True)
    shown = subprocess.run([tmp_path / "robot"], capture_output=True, text=True, check=True).stdout
    assert shown == "fill ratio 0.685\n"  # (2/3 + 0.95 - 1) / (2 0.95 - 1) = 0.6852


@pytest.mark.parametrize("page", PAGES[1:], ids=lambda page: page.name)
def test_python_programs_of_the_page_run(page: Path, tmp_path: Path) -> None:
    """One after the other in one process, which loads libraries once, but each in a module of its own."""
    programs = blocks(page, "python")
    script = f'for code in {programs!r}: exec(compile(code, "example", "exec"), {{"__name__": "__main__"}})'
    if programs:
        run(sys.executable, "-c", script, cwd=tmp_path)


def test_the_python_program_of_the_readme_runs() -> None:
    (code,) = blocks(ROOT / "README.md", "python")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    names, values = zip(
        *((line.split()[0], line.split()[1:]) for line in done.stdout.splitlines()), strict=True
    )
    assert names == ("NativeRobot", "MirrorRobot", "ReferenceRobot")
    assert values[0] == values[1]
    assert [float(v) for v in values[0]] == pytest.approx([float(v) for v in values[2]], abs=2e-6)
