"""A kernel with CAN where this machine's has none: Debian's own, in an emulator, on this machine's files.

Nothing is installed: the kernel's package is downloaded once into a cache folder (``~/.cache/mcp-asdf``, or
what ``MCP_ASDF_CACHE`` says), and of its modules only those that are needed are unpacked.
"""

from __future__ import annotations

import errno
import fcntl
import os
import platform
import shlex
import shutil
import signal
import socket
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

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
    *("net/can", "drivers/net/can/dev", "drivers/net/can/vcan.ko", "drivers/net/can/vxcan.ko", "net/sched"),
    *(
        "net/9p",
        "fs/9p",
        "fs/netfs",
        "fs/fscache",
        "fs/overlayfs",
        "drivers/virtio",
        "drivers/char/virtio_console.ko",
    ),
)
"""Of the kernel's modules: CAN, queues, and what it takes to see the host's files."""

MEMORY = "1G"
CPUS = 1
"""More are hardly faster, and emulated ones stop each other for long; see ``one_cpu`` in conftest.py."""

FILES = (
    "-fsdev local,id=files,path=/,security_model=none,readonly=on,multidevs=remap "
    "-device virtio-9p-pci,fsdev=files,mount_tag=files"
)
"""This machine's files once more: virtme-ng's own share caches nothing, which is four times slower."""

INSIDE = """\
root=/run/files
mkdir $root
mount -t 9p -o ro,cache=loose,version=9p2000.L,trans=virtio,msize=512000 files $root || exit 1
for folder in /proc /sys /dev /run /tmp {shared}; do mount --rbind $folder $root$folder; done
exec chroot $root sh {shared}/script
"""
"""Shell script: run the real one on those files."""

KERNEL_ARGUMENTS = "mitigations=off"
"""Protection against other users costs an emulator a third of its time."""


class NoGuestError(Exception):
    """A guest cannot be had here; the message says why, and what to do."""


def why_not_native() -> str:
    """Why virtual CAN interfaces cannot be made on this machine's kernel; empty if they can."""
    name = f"try{os.getpid()}"
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as error:
        return f"the kernel has no CAN ({errno.errorcode[error.errno or 0]})"
    for command in (["modprobe", "vcan"], ["ip", "link", "add", "dev", name, "type", "vcan"]):
        done = _run(command)
        if done.returncode and command[0] == "ip":
            return f"vcan cannot be made ({done.stderr.strip()})"
    _run(["ip", "link", "del", "dev", name])
    return ""


def run_in_guest(script: str, shared: Path, timeout: float) -> None:
    """Run a shell script as root in a guest; of the host's files it may write those in ``shared`` alone.

    What it says is in ``shared``/log afterwards. A guest that does not end within ``timeout`` seconds is
    stopped. Raises NoGuestError if there is none to be had.
    """
    kernel = _kernel()
    (shared / "script").write_text(script, encoding="utf-8")
    (shared / "inside").write_text(INSIDE.format(shared=shlex.quote(str(shared))), encoding="utf-8")
    inside = f"sh {shlex.quote(str(shared))}/inside >{shlex.quote(str(shared))}/log 2>&1; sync"
    machine = ["--force-9p", "--disable-kvm", "--cpus", str(CPUS), "--memory", MEMORY]
    settings = [*machine, f"--qemu-opts={FILES}", "--append", KERNEL_ARGUMENTS, f"--rwdir={shared}"]
    command = ["vng", "--run", str(kernel), *settings, "--", inside]
    with (shared / "console").open("wb") as stream:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=stream,
            stderr=stream,
            env=_environment(),
            cwd="/",
            start_new_session=True,
        )
        try:
            process.wait(timeout)
        except subprocess.TimeoutExpired:
            stream.write(b"stopped: its time is over")
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def _run(command: Sequence[str], **options: object) -> subprocess.CompletedProcess[str]:
    if shutil.which(command[0], path=_environment()["PATH"]) is None:
        return subprocess.CompletedProcess(command, 127, "", f"{command[0]} is not installed")
    return subprocess.run(command, capture_output=True, text=True, check=False, env=_environment(), **options)  # type: ignore[call-overload,no-any-return]


def _environment() -> Mapping[str, str]:
    return {**os.environ, "PATH": os.pathsep.join([PATH, "/usr/sbin", "/sbin"])}


def _kernel() -> Path:
    """The cached kernel; downloads it if there is none."""
    missing = [tool for tool in TOOLS if shutil.which(tool, path=_environment()["PATH"]) is None]
    if missing:
        packages = " ".join(filter(None, (TOOLS[tool] for tool in missing)))
        fix = f"apt-get install {packages}" if packages else "make setup"
        raise NoGuestError(f"no {' and no '.join(missing)}: {fix}")
    if platform.machine() != "x86_64":
        raise NoGuestError(f"a guest needs x86_64, this is {platform.machine()}")
    cache = Path(os.environ.get("MCP_ASDF_CACHE") or Path.home() / ".cache/mcp-asdf")
    with _locked(cache):
        kernels = sorted(cache.glob("linux-image-*/boot/vmlinuz-*"))
        return kernels[-1] if kernels else _download(cache)


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / "lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield
    except OSError as error:
        raise NoGuestError(
            f"cannot use the cache {folder}: {error}; set MCP_ASDF_CACHE to another folder"
        ) from error


def _download(cache: Path) -> Path:
    """Fetch Debian's present kernel and unpack the needed part of it in the cache."""
    depends = _run(["apt-cache", "depends", "linux-image-amd64"]).stdout.split()
    package = next((word for word in depends if word.startswith("linux-image-") and word[12].isdigit()), None)
    if package is None:
        raise NoGuestError("apt knows no linux-image-amd64: apt-get update, or use Debian")
    with tempfile.TemporaryDirectory(dir=cache) as name:
        folder = Path(name)
        done = _run(["apt-get", "download", package], cwd=folder)
        found = list(folder.glob("*.deb"))
        if done.returncode or not found:
            raise NoGuestError(f"cannot download {package}: {done.stderr.strip()[-300:]}")
        _unpack(found[0], folder / "kernel")
        os.replace(folder / "kernel", cache / package)
    return next((cache / package).glob("boot/vmlinuz-*"))


def _unpack(package: Path, folder: Path) -> None:
    folder.mkdir()
    wanted = [
        "./boot/vmlinuz-*",
        "./lib/modules/*/modules.*",
        *(f"./lib/modules/*/kernel/{path}*" for path in MODULES),
    ]
    command = ["tar", "-x", "-C", str(folder), "--wildcards", *wanted]
    with subprocess.Popen(["dpkg", "--fsys-tarfile", str(package)], stdout=subprocess.PIPE) as content:
        done = subprocess.run(command, stdin=content.stdout, capture_output=True, text=True, check=False)
    if done.returncode:
        raise NoGuestError(f"cannot unpack {package.name}: {done.stderr.strip()[-300:]}")


def shell_line(*words: str | Path) -> str:
    """A command as the shell reads it."""
    return shlex.join(map(str, words)) + "\n"
