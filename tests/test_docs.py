"""Everything the README and the docs show works: commands run, programs compile, links lead somewhere."""

from __future__ import annotations

import html
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Collection
from pathlib import Path

import pytest
from _pytest.mark import ParameterSet

from mcp_asdf_tools.cli import main as cli
from multicast import multicast
from support import PAGES, PATH, PATIENCE, ROOT, blocks, require, run

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
    "tests/c_ref/test_porting.py": ("porting.md", "avr-gcc"),
    "tests/host_tools/cli/test_wireshark.py": ("frame.md", "can_logconvert", "tshark"),
    "tests/host_tools/bus/test_yakut.py": ("frame.md", 'yakut -i "CAN(can.media.pythoncan'),
    "tests/targets/test_firmware_in_the_loop.py": (
        "firmware_in_the_loop.md",
        "build/loop",
        "socket://127.0.0.1:20001",
    ),
    "tests/targets/test_targets.py": (
        "targets.md",
        "PYTHONPATH=tests python -m targets.golden_vectors",
    ),
    "tests/host_tools/test_extending.py": ("extending.md", "mcp-asdf "),
    "tests/test_setup.py": ("development.md", ".venv"),
    "tests/test_tutorials.py": ("robot_tutorial.md", "my_robot", "--slcan 20001"),
}
"""Tests that run commands of a page: the page, and what is in these commands."""

HERE_WITH_MULTICAST = (
    "mcp-asdf swarm --interface udp_multicast --processes --robots 4 --steps 100",
    "mcp-asdf radio --id 3 --interface udp_multicast --verify --wait 60",
    "mcp-asdf node --id 3 --interface udp_multicast",
)
C_NODES = (
    "mcp_asdf_node --interface can0 --id 7 --sensor /sys/class/gpio/gpio48/value",
    "tile_sensor | mcp_asdf_node --interface can0 --id 7 --observations -",
    "mcp_asdf_node --interface vcan0 --id 7 --lockstep",
)
CAN0 = "--interface socketcan --channel can0"
NO_CAN = "wants a CAN interface; tests/socketcan has runs on one"
AS_ROOT = "changes the machine's network as root; tests/socketcan does it in a guest"
TAKES_LONG = "takes minutes"
SWEPT = "takes a minute; tests/host_tools/test_advice.py sweeps the same"
IN_A_BROWSER = "ends with Ctrl-C; tests/host_tools/view/test_browser.py has the page in a browser"
NEEDS_CLUSTER = (
    "wants several machines; tests/host_tools/experiments/test_sweep_cluster.py has a cluster on this one"
)
NOT_RUN = {
    f"mcp-asdf radio --id 3 --robots 11 {CAN0}": NO_CAN,
    f"mcp-asdf radio --id 3 {CAN0} --verify --wait 60 --report controller.md": NO_CAN,
    "mcp-asdf swarm --interface socketcan --channel vcan0": NO_CAN,
    "candump vcan0 | cantools decode --single-line -m 0x1FFFFF00 mcp_asdf.dbc": NO_CAN,
    "yakut -i \"CAN(can.media.socketcan.SocketCANMedia('vcan0', 8), 126)\" monitor": NO_CAN,
    "modprobe vcan": AS_ROOT,
    "ip link add dev vcan0 type vcan": AS_ROOT,
    "ip link set vcan0 up": AS_ROOT,
    "mcp-asdf swarm --slcan 20000": "ends with Ctrl-C; tests/host_tools/bus/test_yakut.py joins such a swarm",
    "can_viewer -i slcan -c socket://127.0.0.1:20000": "draws on a terminal until a key is pressed",
    "mcp-asdf swarm --channel 'bus{robot}' --device 0=slcan:socket://127.0.0.1:20001": (
        "wants a controller at that port; tests/targets/test_firmware_in_the_loop.py has one"
    ),
    "mcp-asdf view walk.parquet": IN_A_BROWSER,
    "mcp-asdf view run.log": IN_A_BROWSER,
    "mcp-asdf view --interface socketcan --channel vcan0": NO_CAN,
    "mcp-asdf swarm --topology dynamic --filter asdf-minus --flawed 50% --view": IN_A_BROWSER,
    "mcp-asdf reproduce": TAKES_LONG,
    "mcp-asdf reproduce --paper": TAKES_LONG,
    "mcp-asdf reproduce --part fully_connected --seed 7 --output other": TAKES_LONG,
    "mcp-asdf reproduce --scheduler tcp://head:8786": NEEDS_CLUSTER,
    "mcp-asdf sweep study.toml": TAKES_LONG,
    "mcp-asdf sweep advice.toml": SWEPT,
    "mcp-asdf sweep knobs.toml": SWEPT,
    "mcp-asdf score advice.parquet --csv advice.csv": SWEPT,
    "mcp-asdf plot study.parquet study.png --kind scatter": "draws what that sweep has written",
    "mcp-asdf sweep explore.toml": TAKES_LONG,
    "mcp-asdf plot explore.parquet curves.png --kind curve --x omega --hue density": (
        "draws what that sweep has written; tests/host_tools/experiments/test_plots.py draws such curves"
    ),
    "dask scheduler": NEEDS_CLUSTER,
    "dask worker tcp://head:8786": NEEDS_CLUSTER,
    "mcp-asdf sweep study.toml --scheduler tcp://head:8786": NEEDS_CLUSTER,
}
"""Commands that no test runs as they stand, and why."""

SLOW = {
    "mcp-asdf crosscheck --steps 5000 --seed 7",
    "mcp-asdf crosscheck --steps 1000 --json",
    "mcp-asdf reproduce --quick --part physical",
    "mcp-asdf sweep physical --trials 1",
}
"""Commands that are for ``make verify``."""

LONG_PAGES = {"experiments.md", "socketcan.md", "swarm.md", "targets.md", "threats.md", "view.md"}
"""Pages with so many commands that they are for ``make verify`` as a whole."""

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


def is_run_elsewhere(page: Path, command: str) -> bool:
    return any(
        page.name == name and any(part in command for part in parts)
        for name, *parts in RUN_ELSEWHERE.values()
    )


def is_run(page: Path, command: str) -> bool:
    """True for commands of the page's own test; ``make`` would set up or test everything."""
    others = (*HERE_WITH_MULTICAST, *C_NODES, *NOT_RUN)
    return not (command.startswith("make ") or command in others or is_run_elsewhere(page, command))


@pytest.fixture(scope="module")
def workplace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the commands expect to find in the project's own."""
    folder = tmp_path_factory.mktemp("docs")
    for name in ("tables", "c_ref", "tests/targets"):
        shutil.copytree(ROOT / name, folder / name)
    return folder


def page_of(page: Path) -> ParameterSet:
    """A page as a parameter; those whose commands take seconds are for ``make verify``."""
    return pytest.param(page, id=page.name, marks=[pytest.mark.slow] if page.name in LONG_PAGES else [])


@pytest.mark.parametrize("page", [page_of(page) for page in PAGES])
def test_commands_of_the_page_work(page: Path, workplace: Path) -> None:
    run_commands(page, workplace, left_out=SLOW)


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", [page for page in PAGES if SLOW & set(all_commands(page))], ids=lambda page: page.name
)
def test_slow_commands_of_the_page_work_among_the_others(page: Path, workplace: Path) -> None:
    run_commands(page, workplace)


def run_commands(page: Path, workplace: Path, left_out: Collection[str] = ()) -> None:
    """Run the page's blocks of commands, each block in a shell of its own."""
    for script in scripts(page):
        lines = [command for command in script if is_run(page, command) and command not in left_out]
        for tool, packages in NEEDED.items():
            if any(tool in line for line in lines):
                require(*packages)
        run("sh", "-exc", "\n".join(lines), cwd=workplace, MPLBACKEND="Agg")


def test_what_is_not_run_is_shown_and_the_tests_named_are_there() -> None:
    shown = {command for page in PAGES for command in all_commands(page)}
    assert {*NOT_RUN, *C_NODES, *HERE_WITH_MULTICAST, *SLOW} <= shown
    for name, (page, *parts) in RUN_ELSEWHERE.items():
        assert (ROOT / name).is_file(), name
        assert all(any(part in c for c in all_commands(ROOT / "docs" / page)) for part in parts), name
    for reason in NOT_RUN.values():
        for path in re.findall(r"tests/\S+", reason):
            assert (ROOT / path).exists(), path
    is_quick = [is_run(page, c) and c not in SLOW for page in PAGES for c in all_commands(page)]
    assert sum(is_quick) > 40


@pytest.mark.parametrize("command", [c for c in NOT_RUN if c.startswith("mcp-asdf ")])
def test_what_is_not_run_is_parsed(command: str) -> None:
    _, name, *words = shlex.split(command)
    cli._parser_for(name, cli._load(name)).parse_args(words)


def test_the_c_node_understands_the_commands(tmp_path: Path) -> None:
    """Each gets as far as the interface, the sensor or the file, which are not there by that name."""
    run(require("cmake"), "-S", ROOT / "c_ref/ports/linux", "-B", tmp_path)
    run("cmake", "--build", tmp_path)
    for command in C_NODES:
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


def test_a_swarm_of_processes_runs() -> None:
    multicast(97)
    run(*HERE_WITH_MULTICAST[0].split(), CAN_CHANNEL="239.74.163.97", CAN_CONFIG='{"port": 43297}')


@pytest.mark.slow
def test_a_node_on_one_machine_passes_the_verification() -> None:
    """In two terminals: the node is started when the other listens. Few ticks and a short memory will do."""
    multicast(98)
    bus = {"CAN_CHANNEL": "239.74.163.98", "CAN_CONFIG": '{"port": 43298}'}
    radio, node = (command.split() for command in HERE_WITH_MULTICAST[1:])
    environment = {**os.environ, "PATH": PATH, **bus}
    short = ["--filter-period", "10", "--memory", "64"]
    with subprocess.Popen([*radio, *short, "--steps", "3"], env=environment, stdout=subprocess.PIPE) as judge:
        joined = "62A34AEF"  # 239.74.163.98 as the kernel writes it
        while judge.poll() is None and joined not in Path("/proc/net/igmp").read_text():
            time.sleep(0.05)
        with subprocess.Popen([*node, *short], env=environment, stdout=subprocess.DEVNULL) as controller:
            printed, _ = judge.communicate(timeout=PATIENCE)
            controller.terminate()
    assert judge.returncode == 0, printed.decode()
    assert controller.returncode == 0


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
    assert (tmp_path / "index.html").exists()
    check_generated_pages(tmp_path)


def check_generated_pages(site: Path) -> None:
    """All commands and rooms are there, docstrings are rendered, and formulas are MathML."""
    commands, api, method = (text_of(site / page / "index.html") for page in ("cli", "api", "method"))
    for name in cli.COMMANDS:
        assert f"mcp-asdf {name}" in commands
    for room in ("common", "swarm", "experiments"):
        assert f"mcp_asdf_tools.{room}" in (site / "api/index.html").read_text(encoding="utf-8")
    assert not re.search(r":(class|func|meth|mod):", api)
    assert not re.search(r"\w\*\*\w", api)
    assert "$" not in method
    assert (site / "method/index.html").read_text(encoding="utf-8").count("<math") > 10
    assert '<iframe src="run.html"' in (site / "index.html").read_text(encoding="utf-8")
    assert (site / "run.html").stat().st_size > 100_000
    assert "mcp_asdf_settle(mcp_asdf_t *robot)" in text_of(site / "headers/index.html")


def text_of(page: Path) -> str:
    """Text that a reader sees."""
    return html.unescape(re.sub(r"<[^>]+>", "", page.read_text(encoding="utf-8")))


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
