"""A module that is run as a program ends with its own exit code after an interruption, wherever it came."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from support import interruptible

PROGRAM_THAT_RUNS_WORK = """\
import sys
from mcp_asdf_tools.common.signals import INTERRUPTED, exit_code_of_signal, raising_on_signals

def work():
    try:
        {work}
    except KeyboardInterrupt:
        return INTERRUPTED
    return 0

with raising_on_signals():
    code = exit_code_of_signal(work())
sys.exit(code)
"""


@pytest.mark.parametrize("is_within_exec", [False, True], ids=["plain", "within exec"])
@interruptible()
def test_a_program_that_a_signal_interrupts_anywhere_ends_with_the_exit_code_of_the_signal(
    is_within_exec: bool, tmp_path: Path
) -> None:
    """The program sends itself SIGHUP, as a terminal does that is closed. Shells expect 128 + its number.

    Within exec() come interruptions of modules that are imported and have dataclasses.
    """
    send_signal = "import os, signal; os.kill(os.getpid(), signal.SIGHUP)"
    work = f"{send_signal}; [None for _ in range(100)]"  # Python handles the signal in one of these rounds
    if is_within_exec:
        work = f"exec({work!r})"
    (tmp_path / "program.py").write_text(PROGRAM_THAT_RUNS_WORK.format(work=work))

    result = subprocess.run([sys.executable, "-m", "program"], cwd=tmp_path, check=False)

    assert result.returncode == 128 + signal.SIGHUP
