"""Firmware images under QEMU, with their serial line at a TCP port: firmware in the loop without hardware.

An image that speaks slcan there, such as ``c_ref/ports/slcan`` makes, is a CAN adapter for python-can and a
robot on its bus.
"""

from __future__ import annotations

import shutil
import signal
import socket
import subprocess
from pathlib import Path

from mcp_asdf_tools.common.errors import UsageError

HOST = "127.0.0.1"

_ARM = ("qemu-system-arm", "qemu-system-arm", "-semihosting-config", "enable=on,target=native")
_RISCV = ("qemu-system-riscv32", "qemu-system-misc", "-bios", "none")
BOARDS = {"mps2-an385": _ARM, "mps2-an386": _ARM, "virt": _RISCV}
"""QEMU's names of Arm's boards with a Cortex-M3 and a Cortex-M4, and of its own with RISC-V: the program that
emulates it, the Debian package of that, and its options."""

_SECONDS_TO_END = 5.0
_ENDED_BY_US = (0, -signal.SIGTERM, -signal.SIGKILL)


class Board:
    """A board that runs an image. A context manager: entering it switches the board on, leaving it off.

    The program on it starts when the first connection to its serial line is made. When one ends, another
    can be made.

    Attributes:
        channel: Where the serial line is, once it is on, for python-can and pyserial: "socket://HOST:PORT".
    """

    def __init__(self, machine: str, image: Path, send_buffer: int | None = None) -> None:
        """Prepare the board called ``machine``, a key of BOARDS, with ``image``, an ELF file.

        Output of the image that is not read yet waits in about ``send_buffer`` bytes (default: the system's
        choice); after that its line is busy. Raises UsageError if there is no such board or image,
        or the emulator is not installed.
        """
        if machine not in BOARDS:
            raise UsageError(f"board is {machine!r}; choose one of {', '.join(BOARDS)}")
        if not image.is_file():
            raise UsageError(f"image is {image}; there is no such file")
        program, package, *options = BOARDS[machine]
        if shutil.which(program) is None:
            raise UsageError(f"{program} is not installed; apt-get install {package}")
        self.channel = ""
        self._what = f"{image} on {machine}"
        self._command = [program, "-M", machine, "-kernel", str(image), *options]
        self._send_buffer = send_buffer

    def __enter__(self) -> Board:
        # QEMU inherits a socket that listens already, so the port is known and a program may connect at once.
        with socket.create_server((HOST, 0)) as listener:
            if self._send_buffer is not None:
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, self._send_buffer)
            self.channel = f"socket://{HOST}:{listener.getsockname()[1]}"
            self._start(listener.fileno())
        return self

    def _start(self, listener: int) -> None:
        line = f"socket,id=line,fd={listener},server=on,nodelay=on"
        quiet = ("-display", "none", "-monitor", "none")
        self._process = subprocess.Popen(
            [*self._command, *quiet, "-chardev", line, "-serial", "chardev:line"],
            pass_fds=[listener],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C is for this program, which then ends QEMU
        )

    def __exit__(self, *_: object) -> None:
        """Switch the board off. Raises UsageError if the program had ended or crashed before."""
        has_ended = self._process.poll() is not None
        self._process.terminate()
        try:
            said = self._process.communicate(timeout=_SECONDS_TO_END)[1]
        except subprocess.TimeoutExpired:
            self._process.kill()
            said = self._process.communicate()[1]
        status = self._process.returncode
        if has_ended or status not in _ENDED_BY_US:
            raise UsageError(f"{self._what} ended with status {status}; {_reason(said)}")


def _reason(said: bytes) -> str:
    """First line of QEMU's output that is no mere information; registers and the like follow."""
    lines = [line for line in said.decode(errors="replace").splitlines() if ": info: " not in line]
    return f"{lines[0]}; is it an image for this board?" if lines else "the program failed"
