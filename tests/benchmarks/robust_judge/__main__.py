"""Judge the robust filter beside the paper's and none, in hundreds of worlds: make docs/robust_study.csv.

    PYTHONPATH=tests python -m benchmarks.robust_judge docs/robust_study.csv
    PYTHONPATH=tests python -m benchmarks.robust_judge docs/robust_variants.csv --variants

With ``--variants`` it judges variants of the robust filter instead, in some of the same worlds.
``judge.c`` runs the firmware's core in the arena; its comments say what each setting means. The worlds
of a case depend on its name and the seed alone, so all filters meet the same ones. The table has a row for
each case, flaw and filter. Rows that it has already are not made again. All cases take half an hour of
processor time.

Flaws: underconfident robots have a sensor of 0.95 on a floor with f = 0.55, and flawed ones assume 0.55;
overconfident ones have 0.55, 0.95 and 0.95.
"""

from __future__ import annotations

import argparse
import csv
import json
import statistics
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.robust_judge.variants import VARIANTS, write_variant
from mcp_asdf_tools.experiments.plot_panels import median_interval

ROOT = Path(__file__).resolve().parents[3]
CORE = ROOT / "c_ref/src"
ARENA = ROOT / "host_tools/mcp_asdf_tools/world/arena"
SEED = 20261126
FILTERS = {"none": "none", "minus": "asdf-minus", "robust": "robust"}
"""Filters by their names in judge.c, with those of the table."""
COLUMNS = (
    *("group", "case", "flaw", "filter", "trials", "error", "error_low", "error_high", "worst"),
    *("score", "harmed", "unfixed"),
)
"""error: median over trials of the mean |x - f| of honest robots in the last quarter, with its 95 % interval
by order statistics; worst: the largest. score: median of H. harmed: percentage of healthy robots whose b_hat
is more than 0.05 off, mean over the last quarter and all trials; unfixed: the same of the flawed ones."""

RowKey = tuple[str, str, str, str]
"""The group, case, flaw and filter of a row: no two rows of a table have the same."""

FLAWS = {"underconfident": "f=.55 b=.95 fb=.55", "overconfident": "f=.95 b=.55 fb=.95"}
TOPOLOGIES = {"moving": "top=1", "all hear all": "top=0"}


@dataclass(frozen=True)
class Case:
    """Worlds of one kind.

    Attributes:
        group: What the case is about, as a letter; see the functions below.
        name: What is special about it.
        flaw: Which kind of flawed robots it has; empty if it has none of the two.
        settings: Settings of judge.c, as ``key=value`` separated by blanks.
    """

    group: str
    name: str
    flaw: str
    settings: str

    @property
    def trials(self) -> int:
        """Number of trials: fewer for large swarms."""
        if "N=1000" in self.settings:
            return 6
        return 12 if "N=127" in self.settings else 40


def with_flaws(group: str, name: str, settings: str, flaws: Sequence[str] = tuple(FLAWS)) -> Iterator[Case]:
    """Yield a case with each kind of flawed robots."""
    for flaw in flaws:
        yield Case(group, name, flaw, f"{FLAWS[flaw]} {settings}")


def cases_of_rates() -> Iterator[Case]:
    """Yield cases in which sound robots are heard less often than flawed ones: group A."""
    for share in (".2", ".3"):
        for topology, top in TOPOLOGIES.items():
            name = f"{topology}, {share} flawed, sound ones heard with probability .3"
            yield from with_flaws("A", name, f"{top} share={share} hrate=.3")
    yield from with_flaws(
        "A", "moving, .3 flawed, sound ones heard with probability .1", "top=1 share=.3 hrate=.1"
    )
    yield from with_flaws(
        "A", "all hear all, .3 flawed, sound ones send every fifth step", "top=0 share=.3 hper=5"
    )


def cases_of_speeds() -> Iterator[Case]:
    """Yield cases of slow robots, which read a tile several times: group B."""
    for speed in (".02", ".007", ".0014"):
        for share in ("0", ".3"):
            yield from with_flaws(
                "B", f"moving at {speed} m/s, {share} flawed", f"top=1 speed={speed} share={share}"
            )
    for tau in ("100", "4000"):
        for share in ("0", ".3"):
            name = f"moving at .007 m/s, tau {tau}, {share} flawed"
            yield from with_flaws("B", name, f"top=1 speed=.007 tau={tau} share={share}")


def cases_of_graphs() -> Iterator[Case]:
    """Yield cases of static graphs in which each robot has up to four neighbours: group C."""
    for graph, top in (("ring", "top=2"), ("grid", "top=3")):
        for share in ("0", ".1", ".3"):
            yield from with_flaws("C", f"{graph}, {share} flawed", f"{top} share={share}")
        yield from with_flaws("C", f"{graph}, .3 flawed, side by side", f"{top} share=.3 cluster=1")


def cases_of_liars() -> Iterator[Case]:
    """Yield cases with liars, some of which know the rule and say r - s or r + s: group D."""
    for share in ("0", ".3"):
        for liars in (1, 2, 5):
            yield from with_flaws(
                "D", f"moving, {share} flawed, {liars} say 0", f"top=1 share={share} liars={liars}"
            )
        for liars in (3, 5):
            for sign, direction in (("-", -1), ("+", 1)):
                name = f"moving, {share} flawed, {liars} say r {sign} s"
                yield from with_flaws("D", name, f"top=1 share={share} liars={liars} strat=1 dir={direction}")
        for topology, top in TOPOLOGIES.items():
            for liars in (1, 3):
                name = f"{topology}, {share} flawed, {liars} say 0 from others' slots"
                yield from with_flaws("D", name, f"{top} share={share} liars={liars} evict=1")
    yield from with_flaws("D", "all hear all, .3 flawed, 5 say 0", "top=0 share=.3 liars=5")
    yield from with_flaws("D", "all hear all, .3 flawed, 3 say r - s", "top=0 share=.3 liars=3 strat=1")


def cases_of_swarms() -> Iterator[Case]:
    """Yield cases of other sizes, of robots that restart or die, and of ids that share slots: group E."""
    for size in ("3", "5", "10", "127"):
        steps = " steps=10000" if size == "127" else ""
        for topology, top in TOPOLOGIES.items():
            yield from with_flaws(
                "E", f"{topology}, {size} robots, .3 flawed", f"{top} N={size} share=.3{steps}"
            )
    for share in ("0", ".3"):
        yield from with_flaws(
            "E", f"moving, 1000 robots, {share} flawed", f"top=1 N=1000 share={share} steps=10000"
        )
        name = f"all hear all, {share} flawed, a robot restarts in 1 of 1000 steps"
        yield from with_flaws("E", name, f"top=0 share={share} restart=.001")
    for topology, top in TOPOLOGIES.items():
        for name, death in (("a flawed and a sound robot die", 1), ("all flawed robots die", 2)):
            yield from with_flaws("E", f"{topology}, .3 flawed, {name}", f"{top} share=.3 death={death}")
        yield from with_flaws(
            "E", f"{topology}, 40 robots, ids equal modulo 32", f"{top} N=40 ids=1 share=.3"
        )


def cases_of_parameters() -> Iterator[Case]:
    """Yield cases of other shares, periods, losses, densities and floors, and of ageing sensors: group F."""
    for topology, top in TOPOLOGIES.items():
        steps = 40000 if topology == "moving" else 20000
        for share in ("0", ".1", ".3", ".5"):
            yield from with_flaws("F", f"{topology}, {share} flawed", f"{top} share={share} steps={steps}")
        for tau in ("100", "4000"):
            yield from with_flaws("F", f"{topology}, .3 flawed, tau {tau}", f"{top} share=.3 tau={tau}")
    for setting in ("loss=.3", "loss=.9", "D=.25", "D=4"):
        yield from with_flaws("F", f"moving, .3 flawed, {setting}", f"top=1 share=.3 {setting}")
    floor = "share=.3 f2=.95 memory=4096 steps=40000"
    for liars in (0, 2):
        name = f"moving, .3 flawed, the floor changes, {liars} say 0"
        yield from with_flaws("F", name, f"top=1 {floor} liars={liars}", ["underconfident"])
    for ageing, name in ((1, "sensors age alike"), (2, "sensors age each in its own way")):
        yield Case("F", f"moving, {name}", "", f"top=1 f=.75 b=.95 steps=40000 share=0 age={ageing}")


def cases_of_the_paper() -> Iterator[Case]:
    """Yield the paper's eight combinations of f, b and b_hat, with four shares of flawed robots: group G."""
    combinations = ((".95", ".55"), (".95", ".75"), (".55", ".75"), (".55", ".95"))
    for topology, top in (("moving", "top=1 N=20"), ("all hear all", "top=0 N=10")):
        for share in ("0", ".1", ".3", ".5"):
            for fill_ratio in (".55", ".95"):
                for accuracy, b_hat in combinations:
                    name = f"{topology}, {share} flawed, f={fill_ratio} b={accuracy} b_hat={b_hat}"
                    flaw = "underconfident" if accuracy == ".95" else "overconfident"
                    settings = f"{top} steps=40000 share={share} f={fill_ratio} b={accuracy} fb={b_hat}"
                    yield Case("G", name, flaw, settings)


ALL_CASES = (
    *(*cases_of_rates(), *cases_of_speeds(), *cases_of_graphs(), *cases_of_liars()),
    *(*cases_of_swarms(), *cases_of_parameters(), *cases_of_the_paper()),
)


VARIANT_CASES = tuple(
    case
    for case in ALL_CASES
    if case.name
    in {
        "moving, 0 flawed",
        "moving, .3 flawed",
        "moving, .5 flawed",
        "all hear all, .3 flawed",
        "all hear all, .5 flawed",
        "moving at .007 m/s, 0 flawed",
        "moving at .007 m/s, .3 flawed",
        "grid, .3 flawed",
        "ring, .1 flawed",
        "moving, .3 flawed, 3 say r - s",
        "moving, .3 flawed, 5 say 0",
        "moving, 5 robots, .3 flawed",
        "all hear all, 0 flawed, a robot restarts in 1 of 1000 steps",
        "all hear all, .3 flawed, all flawed robots die",
        "moving, 40 robots, ids equal modulo 32",
        "moving, .3 flawed, the floor changes, 0 say 0",
    }
)
"""Cases in which variants of the robust filter are compared with the filter as it is, in the same worlds."""


def compile_judge(folder: Path, core: Path = CORE) -> Path:
    """Compile judge.c with a core, the arena and a t-table into a folder; return the program."""
    program = folder / "judge"
    sources = [Path(__file__).with_name("judge.c"), core / "mcp_asdf.c", *sorted(ARENA.glob("*.c"))]
    table = ROOT / "tables/t_table_omega05_q30.c"
    flags = ["-std=c99", "-D_GNU_SOURCE", "-O2", "-ffp-contract=off", f"-I{core}", f"-I{ARENA}"]
    subprocess.run(["gcc", *flags, "-o", program, *sources, table, "-lm"], check=True)
    return program


def run_case(
    program: Path, case: Case, filters: Sequence[str] = tuple(FILTERS)
) -> dict[str, dict[str, list[float]]]:
    """Run a case with each filter, and return lists by filter and quantity. Each has one number per trial."""
    world = zlib.crc32(f"{case.group} {case.name} {case.flaw}".encode())
    arguments = [f"seed={SEED}", f"world={world}", f"trials={case.trials}", *case.settings.split()]
    command = [str(program), *arguments, *(f"filter={name}" for name in filters)]
    result: dict[str, Any] = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    return result


def rows_of(
    case: Case, results: dict[str, dict[str, list[float]]], labels: Mapping[str, str] = FILTERS
) -> Iterator[dict[str, str]]:
    """Yield the rows of the table for the results of a case.

    ``labels`` are what the table calls the filters, by their names in judge.c.
    """
    for name, label in labels.items():
        yield {
            "group": case.group,
            "case": case.name,
            "flaw": case.flaw,
            "filter": label,
            **summarize(results[name]),
        }


def summarize(values: Mapping[str, Sequence[float]]) -> dict[str, str]:
    """Return the columns from "trials" to "unfixed" of a row.

    ``values`` are lists by quantity, such as "error". Each list has one number per trial.
    """
    errors = values["error"]
    median_error, low, high = median_interval(np.array(errors))
    numbers = {
        "error": median_error,
        "error_low": low,
        "error_high": high,
        "worst": max(errors),
        "score": statistics.median(values["score"]),
        "harmed": statistics.fmean(values["harmed"]),
        "unfixed": statistics.fmean(values["unfixed"]),
    }
    return {"trials": str(len(errors))} | {column: f"{number:.4g}" for column, number in numbers.items()}


def read_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a table, none if there is no such file."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def append_rows(path: Path, rows: Iterator[dict[str, str]]) -> None:
    """Append rows to a table, each as soon as it is made; a new table begins with the COLUMNS."""
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        is_empty = file.tell() == 0  # the position in a file that is opened to append is its end
        if is_empty:
            writer.writeheader()
        for row in rows:
            writer.writerow(row)
            file.flush()


def generate_rows(
    finished: Set[RowKey], cases: Sequence[Case], labels: Mapping[str, str], core: Path = CORE
) -> Iterator[dict[str, str]]:
    """Run the cases that are not finished, and yield their rows.

    ``labels`` are what the table calls the filters, by their names in judge.c, and ``core`` is the folder of
    the firmware that is judged.
    """
    *_others, last_label = labels.values()
    with tempfile.TemporaryDirectory() as folder:
        program = compile_judge(Path(folder), core)
        for number, case in enumerate(cases, 1):
            if (case.group, case.name, case.flaw, last_label) not in finished:
                yield from rows_of(case, run_case(program, case, list(labels)), labels)
                print(f"{last_label}, {number} of {len(cases)}: {case.name} {case.flaw}", file=sys.stderr)


def generate_variant_rows(finished: Set[RowKey]) -> Iterator[dict[str, str]]:
    """Run VARIANT_CASES with each variant of the filter, unless they are finished, and yield their rows."""
    for variant in VARIANTS:
        with tempfile.TemporaryDirectory() as core:
            write_variant(CORE, Path(core), variant)
            yield from generate_rows(finished, VARIANT_CASES, {"robust": variant}, Path(core))


def main() -> None:
    """Run the cases that a table lacks, and append their rows."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("table", type=Path, help="the CSV file to make or to complete")
    parser.add_argument("--variants", action="store_true", help="judge variants of the robust filter")
    arguments = parser.parse_args()
    print(f"seed {SEED}", file=sys.stderr)
    finished = {(row["group"], row["case"], row["flaw"], row["filter"]) for row in read_rows(arguments.table)}
    if arguments.variants:
        append_rows(arguments.table, generate_variant_rows(finished))
    else:
        append_rows(arguments.table, generate_rows(finished, ALL_CASES, FILTERS))


if __name__ == "__main__":
    main()
