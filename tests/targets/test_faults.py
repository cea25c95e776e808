"""What no test can bring about from outside the Linux node: the kernel's filter, and a clock that is late.

The program faults.c takes the place of the system, and checks what the node asks of it.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from support import CORE, ROOT, TABLE, require, run
from targets.c_node import WARNINGS

PORTS = ROOT / "c_ref/ports"
REPLACED_FUNCTIONS = ("if_nametoindex", "socket", "setsockopt", "bind")
"""Functions of the system that faults.c takes the place of."""


def printed_checks(ports: Path, folder: Path, warnings: str = WARNINGS) -> str:
    """Return what the checks in faults.c print. It includes the node's main.c and takes the system's place.

    ``ports`` has the sources of the node. The program is built in ``folder``.
    """
    sources = [path for path in ports.glob("linux/*.c") if path.name != "main.c"]
    sources += [ROOT / "tests/targets/faults.c", ports / "node/node.c", TABLE, *CORE.parent.glob("*.c")]
    includes = [f"-I{path}" for path in (ports, CORE.parent)]
    definitions = ["-D_GNU_SOURCE", "-DMCP_ASDF_NODE_TABLE=mcp_asdf_t_table_omega05_q30"]
    wraps = [f"-Wl,--wrap={name}" for name in REPLACED_FUNCTIONS]
    options = ["-std=c99", *definitions, *includes, *warnings.split(), *wraps]
    run(require("gcc"), *options, *sources, "-lm", "-o", folder / "faults")
    return run("sh", "-c", "./faults || :", cwd=folder)


def test_no_check_of_the_node_with_a_replaced_system_fails(tmp_path: Path) -> None:
    """faults.c takes the system's place: it checks what the node asks of a CAN socket, and delays its clock.

    Its last line has the number of checks that failed.
    """
    printed = printed_checks(PORTS, tmp_path)
    assert printed.endswith(" 0 failed\n"), printed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "right", "wrong"),
    [
        pytest.param("main.c", "(uint32_t)more_expiries;", "(uint32_t)more_expiries + 1U;", id="clock"),
        pytest.param("main.c", "(more_expiries + 1)", "(more_expiries + 2)", id="missed ticks"),
        pytest.param("bus.c", "errors = REPORTED_ERRORS", "errors = CAN_ERR_MASK", id="error filter"),
        pytest.param(
            "bus.c",
            "MCP_ASDF_FRAME_MASK | CAN_EFF_FLAG | CAN_RTR_FLAG",
            "MCP_ASDF_FRAME_MASK",
            id="frame filter",
        ),
    ],
)
def test_a_mistake_in_the_node_fails_a_check(file: str, right: str, wrong: str, tmp_path: Path) -> None:
    """Checks that never fail would prove nothing. In a copy of the sources ``wrong`` replaces ``right``.

    The last line of the output, "... 0 failed" for the right sources, then has another number.
    """
    ports = tmp_path / "ports"
    shutil.copytree(PORTS, ports)
    source = ports / "linux" / file
    text = source.read_text(encoding="utf-8")
    assert text.count(right) == 1
    source.write_text(text.replace(right, wrong), encoding="utf-8")

    printed = printed_checks(ports, tmp_path, warnings="-w")  # none: wrong code may deserve some

    assert not printed.endswith(" 0 failed\n"), printed
