"""Compile the playground for WebAssembly and write its page: ``python .ci/playground.py FILE.html``."""

from __future__ import annotations

import base64
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from mcp_asdf_tools.common.files import write_atomically
from mcp_asdf_tools.view.page import PageAdditions, assemble_page

ROOT = Path(__file__).resolve().parents[1]
PLAYGROUND = ROOT / "docs/playground"
ENGINE = ROOT / "host_tools/mcp_asdf_tools/experiments/engine"
ARENA = ROOT / "host_tools/mcp_asdf_tools/world/arena"
SOURCES = (
    PLAYGROUND / "playground.c",
    *(ENGINE / f"{name}.c" for name in ("engine", "lanes", "trial")),
    *(ARENA / f"{name}.c" for name in ("arena", "links", "motion", "steering")),
    ROOT / "c_ref/src/mcp_asdf_small.c",
    ROOT / "tables/t_table_omega05_q127.c",
    ROOT / "c_ref/ports/memory.c",
)
INCLUDE_FOLDERS = (PLAYGROUND / "include", ENGINE, ARENA, ROOT / "c_ref/src")
SCRIPTS = ("comparison", "playground", "settings", "worker")
"""Scripts of the playground, which import each other as ``playground/NAME``."""
EXPORTED_ARRAYS = ("settings", "records", "errors", "positions", "links", "pixels")
EXPORTED_FUNCTIONS = ("run_trial", "arena_side", "record_motion")


def compile_module() -> bytes:
    """Return firmware, engine, arena and playground as one WebAssembly module.

    Raises SystemExit with one line if the tools are missing or refuse the code.
    """
    missing_tools = [tool for tool in ("clang", "wasm-ld") if shutil.which(tool) is None]
    if missing_tools:
        raise SystemExit(
            f"the playground needs {' and '.join(missing_tools)}: install Debian's packages clang and lld"
        )
    exports = EXPORTED_ARRAYS + EXPORTED_FUNCTIONS
    with TemporaryDirectory() as folder:
        module = Path(folder, "playground.wasm")
        command = [
            *("clang", "--target=wasm32", "-ffreestanding", "-std=c99", "-O3", "-nostdlib"),
            *(f"-I{path}" for path in INCLUDE_FOLDERS),
            *("-Wl,--no-entry", "-Wl,-z,stack-size=1048576", "-Wl,--strip-all"),
            *(f"-Wl,--export={name}" for name in exports),
        ]
        compilation = subprocess.run([*command, "-o", module, *SOURCES], check=False)
        if compilation.returncode != 0:
            raise SystemExit("clang cannot compile the playground for WebAssembly; it says why above")
        return module.read_bytes()


def build_page(module: bytes) -> str:
    """Return the page that computes its runs itself, by a WebAssembly module."""

    def read_file(name: str) -> str:
        return (PLAYGROUND / name).read_text(encoding="utf-8")

    additions = PageAdditions(
        entry_script="playground/playground",
        scripts={f"playground/{name}": read_file(f"{name}.js") for name in SCRIPTS},
        style=read_file("playground.css"),
        html=read_file("playground.html"),
        script_policy=" 'wasm-unsafe-eval'; worker-src data:",
    )
    return assemble_page({"module": base64.b64encode(module).decode("ascii")}, additions)


if __name__ == "__main__":
    write_atomically(Path(sys.argv[1]), build_page(compile_module()).encode())
