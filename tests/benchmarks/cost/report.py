"""The tables of docs/cost.md and of the README, from the figures."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from host_tools.files import write_atomically

from .budgets import BUDGETS, measured, most, stack_of_tick
from .demo import CLOCK, FLASH, RAM
from .images import LEVELS, ROOT
from .measurement import TICK_CALLS, Figures
from .robots import UPDATED

README, PAGE = ROOT / "README.md", ROOT / "docs" / "cost.md"
USUAL = "step, m = 10"
"""The step that stands for all in short tables."""
_ON_AVR = "ATmega328P"
_UNITS = ("instructions", "cycles")


def pages(figures: Figures) -> dict[Path, dict[str, str]]:
    """For every page what stands between its markers."""
    return {
        README: {"cost table": _short(figures)},
        PAGE: {
            "compilers": _compilers(figures),
            "budgets": _budgets(figures),
            "memory": _memory(figures),
            **{f"calls on {name}": _calls(levels) for name, levels in figures["targets"].items()},
            "baselines": _baselines(figures),
            "stack": _stack(figures),
            "bounds": _bounds(figures),
            "longest ways": _longest(figures),
            "whole firmware": _whole_firmware(figures),
        },
    }


def fill(text: str, sections: dict[str, str]) -> str:
    """The text with new sections between ``<!-- NAME -->`` and ``<!-- end of NAME -->``.

    Raises ValueError if a section has no such lines.
    """
    for name, section in sections.items():
        start, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
        if text.count(start) != 1 or text.count(end) != 1:
            raise ValueError(f"there is no {start} or {end}, or more than one")
        head, rest = text.split(start)
        text = f"{head}{start}\n{section}\n{end}{rest.split(end)[1]}"
    return text


def write(figures: Figures) -> None:
    """Write all pages. Raises UsageError if one cannot be written, ValueError as ``fill`` does."""
    for path, sections in pages(figures).items():
        write_atomically(path, fill(path.read_text(encoding="utf-8"), sections))


# ---- Tables ----


def _table(head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    lines = ["| " + " | ".join(map(str, cells)) + " |" for cells in (list(head), *rows)]
    return "\n".join([lines[0], "|---" * (lines[0].count("|") - 1) + "|", *lines[1:]])


def _short(figures: Figures) -> str:
    targets = figures["targets"]
    cores = [levels["-O2"]["firmware"] for levels in targets.values()]

    def instructions(title: str, mean_of: str, most_of: str) -> list[str]:
        spans = [
            f"{core['calls'][mean_of]['instructions'][1]:.0f} ({most(core['calls'], most_of)})"
            for core in cores
        ]
        return [title, *spans]

    rows = [
        instructions("step with 10 neighbours: instructions, mean (most)", USUAL, "step"),
        ["step: cycles, most", *(_cycles(name, core) for name, core in zip(targets, cores, strict=True))],
        instructions("receive: instructions, mean (most)", "receive", "receive"),
        instructions("x: instructions, mean (most)", "x", "x"),
        instructions("step with test and update: instructions, mean (most)", UPDATED, UPDATED),
        *(
            [f"plain {kind} C for step and x: times as many", *_ratios(targets, kind)]
            for kind in ("double", "float")
        ),
        ["code: bytes of flash, -Os (-O2)", *map(_code, targets.values())],
        ["RAM of a robot, bytes", *(core["ram"] for core in cores)],
        ["deepest stack of a tick, bytes", *(stack_of_tick(core) for core in cores)],
    ]
    return f"{_table(['at -O2', *targets], rows)}\n\n{_kilobot(figures)}"


def _kilobot(figures: Figures) -> str:
    demo = figures["demo"]
    steps = CLOCK // most(figures["targets"][_ON_AVR]["-Os"]["firmware"]["calls"], "step", "cycles")
    flash, ram = demo["flash"] / FLASH, (demo["variables"] + demo["stack"]) / RAM
    fixed, per_entry = figures["table"]
    compilers = ", ".join(sorted(set(figures["compilers"].values())))
    return (
        f"With {compilers}. ~ marks estimates from above.\n"
        f"A t-table takes {fixed} + {per_entry} q bytes of flash. "
        f"A whole Kilobot (ATmega328P, -Os: core, t-table, frames, main loop, radio)\n"
        f"takes {flash:.0%} of its flash and {ram:.0%} of its RAM, stack included; "
        f"at 8 MHz it can step {steps} times a second."
    )


def _cycles(target: str, core: Figures) -> str:
    return f"{'' if target == _ON_AVR else '~ '}{most(core['calls'], 'step', 'cycles')}"


def _ratios(targets: Figures, kind: str) -> list[str]:
    return [_ratio(levels["-O2"], kind) for levels in targets.values()]


def _ratio(figures: Figures, kind: str) -> str:
    """Instructions of the baseline's step, which forms x, in those of the firmware's step and x."""
    if kind not in figures:
        return "none"
    calls = figures["firmware"]["calls"]
    own = calls[USUAL]["instructions"][1] + calls["x"]["instructions"][1]
    return f"{figures[kind]['calls'][USUAL]['instructions'][1] / own:.1f}"


def _code(levels: Figures) -> str:
    return f"{levels['-Os']['flash']['least']} ({levels['-O2']['flash']['least']})"


def _compilers(figures: Figures) -> str:
    return _table(["target", "compiler"], figures["compilers"].items())


def _budgets(figures: Figures) -> str:
    rows = [
        [budget.target, budget.what, budget.asked, budget.agreed, measured(budget, figures)]
        for budget in BUDGETS
    ]
    return _table(["target", "what", "asked", "agreed", "measured"], rows)


def _memory(figures: Figures) -> str:
    fixed, per_entry = figures["table"]
    rows = [
        [
            name,
            *(levels[level]["flash"][kind] for kind in ("least", "whole") for level in LEVELS),
            levels["-O2"]["firmware"]["ram"],
            *(stack_of_tick(levels[level]["firmware"]) for level in LEVELS),
        ]
        for name, levels in figures["targets"].items()
    ]
    head = [f"{what}, {level}" for what in ("code", "all code") for level in LEVELS]
    table = _table(["bytes", *head, "RAM", *(f"stack, {level}" for level in LEVELS)], rows)
    return f"{table}\n\nA t-table takes {fixed} + {per_entry} q bytes: {fixed + 30 * per_entry} for q = 30."


def _calls(levels: Figures) -> str:
    head = [f"{level}: {unit}" for level in LEVELS for unit in _UNITS]
    names = levels["-O2"]["firmware"]["calls"]
    rows = [
        [
            name,
            *(_span(levels[level]["firmware"]["calls"][name][unit]) for level in LEVELS for unit in _UNITS),
        ]
        for name in sorted(names, key=_order)
    ]
    return _table(["call", *head], rows)


def _order(name: str) -> tuple[int, int]:
    firsts = (
        "observe",
        "receive",
        "settle",
        "settle with test",
        "step, m",
        "step with test",
        UPDATED,
        "x",
        "encode",
        "decode",
    )
    number = re.search(r"\d+", name)
    first = max((first for first in firsts if name.startswith(first)), key=len)
    return firsts.index(first), int(number[0]) if number else 0


def _span(span: list[float]) -> str:
    least, mean, most_ = span
    return f"{least:.0f} / {mean:.0f} / {most_:.0f}"


def _baselines(figures: Figures) -> str:
    rows = []
    for name, levels in figures["targets"].items():
        both = levels["-O2"]
        for kind in ("double", "float"):
            if kind in both:
                rows.append([name, kind, *_compared(both, levels["-Os"], kind)])
    head = ("target", "type", "step and x", "receive", f"{UPDATED} and x", "flash at -Os", "RAM", "stack")
    return _table(head, rows)


def _compared(figures: Figures, small: Figures, kind: str) -> list[str]:
    own, plain = figures["firmware"], figures[kind]

    def cell(own_value: float, plain_value: float) -> str:
        return f"{plain_value:.0f} : {own_value:.0f} = {plain_value / own_value:.1f}"

    def mean(robot: Figures, *names: str) -> float:
        return sum(float(robot["calls"][name]["cycles"][1]) for name in names)

    return [
        cell(mean(own, USUAL, "x"), mean(plain, USUAL)),
        cell(mean(own, "receive"), mean(plain, "receive")),
        cell(mean(own, UPDATED, "x"), mean(plain, UPDATED)),
        cell(small["flash"]["least"], small["flash"][kind]),
        cell(own["ram"], plain["ram"]),
        cell(stack_of_tick(own), plain["stack"]),
    ]


def _stack(figures: Figures) -> str:
    targets = figures["targets"]
    names = next(iter(targets.values()))["-O2"]["firmware"]["stack"]
    rows = [
        [
            name,
            *(
                " / ".join(str(levels[level]["firmware"]["stack"][name][0]) for level in LEVELS)
                for levels in targets.values()
            ),
        ]
        for name in names
    ]
    return _table([f"bytes at {' / '.join(LEVELS)}", *targets], rows)


def _bounds(figures: Figures) -> str:
    rows = []
    for name, levels in figures["targets"].items():
        series = levels["-O2"]["firmware"]["series"]
        spans = [
            f"{min(low for _, low, _ in points)} .. {max(high for _, _, high in points)}"
            for points in (series["step"], series["receive"], series["settle"])
        ]
        rows.append([name, series["unit"], *spans])
    return _table(
        ["target", "unit", "step, t from 1 to 2^32", "receive, message 1 to 127", "settle, m from 1 to 127"],
        rows,
    )


def _longest(figures: Figures) -> str:
    rows = [
        [name, *(_ways(levels[level]["firmware"], call) for call in TICK_CALLS for level in LEVELS)]
        for name, levels in figures["targets"].items()
    ]
    return _table(["instructions", *(f"{call}, {level}" for call in TICK_CALLS for level in LEVELS)], rows)


def _ways(core: Figures, call: str) -> str:
    longest = core["longest"][call]
    seen = max(
        most(core["calls"], name) for name in core["calls"] if name.split(",")[0].split(" ")[0] == call
    )
    return "loops" if longest is None else f"{longest} ({seen})"


def _whole_firmware(figures: Figures) -> str:
    demo, small = figures["demo"], figures["targets"][_ON_AVR]["-Os"]["firmware"]["calls"]
    ram = demo["variables"] + demo["stack"]
    step, hear = (
        most(small, "step", "cycles"),
        most(small, "decode", "cycles") + most(small, "receive", "cycles"),
    )
    tick = step + most(small, "encode", "cycles") + 10 * hear
    rows = [
        ["flash", f"{demo['flash']} of {FLASH} bytes", f"{demo['flash'] / FLASH:.0%}"],
        [
            "RAM: variables and deepest stack",
            f"{demo['variables']} + {demo['stack']} of {RAM} bytes",
            f"{ram / RAM:.0%}",
        ],
        ["steps a second at 8 MHz, at least", f"{CLOCK} / {step} cycles", f"{CLOCK // step}"],
        ["ticks with 10 neighbours a second, at least", f"{CLOCK} / {tick} cycles", f"{CLOCK // tick}"],
        ["the same tick at 10 a second", f"{tick} of {CLOCK // 10} cycles", f"{10 * tick / CLOCK:.1%}"],
    ]
    return _table(["ATmega328P at -Os", "", ""], rows)
