"""What no test can bring about from outside the Linux node: the kernel's filter, and a clock that is late.

The program faults.c takes the place of the system, and checks what the node asks of it.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from support import CORE, ROOT, TABLE, require, run
from targets.c_node import WARNINGS

PORTS = ROOT / "c_ref/ports"
LINUX_PORT = PORTS / "linux"
REPLACED_FUNCTIONS = ("if_nametoindex", "socket", "setsockopt", "bind")
"""Functions of the system that faults.c takes the place of."""


@pytest.fixture
def printed_checks(tmp_path: Path) -> str:
    """What the checks in faults.c print, which includes the node's main.c and takes the system's place."""
    sources = [path for path in LINUX_PORT.glob("*.c") if path.name != "main.c"]
    sources += [ROOT / "tests/targets/faults.c", PORTS / "node/node.c", TABLE, *CORE.parent.glob("*.c")]
    includes = [f"-I{path}" for path in (PORTS, CORE.parent)]
    definitions = ["-D_GNU_SOURCE", "-DMCP_ASDF_NODE_TABLE=mcp_asdf_t_table_omega05_q30"]
    wraps = [f"-Wl,--wrap={name}" for name in REPLACED_FUNCTIONS]
    options = ["-std=c99", *definitions, *includes, *WARNINGS.split(), *wraps]
    run(require("gcc"), *options, *sources, "-lm", "-o", tmp_path / "faults")
    return run("sh", "-c", "./faults || :", cwd=tmp_path)


def test_no_check_of_the_node_with_a_replaced_system_fails(printed_checks: str) -> None:
    """faults.c takes the system's place: it checks what the node asks of a CAN socket, and delays its clock.

    Its last line has the number of checks that failed.
    """
    assert printed_checks.endswith(" 0 failed\n"), printed_checks
