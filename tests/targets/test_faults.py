"""What no test can bring about from outside the Linux node: the kernel's filter, and a clock that is late.

The program faults.c takes the place of the system, and checks what the node asks of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest

from support import CORE, ROOT, TABLE, require, run
from targets.c_node import WARNINGS

LINUX_PORT = ROOT / "c_ref/ports/linux"
REPLACED_FUNCTIONS = ("if_nametoindex", "socket", "setsockopt", "bind")
"""Functions of the system that faults.c takes the place of."""


@dataclass(frozen=True)
class PlantedFault:
    """A fault of the node.

    Attributes:
        file: Name of a source of the Linux port.
        right: Text in it.
        wrong: Text that takes its place.
    """

    file: str
    right: str
    wrong: str


PLANTED_FAULTS = [
    PlantedFault(
        file="main.c",
        right="(uint32_t)more_expiries;",
        wrong="(uint32_t)more_expiries + 1U;",
    ),
    PlantedFault(file="main.c", right="(more_expiries + 1)", wrong="(more_expiries + 2)"),
    PlantedFault(file="bus.c", right="errors = REPORTED_ERRORS", wrong="errors = CAN_ERR_MASK"),
    PlantedFault(
        file="bus.c",
        right="MCP_ASDF_FRAME_MASK | CAN_EFF_FLAG | CAN_RTR_FLAG",
        wrong="MCP_ASDF_FRAME_MASK",
    ),
]


def write_sources(folder: Path, fault: PlantedFault | None) -> list[Path]:
    """Write the Linux port into a folder, with the fault, and return its C files but for main.c."""
    (folder / "linux").mkdir()
    (folder / "node").symlink_to(ROOT / "c_ref/ports/node")
    for path in LINUX_PORT.glob("*.[ch]"):
        text = path.read_text(encoding="utf-8")
        if fault is not None and fault.file == path.name:
            assert text.count(fault.right) == 1, fault
            text = text.replace(fault.right, fault.wrong)
        (folder / "linux" / path.name).write_text(text, encoding="utf-8")
    return [path for path in (folder / "linux").glob("*.c") if path.name != "main.c"]


def run_checks(folder: Path, fault: PlantedFault | None = None) -> str:
    """Build the node with faults.c, which includes main.c, and return what its checks print.

    The last line has the number of checks that failed.
    """
    port_sources = write_sources(folder, fault)
    sources = [*port_sources, ROOT / "tests/targets/faults.c", folder / "node/node.c", TABLE]
    sources += CORE.parent.glob("*.c")
    includes = [f"-I{path}" for path in (folder, ROOT / "c_ref/ports", CORE.parent)]
    definitions = ["-D_GNU_SOURCE", "-DMCP_ASDF_NODE_TABLE=mcp_asdf_t_table_omega05_q30"]
    wraps = [f"-Wl,--wrap={name}" for name in REPLACED_FUNCTIONS]
    warnings = WARNINGS.split() if fault is None else ["-w"]
    options = ["-std=c99", *definitions, *includes, *warnings, *wraps]
    run(require("gcc"), *options, *sources, "-lm", "-o", folder / "faults")
    return run("sh", "-c", "./faults || :", cwd=folder)


def test_the_node_sets_its_socket_and_counts_its_ticks_rightly(tmp_path: Path) -> None:
    printed = run_checks(tmp_path)
    assert printed.endswith(" 0 failed\n"), printed


@pytest.mark.slow
@pytest.mark.parametrize("fault", PLANTED_FAULTS, ids=lambda fault: f"{fault.file} {fault.right}")
def test_a_planted_fault_of_the_node_fails_a_check(fault: PlantedFault, tmp_path: Path) -> None:
    assert not run_checks(tmp_path, fault).endswith(" 0 failed\n")
