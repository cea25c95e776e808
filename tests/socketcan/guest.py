"""A kernel with CAN where this machine's has none: Debian's own, in an emulator, on this machine's files.

Nothing is installed: the kernel's package is downloaded once into a cache folder (``~/.cache/mcp-asdf``, or
what ``MCP_ASDF_CACHE`` says), and of its modules only those that are needed are unpacked.
"""

from __future__ import annotations

import errno
import os
import platform
import shlex
import shutil
import signal
import socket
import subprocess
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from support import PATH

TOOLS = {
    "qemu-system-x86_64": "qemu-system-x86",
    "busybox": "busybox-static",
    "modprobe": "kmod",
    "udevadm": "udev",
    "ip": "iproute2",
    "apt-get": "apt",
    "dpkg": "dpkg",
    "vng": "",
    "virtme-run": "",
}
"""Programs that a guest needs, and their Debian packages; "": in the virtual environment."""

MODULES = (
    *("net/can", "drivers/net/can/dev", "drivers/net/can/vcan.ko", "drivers/net/can/sja1000"),
    *("net/9p", "fs/9p", "fs/netfs", "fs/fscache", "fs/overlayfs"),
    *("drivers/virtio", "drivers/char/virtio_console.ko"),
)
"""Modules of the kernel: CAN, and what it takes to see the host's files."""

FILES = (
    "-fsdev local,id=files,path=/,security_model=none,readonly=on,multidevs=remap "
    "-device virtio-9p-pci,fsdev=files,mount_tag=files"
)
"""This machine's files once more: virtme-ng's own share caches nothing, which is four times slower."""

CONTROLLERS = "-object can-bus,id=wire" + 2 * " -device kvaser_pci,canbus=wire"
"""Two cards with a SJA1000 each, on one wire: can0 and can1."""

MACHINE = (
    *("--force-9p", "--disable-kvm", f"--qemu-opts={FILES} {CONTROLLERS}", "--memory", "1G"),
    *("--cpus", "1"),  # more are hardly faster, and emulated ones stop each other for long
    *("--append", "mitigations=off"),  # protection against other users costs a third of the time
)

INSIDE = """\
root=/run/files
mkdir $root
mount -t 9p -o ro,cache=loose,version=9p2000.L,trans=virtio,msize=512000 files $root || exit 1
for folder in /proc /sys /dev /run /tmp {shared}; do mount --rbind $folder $root$folder; done
exec chroot $root sh {shared}/script
"""
"""Shell script: run the real one on those files."""

ENVIRONMENT = {**os.environ, "PATH": os.pathsep.join([PATH, "/usr/sbin", "/sbin"])}


@cache
def why_not_native() -> str:
    """Return why virtual CAN interfaces cannot be made on this machine's kernel; empty if they can."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as error:
        return f"the kernel has no CAN ({errno.errorcode[error.errno or 0]})"
    if shutil.which("ip", path=ENVIRONMENT["PATH"]) is None:
        return "vcan cannot be made (ip is not installed)"
    name = f"try{os.getpid()}"
    with suppress(OSError):
        _run("modprobe", "vcan")
    made = _run("ip", "link", "add", "dev", name, "type", "vcan")
    _run("ip", "link", "del", "dev", name)
    return f"vcan cannot be made ({made.stderr.strip()})" if made.returncode else ""


def run_in_guest(script: str, shared: Path, timeout: float) -> None:
    """Run a shell script as root in a guest; of the host's files it may write those in ``shared`` alone.

    What it says is in ``shared``/log afterwards, what the kernel says in ``shared``/console. A guest that
    does not end within ``timeout`` seconds is stopped. Skips the test if there is none to be had.
    """
    kernel, quoted = _kernel(), shlex.quote(str(shared))
    (shared / "script").write_text(script, encoding="utf-8")
    (shared / "inside").write_text(INSIDE.format(shared=quoted), encoding="utf-8")
    inside = f"sh {quoted}/inside >{quoted}/log 2>&1; sync"
    command = ["vng", "--run", str(kernel), *MACHINE, f"--rwdir={shared}", "--", inside]
    with (shared / "console").open("wb") as stream:
        streams: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": stream, "stderr": stream}
        process = subprocess.Popen(command, env=ENVIRONMENT, cwd="/", start_new_session=True, **streams)
        try:
            process.wait(timeout)
        except subprocess.TimeoutExpired:
            stream.write(b"stopped: its time is over")
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def _run(*command: str, **options: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, check=False, env=ENVIRONMENT, **options)


def _kernel() -> Path:
    """Return the cached kernel, or download it if there is none."""
    missing = [tool for tool in TOOLS if shutil.which(tool, path=ENVIRONMENT["PATH"]) is None]
    if missing:
        packages = " ".join(filter(None, (TOOLS[tool] for tool in missing)))
        fix = f"apt-get install {packages}" if packages else "make setup"
        pytest.skip(f"no {' and no '.join(missing)}: {fix}")
    if platform.machine() != "x86_64":
        pytest.skip(f"a guest needs x86_64, this is {platform.machine()}")
    cached = Path(os.environ.get("MCP_ASDF_CACHE") or Path.home() / ".cache/mcp-asdf")
    try:
        cached.mkdir(parents=True, exist_ok=True)
        for package in sorted(cached.glob("linux-image-*"), reverse=True):
            has_modules = any(package.glob("lib/modules/*/kernel/drivers/net/can/sja1000"))
            kernels = list(package.glob("boot/vmlinuz-*"))
            if has_modules and kernels:
                return kernels[-1]
        return _download(cached)
    except OSError as error:
        pytest.skip(f"cannot use the cache {cached}: {error}; set MCP_ASDF_CACHE to another folder")


def _download(cached: Path) -> Path:
    """Fetch Debian's present kernel and unpack the needed part of it in the cache."""
    depends = _run("apt-cache", "depends", "linux-image-amd64").stdout.split()
    package = next((word for word in depends if word.startswith("linux-image-") and word[12].isdigit()), None)
    if package is None:
        pytest.skip("apt knows no linux-image-amd64: apt-get update, or use Debian")
    wanted = ["./boot/vmlinuz-*", "./lib/modules/*/modules.*"]
    wanted += [f"./lib/modules/*/kernel/{path}*" for path in MODULES]
    with tempfile.TemporaryDirectory(dir=cached) as name:
        folder = Path(name)
        (folder / "kernel").mkdir()
        for command in (
            f"apt-get download {package}",
            f"dpkg --fsys-tarfile {package}_*.deb | tar -x -C kernel --wildcards {shlex.join(wanted)}",
        ):
            done = _run("sh", "-c", command, cwd=folder)
            if done.returncode:
                pytest.skip(f"no kernel for a guest: {command}: {done.stderr.strip()[-300:]}")
        # A package that an older version of this file has unpacked lacks files.
        shutil.rmtree(cached / package, ignore_errors=True)
        os.replace(folder / "kernel", cached / package)
    return next((cached / package).glob("boot/vmlinuz-*"))
