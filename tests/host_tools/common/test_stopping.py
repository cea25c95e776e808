"""A module that is run as a program ends with its own exit code after an interruption, wherever it came."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from support import interruptible

PROGRAM = """\
import sys
from mcp_asdf_tools.common.signals import INTERRUPTED, exit_code_of_signal, stopping

def work():
    try:
        {work}
    except KeyboardInterrupt:
        return INTERRUPTED
    return 0

with stopping(interrupt=True):
    code = exit_code_of_signal(work())
sys.exit(code)
"""
HANG_UP = "import os, signal; os.kill(os.getpid(), signal.SIGHUP); [None for _ in range(100)]"


@pytest.mark.parametrize("work", [HANG_UP, f"exec({HANG_UP!r})"], ids=["plain", "within exec"])
@interruptible()
def test_a_program_that_a_signal_interrupts_anywhere_ends_with_the_exit_code_of_the_signal(
    work: str, tmp_path: Path
) -> None:
    """Within exec() come interruptions of modules that are imported and have dataclasses."""
    (tmp_path / "program.py").write_text(PROGRAM.format(work=work))
    result = subprocess.run([sys.executable, "-m", "program"], cwd=tmp_path, check=False)
    assert result.returncode == 128 + signal.SIGHUP
