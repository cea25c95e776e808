"""A long run of everything that goes wrong, and a table of what was survived: ``make soak HOURS=1``.

``python tests/soak.py [--hours 1] [--seed N] [--json]``

Two things run side by side in one process until the time is over. Robots in real time, each by a clock of its
own rate, share a bus that goes away now and then; they restart, two have one id, and a stranger sends what is
no legal frame. Meanwhile one swarm after the other runs in lockstep with every kind of fault at once, and its
log is replayed; now and then one is killed, or its disk is full. Memory and open files must not grow.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import can
from can.interfaces import virtual
from rich.console import Console
from rich.table import Table

from mcp_asdf.robot import FixedPointRobot
from mcp_asdf_tools.bus.frames import FrameFormat
from mcp_asdf_tools.common.progress_bar import progress
from mcp_asdf_tools.common.signals import stopping
from mcp_asdf_tools.recording.frame_logs import read_log
from mcp_asdf_tools.recording.input_log import InputLogHeader, InputLogReader, input_log_of
from mcp_asdf_tools.recording.recording import Recording
from mcp_asdf_tools.recording.replay import verify
from mcp_asdf_tools.robots.bus_robot import BusRobot
from mcp_asdf_tools.robots.node import BusLink
from mcp_asdf_tools.robots.record import RobotRecord
from mcp_asdf_tools.robots.rounds import TickConfig
from mcp_asdf_tools.swarm.carrier import OpenBus, Wiring
from mcp_asdf_tools.swarm.fault_spec import FaultKind
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm, run_swarm
from mcp_asdf_tools.tables.thresholds import generate, parse_omega
from node_thread import live

ROOT = Path(__file__).parents[1]
RATES = (48, 49, 50, 50, 51, 52)
"""Ticks a second of the robots in real time: clocks that drift apart by 4 % of their period each tick."""
WARM = 600.0
"""Seconds after which all that is loaded when first used is there."""
GROWTH = 1.05, 2.0
"""Memory that may be added between the second quarter of the run and its last: factor, and MB beside it."""


@dataclass
class Survived:
    """Everything that happened, and what of it was not survived.

    Attributes:
        counts: By name.
        faults: Injections by kind.
        memory: Resident memory, MB, at regular times.
        files: Open files then.
        wrong: What should not have happened.
    """

    counts: Counter[str] = field(default_factory=Counter)
    faults: Counter[str] = field(default_factory=Counter)
    memory: list[float] = field(default_factory=list)
    files: list[int] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)

    def measure(self) -> None:
        """Note memory and open files."""
        gc.collect()
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        self.memory.append(pages * resource.getpagesize() / 1e6)
        self.files.append(len(os.listdir("/proc/self/fd")))

    def check_growth(self) -> None:
        """Compare the second quarter with the last."""
        quarter = len(self.memory) // 4
        before, after = median(self.memory[quarter : 2 * quarter]), median(self.memory[-quarter:])
        if after > before * GROWTH[0] + GROWTH[1]:
            self.wrong.append(f"memory grew from {before:.1f} to {after:.1f} MB")
        held_before, held_after = median(self.files[quarter : 2 * quarter]), median(self.files[-quarter:])
        if held_after > held_before:
            self.wrong.append(f"open files grew from {held_before:g} to {held_after:g}")

    def table(self) -> Table:
        """All figures."""
        table = Table(box=None, show_header=False, padding=(0, 1))
        table.add_column()
        table.add_column(justify="right")
        for name, count in self.counts.items():
            table.add_row(name, f"{count:,}")
        for kind in FaultKind:
            table.add_row(f"fault {kind.value}", f"{self.faults[kind.value]:,}")
        names = ("at the start", "median of the second quarter", "median of the last quarter", "at most")
        quarter = max(1, len(self.memory) // 4)
        for what, series in (("memory, MB", self.memory), ("open files", self.files)):
            parts = (series[:1], series[quarter : 2 * quarter] or series, series[-quarter:], [max(series)])
            for name, part in zip(names, parts, strict=True):
                table.add_row(f"{what}, {name}", f"{median(part):g}")
        table.add_row("not survived", "; ".join(self.wrong) or "nothing")
        return table


# --- Robots in real time ---------------------------------------------------------------------------------


class Fading(can.BusABC):
    """Connection to a bus that is away while ``away`` is set."""

    def __init__(self, bus: can.BusABC, away: threading.Event) -> None:
        super().__init__(channel="fading")
        self.channel_info = "a bus that goes away"
        self._bus, self._away = bus, away

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """As ``can.BusABC.send``."""
        self._check()
        self._bus.send(msg, timeout)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        self._check()
        return self._bus._recv_internal(timeout)

    def _check(self) -> None:
        if self._away.is_set():
            raise can.CanOperationError("the bus is away")

    def shutdown(self) -> None:
        """As ``can.BusABC.shutdown``."""
        super().shutdown()
        self._bus.shutdown()


class RealTime:
    """Robots in threads of their own, and all that troubles them."""

    def __init__(self, seed: int, survived: Survived) -> None:
        self._draw = random.Random(seed)
        self._survived = survived
        self._away, self._over = threading.Event(), threading.Event()
        self._restart = [threading.Event() for _ in RATES]
        self._threads: list[threading.Thread] = []
        self._lock = threading.Lock()

    def __enter__(self) -> RealTime:
        works = [partial(self._live, place) for place in range(len(RATES))]
        for work in (*works, self._trouble):
            self._threads.append(threading.Thread(target=self._guard, args=(work,)))
            self._threads[-1].start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        for thread in self._threads:
            thread.join()

    def _guard(self, work: Callable[[], None]) -> None:
        try:
            work()
        except Exception as error:
            self._survived.wrong.append(f"a robot in real time ended by {type(error).__name__}: {error}")

    def _note(self, **counts: int) -> None:
        with self._lock:
            for name, count in counts.items():
                self._survived.counts[name.replace("_", " ")] += count

    def _live(self, place: int) -> None:
        """One robot, which restarts."""
        while not self._over.is_set():
            self._restart[place].clear()
            robot = min(place, len(RATES) - 2)
            record = RobotRecord(robot, "native", 0.9, TickConfig(generate(parse_omega("0.05"), 10)))
            one = BusRobot(robot, record.make, FrameFormat())
            bus = Fading(_virtual("soak"), self._away)
            link = BusLink(bus, lambda: self._over.is_set() or self._restart[place].is_set(), endures=True)
            with bus:
                live(one, link, RATES[place], lambda frame: None)
            self._finish(one, link)

    def _finish(self, one: BusRobot, link: BusLink) -> None:
        heard = one.reception
        self._note(
            robots_started=1,
            ticks_in_real_time=one.ticks,
            estimates_heard=heard.delivered,
            estimates_refused=heard.refused,
            invalid_frames=heard.rejected.total(),
            failures_of_the_bus_noted=link.failures,
            id_conflicts_noticed=heard.id_conflicts,
        )
        if not _is_sound(one.robot):
            self._survived.wrong.append(f"robot {one.id} is in an impossible state")

    def _trouble(self) -> None:
        """Take the bus away, restart robots, send what is no legal frame."""
        with _virtual("soak") as bus:
            while not self._over.wait(self._draw.uniform(0.1, 1.0)):
                what = self._draw.random()
                if what < 0.05:
                    self._away.set()
                    self._over.wait(self._draw.uniform(0.1, 3.0))
                    self._away.clear()
                    self._note(times_that_the_bus_went_away=1)
                elif what < 0.1:
                    self._draw.choice(self._restart).set()
                else:
                    self._babble(bus)

    def _babble(self, bus: can.BusABC) -> None:
        for _ in range(self._draw.randrange(50)):
            is_extended = self._draw.random() < 0.9
            known = FrameFormat().identifier(self._draw.randrange(128))
            number = self._draw.choice([known, self._draw.randrange(2**29)]) if is_extended else 5
            data = self._draw.randbytes(self._draw.randrange(9))
            bus.send(can.Message(arbitration_id=number, is_extended_id=is_extended, data=data))
            self._note(frames_of_a_stranger=1)
        while bus.recv(0) is not None:
            pass


def _virtual(channel: str) -> can.BusABC:
    return can.Bus(interface="virtual", channel=channel, ignore_config=True)


def _is_sound(robot: object) -> bool:
    return isinstance(robot, FixedPointRobot) and robot.holds_invariants()


# --- Swarms ----------------------------------------------------------------------------------------------


def random_faults(draw: random.Random, robots: int) -> list[str]:
    """Every kind of fault, in any order."""
    others = {
        FaultKind.BURST: f"={draw.uniform(0, 0.3):.3f},length={draw.randrange(2, 9)}",
        FaultKind.BABBLE: f"={draw.uniform(0.01, 0.1):.3f},frames={draw.randrange(1, 20)}",
        FaultKind.CRASH: f"={draw.uniform(0.001, 0.03):.3f},ticks={draw.randrange(1, 20)}"
        f",rejoin={draw.choice(['new', 'restored'])}",
        FaultKind.BUSOFF: f"={draw.uniform(0.001, 0.03):.3f},ticks={draw.randrange(1, 20)}",
        FaultKind.LIAR: f"={draw.uniform(0, 1):.3f},robots={draw.randrange(robots)}"
        f",x={draw.random():.4f},alpha={10 ** draw.uniform(-9, 38):.4g}",
        FaultKind.COLLIDE: f"={draw.uniform(0.01, 0.5):.3f},id={draw.randrange(128)}",
        FaultKind.QUEUE: f"={draw.uniform(0.01, 0.3):.3f},frames={draw.randrange(3)}",
    }
    kinds = list(FaultKind)
    draw.shuffle(kinds)
    return [kind.value + others.get(kind, f"={draw.uniform(0.01, 0.3):.3f}") for kind in kinds]


def random_settings(draw: random.Random, steps: int) -> SwarmSettings:
    """A swarm of about ``steps`` ticks with every kind of fault."""
    robots, period = draw.randrange(4, 11), draw.choice([1, 1, 2, 5])
    return SwarmSettings(
        robots=robots,
        flawed=draw.randrange(robots // 2),
        steps=steps,
        comms_period=period,
        filter_period=period * draw.choice([5, 20]),
        memory=draw.choice([64, 2**31]),
        seed=draw.randrange(2**32),
        telemetry_period=draw.choice([0, 7]),
        faults=tuple(random_faults(draw, robots)),
        **draw.choice(_TOPOLOGIES),
    )


_TOPOLOGIES: list[dict[str, Any]] = [
    {"topology": "fully-connected"},
    {"topology": "dynamic", "density": 2.0, "latency": 0},
    {"topology": "dynamic", "density": 4.0, "latency": 1},
]
_MEDIA: list[tuple[OpenBus | None, bool]] = [
    (None, True),
    (lambda robot: _virtual("shared"), True),
    (lambda robot: _virtual(f"own {robot}"), False),
]
_SUFFIXES = (".log", ".blf", ".asc", ".csv")


def run_recorded(draw: random.Random, folder: Path, survived: Survived, room: int | None = None) -> None:
    """One swarm with its log, on a disk with ``room`` for files of that many bytes, replayed afterwards."""
    settings, log = random_settings(draw, draw.randrange(50, 250)), folder / f"run{draw.choice(_SUFFIXES)}"
    header = InputLogHeader(settings.records(), settings.seed, settings.frames, settings.plain())
    said: list[str] = []
    with (
        disk_with_room_for(room),
        Recording(log, header, said.append) as outputs,
        Swarm(settings, Wiring(*draw.choice(_MEDIA)), *outputs) as swarm,
    ):
        run = run_swarm(swarm)
    name = f"swarm of seed {settings.seed}"
    if run.failure is not None or not all(_is_sound(node.robot) for node in run.nodes):
        survived.wrong.append(f"{name}: {run.failure or 'an invariant is broken'}")
    if said and room is None:
        survived.wrong.append(f"{name}: {said}")
    for each in run.results["faults"]:
        survived.faults[each["fault"].partition("=")[0]] += each["injected"]
    survived.counts["swarms"] += 1
    survived.counts["full disks"] += bool(said)
    survived.counts["robot-ticks of swarms"] += settings.robots * run.results["steps"]
    survived.counts["messages in swarms"] += run.results["frames"]["delivered"]
    replay(Path(f"{log}.part") if said else log, name, survived)
    for path in folder.iterdir():
        path.unlink()


@contextmanager
def disk_with_room_for(size: int | None) -> Iterator[None]:
    """Let no file become larger than ``size``, which fails like a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    if size is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def replay(log: Path, name: str, survived: Survived) -> None:
    """Run the robots of a log again."""
    with InputLogReader(input_log_of(log)) as input_log:
        verdict = verify(read_log(log), input_log)
    survived.counts["broadcasts replayed"] += verdict.reproduced
    if verdict.difference is not None:
        survived.wrong.append(f"{name}, replayed: {verdict.difference}")


def run_killed(draw: random.Random, folder: Path, survived: Survived) -> None:
    """A swarm in a process of its own, killed at some moment; its log is replayed up to there."""
    settings = random_settings(draw, 1_000_000)
    log, part = folder / "run.log", folder / "run.log.part"
    words = ["swarm", "--quiet", "--log", str(log), f"--seed={settings.seed}", f"--robots={settings.robots}"]
    words += [f"--fault={fault}" for fault in settings.faults] + ["--steps=1000000"]
    command = [sys.executable, "-m", "mcp_asdf_tools.cli.main", *words]
    with subprocess.Popen(command, cwd=ROOT) as running:
        while running.poll() is None and not (part.exists() and part.stat().st_size):
            time.sleep(0.05)
        time.sleep(draw.uniform(0, 2))
        running.send_signal(signal.SIGKILL)
    survived.counts["processes killed"] += 1
    replay(part, f"killed swarm of seed {settings.seed}", survived)
    for path in folder.iterdir():
        path.unlink()


# --- The whole -------------------------------------------------------------------------------------------


def run_next(draw: random.Random, folder: Path, survived: Survived, kills: bool) -> None:
    """One more swarm, and what comes now and then."""
    run_recorded(draw, folder, survived)
    if survived.counts["swarms"] % 10 == 5:
        run_recorded(draw, folder, survived, room=8192)
    if kills and survived.counts["swarms"] % 50 == 20:
        run_killed(draw, folder, survived)


def soak(seconds: float, seed: int, *, kills: bool = True) -> Survived:
    """Run for so long; returns what was survived."""
    draw, survived = random.Random(seed), Survived()
    began = time.monotonic()
    next_measurement = 0.0
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        stack.enter_context(RealTime(seed, survived))
        report = stack.enter_context(progress("seconds", int(seconds), False))
        is_asked = stack.enter_context(stopping())  # Ctrl-C shows what there is
        while not survived.wrong and not is_asked():
            elapsed = time.monotonic() - began
            if elapsed >= seconds and survived.counts["swarms"]:
                break
            try:
                run_next(draw, folder, survived, kills)
            except Exception as error:
                survived.wrong.append(f"{type(error).__name__}: {error}")
                traceback.print_exc()
            if elapsed >= next_measurement:
                survived.measure()
                next_measurement = elapsed + min(seconds / 100, 60)
            report(int(time.monotonic() - began) - int(elapsed))
    survived.measure()
    if time.monotonic() - began >= WARM:
        survived.check_growth()
    if virtual.channels:
        survived.wrong.append(f"buses are left open: {sorted(map(str, virtual.channels))}")
    return survived


def main() -> int:
    """Soak as the command line wants it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=time.time_ns() % 2**32)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    print(f"again: python tests/soak.py --hours {args.hours:g} --seed {args.seed}", flush=True)
    began = time.monotonic()
    survived = soak(3600 * args.hours, args.seed)
    if args.json:
        print(json.dumps(vars(survived)))
    else:
        Console(soft_wrap=True).print(survived.table())
        print(f"{time.monotonic() - began:.0f} s")
    return int(bool(survived.wrong))


if __name__ == "__main__":
    sys.exit(main())
