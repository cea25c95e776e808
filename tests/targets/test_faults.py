"""What no test can bring about from outside the Linux node: the kernel's filter, and a clock that is late.

The program faults.c takes the place of the system, and checks what the node asks of it.
"""

from __future__ import annotations

from pathlib import Path

from support import CORE, ROOT, TABLE, require, run
from targets.c_node import WARNINGS

PORTS = ROOT / "c_ref/ports"
REPLACED_FUNCTIONS = ("if_nametoindex", "socket", "setsockopt", "bind")
"""Functions of the system that faults.c takes the place of."""


def build_faults(program: Path) -> None:
    """Build faults.c, which includes the node's main.c, with the rest of the node."""
    sources = [path for path in PORTS.glob("linux/*.c") if path.name != "main.c"]
    sources += [ROOT / "tests/targets/faults.c", PORTS / "node/node.c", TABLE, *CORE.parent.glob("*.c")]
    includes = [f"-I{path}" for path in (PORTS, CORE.parent)]
    definitions = ["-D_GNU_SOURCE", "-DMCP_ASDF_NODE_TABLE=mcp_asdf_t_table_omega05_q30"]
    wraps = [f"-Wl,--wrap={name}" for name in REPLACED_FUNCTIONS]
    options = ["-std=c99", *definitions, *includes, *WARNINGS.split(), *wraps]
    run(require("gcc"), *options, *sources, "-lm", "-o", program)


def test_no_check_of_the_node_with_a_replaced_system_fails(tmp_path: Path) -> None:
    """faults.c takes the system's place: it checks what the node asks of a CAN socket, and delays its clock.

    It prints each check that fails, and run() raises what it has printed unless all have passed.
    """
    build_faults(tmp_path / "faults")
    run(tmp_path / "faults")
