"""Compile the playground for WebAssembly and write its page: ``python .ci/playground.py FILE.html``."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from mcp_asdf_tools.common.files import write_atomically
from mcp_asdf_tools.view.page import playground

ROOT = Path(__file__).resolve().parents[1]
TOOLS = ROOT / "host_tools/mcp_asdf_tools"
_OWN, _ENGINE, _ARENA = TOOLS / "view/playground", TOOLS / "experiments/engine", TOOLS / "world/arena"
_SOURCES = (
    _OWN / "playground.c",
    *(_ENGINE / f"{name}.c" for name in ("engine", "lanes", "trial")),
    *(_ARENA / f"{name}.c" for name in ("arena", "links", "motion", "steering")),
    ROOT / "tables/t_table_omega05_q127.c",
    ROOT / "c_ref/ports/memory.c",
)
_INCLUDES = (_OWN / "include", _ENGINE, _ARENA, ROOT / "c_ref/src")
_EXPORTS = (
    *("settings", "records", "errors", "positions", "links", "pixels"),
    *("run", "side", "film"),
)


def compiled() -> bytes:
    """The module. Raises SystemExit with one line if the tools are missing or refuse it."""
    missing = [tool for tool in ("clang", "wasm-ld") if shutil.which(tool) is None]
    if missing:
        raise SystemExit(
            f"the playground needs {' and '.join(missing)}: install Debian's packages clang and lld"
        )
    with TemporaryDirectory() as folder:
        module = Path(folder, "playground.wasm")
        command = ["clang", "--target=wasm32", "-ffreestanding", "-std=c99", "-O3", "-nostdlib"]
        command += [f"-I{path}" for path in _INCLUDES]
        command += ["-Wl,--no-entry", "-Wl,-z,stack-size=1048576", "-Wl,--strip-all"]
        command += [f"-Wl,--export={name}" for name in _EXPORTS]
        done = subprocess.run([*command, "-o", module, *_SOURCES], check=False)
        if done.returncode:
            raise SystemExit("clang cannot compile the playground for WebAssembly; it says why above")
        return module.read_bytes()


if __name__ == "__main__":
    write_atomically(Path(sys.argv[1]), playground(compiled()).encode())
