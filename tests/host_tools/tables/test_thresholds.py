"""T-tables: every entry against an independent 60-digit oracle, then the files, images and commands.

The oracle shares nothing with the generator: it uses the ``decimal`` module and the closed finite
series of Student's distribution for whole degrees of freedom, and it inverts nothing. An entry e is
the rounding of k_m if and only if P(|T| < t) lies at or below omega for the t that belongs to e - 1/2 and
at or above it for e + 1/2.
"""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import random
import re
import shutil
import struct
import subprocess
from collections.abc import Callable
from decimal import Context, Decimal, localcontext
from functools import lru_cache, partial
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
import scipy.integrate  # type: ignore[import-untyped]
import scipy.stats  # type: ignore[import-untyped]
from elftools.elf.elffile import ELFFile
from elftools.elf.sections import SymbolTableSection
from intelhex import IntelHex  # type: ignore[import-untyped]
from mpmath import mp, mpf  # type: ignore[import-untyped]

from mcp_asdf.table import FRACTION_BITS, MAGIC, Table, checksum
from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.tables import thresholds
from mcp_asdf_tools.tables.image_scan import verify_image
from mcp_asdf_tools.tables.table_files import c_text, check_file, json_text, stem
from mcp_asdf_tools.tables.thresholds import (
    first_difference,
    generate,
    omega_from_word,
    parse_omega,
    worst_threshold_error,
)
from support import draws, slow

ROOT = Path(__file__).resolve().parents[3]
SHIPPED = [("0.05", 127), ("0.05", 30)]
EDGES = [("0.9", 127), ("0.9", 2), ("0.000000001", 127), ("0.000000001", 2), ("0.5", 3), ("0.2", 126)]
PRECISION = Context(prec=60)


def random_cases(count: int, seed: int) -> list[tuple[str, int]]:
    """Omegas of 1 to 9 places in (0, 0.9] with bounds q; the pair in the test's name replays a case."""
    source = random.Random(seed)
    cases = []
    for _ in range(count):
        places = source.randint(1, 9)
        cases.append(
            (f"{source.randint(1, 9 * 10 ** (places - 1)) / 10**places:.9f}", source.randint(2, 127))
        )
    return cases


# --- The oracle ---------------------------------------------------------------------------------------


def arctangent(x: Decimal) -> Decimal:
    """Taylor's series after halving the angle four times."""
    for _ in range(4):
        x = x / (1 + (1 + x * x).sqrt())
    term, total, n = x, Decimal(0), 1
    while abs(term) > Decimal("1e-65"):
        total += term / n
        term, n = -term * x * x, n + 2
    return 16 * total


@lru_cache(maxsize=1)
def pi() -> Decimal:
    """Machin's formula."""
    return 16 * arctangent(Decimal(1) / 5) - 4 * arctangent(Decimal(1) / 239)


def student(t: Decimal, freedom: int) -> Decimal:
    """P(|T| < t) for t >= 0 by the finite series in cos(theta), tan(theta) = t / sqrt(freedom)."""
    cosine_squared = freedom / (freedom + t * t)
    sine = t / (freedom + t * t).sqrt()
    odd = freedom % 2
    term = cosine_squared.sqrt() if odd else Decimal(1)
    total = Decimal(0)
    for power in range(odd, freedom - 1, 2):
        total += term
        term *= cosine_squared * (power + 1) / (power + 2)
    if not odd:
        return sine * total
    return 2 / pi() * (arctangent(t / Decimal(freedom).sqrt()) + sine * total)


def gauss(t: Decimal) -> Decimal:
    """P(|Z| < t) by the all-positive series exp(-t^2/2) sum t^(2n+1) / (2n+1)!!."""
    term, total, n = t, Decimal(0), 1
    while term > Decimal("1e-65"):
        total += term
        n += 2
        term *= t * t / n
    return (2 / pi()).sqrt() * (-t * t / 2).exp() * total


def is_rounded(entry: int, m: int, omega: Decimal, probability: Callable[[Decimal], Decimal]) -> bool:
    """True if ``entry`` is k_m in units of 2**-26 to nearest; ``probability`` is that of (-t, t)."""

    def side(halves: int) -> Decimal:
        k = Decimal(halves) / 2**27
        t = Decimal(m).sqrt() * ((k * (m - 1) / m).sqrt() - 1)
        return probability(max(t, Decimal(0)))

    with localcontext(PRECISION):
        return side(2 * entry - 1) <= omega <= side(2 * entry + 1)


def wrong_entries(table: Table, omega: Decimal) -> list[int]:
    """Indices of the entries that are not correctly rounded."""
    last = table.q - 1
    wrong = [
        index
        for index, entry in enumerate(table.entries[:-1])
        if not is_rounded(entry, index + 2, omega, partial(student, freedom=index + 1))
    ]
    return wrong + ([] if is_rounded(table.entries[last], table.q + 1, omega, gauss) else [last])


@pytest.mark.parametrize("freedom", [*range(1, 12), 29, 30, 125, 126])
def test_the_oracle_agrees_with_scipy(freedom: int) -> None:
    """To 1e-10 only: scipy is off by 3e-11 at t = 1e-6 with one degree of freedom."""
    for t in (0.0, 1e-6, 0.06, 1.0, 6.5):
        with localcontext(PRECISION):
            ours, normal = student(Decimal(t), freedom), gauss(Decimal(t))
        assert float(ours) == pytest.approx(1 - 2 * scipy.stats.t.sf(t, freedom), abs=1e-10)
        assert float(normal) == pytest.approx(math.erf(t / math.sqrt(2)), abs=1e-14)


def test_the_oracle_knows_exact_values() -> None:
    with localcontext(PRECISION):
        assert abs(student(Decimal(1), 1) - Decimal("0.5")) < Decimal("1e-55")
        assert abs(student(Decimal(2) / 3, 2) - Decimal(2) / Decimal(22).sqrt()) < Decimal("1e-55")
        assert abs(pi() - Decimal("3.14159265358979323846264338327950288419716939937510")) < Decimal("1e-49")


@pytest.mark.parametrize(("omega", "q"), SHIPPED)
def test_the_oracle_refuses_a_neighbouring_entry(omega: str, q: int) -> None:
    table = generate(Decimal(omega), q)
    for index in (0, 1, q // 2, q - 2, q - 1):
        for error in (-1, 1):
            entries = list(table.entries)
            entries[index] += error
            wrong = Table(table.omega_word, tuple(entries))
            assert wrong_entries(wrong, Decimal(omega)) == [index]


# --- The generator ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("omega", "q"), [*SHIPPED, *EDGES, *slow(random_cases(24, seed=1))])
def test_every_entry_is_correctly_rounded(omega: str, q: int) -> None:
    table = generate(Decimal(omega), q)
    assert table.q == q
    assert wrong_entries(table, Decimal(omega)) == []


@pytest.mark.parametrize(("omega", "q"), [*SHIPPED, *EDGES, *slow(random_cases(40, seed=2))])
def test_the_firmware_accepts_every_table(omega: str, q: int) -> None:
    table = generate(Decimal(omega), q)
    assert Table.from_words(table.words()) == table
    assert table.omega_word == int(Decimal(omega) * 2**32 + Decimal("0.5"))
    assert len(table.words()) == q + 3


def test_the_largest_omega_needs_all_32_bits() -> None:
    """One more fraction bit, and its first entry would not fit a word."""
    assert 2**31 <= generate(Decimal("0.9"), 2).entries[0] < 2**32


@pytest.mark.parametrize("omega", ["0.000000001", "0.05", "0.9"])
@pytest.mark.parametrize("digits", [40, 80])
def test_thresholds_have_the_digits_they_claim(omega: str, digits: int) -> None:
    fewer = thresholds.true_thresholds(Decimal(omega), digits)
    more = thresholds.true_thresholds(Decimal(omega), digits + 40)
    with mp.workdps(digits + 40):
        worst = max(abs(a / b - 1) for a, b in zip(fewer.of_m, more.of_m, strict=True))
        assert worst < mpf(10) ** (10 - digits)
        assert abs(fewer.normal_score - more.normal_score) < mpf(10) ** (10 - digits)


def near_tie(table: Table, offset: Callable[[int], str]) -> Callable[..., thresholds.Thresholds]:
    """Thresholds whose first one is ``offset(digits)`` units of 2**-26 above a tie."""
    true = thresholds.true_thresholds(table_omega(table))

    def shifted(omega: Decimal, digits: int) -> thresholds.Thresholds:
        with mp.workdps(700):
            first = mp.ldexp(table.entries[0] + mpf("0.5") + mpf(offset(digits)), -FRACTION_BITS)
        return thresholds.Thresholds((first, *true.of_m[1:]), true.normal_score)

    return shifted


def table_omega(table: Table) -> Decimal:
    omega = omega_from_word(table.omega_word)
    assert omega is not None
    return omega


@pytest.mark.parametrize(("sign", "up"), [("", 1), ("-", 0)])
def test_a_value_beside_a_tie_is_computed_to_more_digits(
    monkeypatch: pytest.MonkeyPatch, sign: str, up: int
) -> None:
    """40 digits put the value on the wrong side of the tie, 80 still too close, 160 decide."""
    table = generate(Decimal("0.05"), 3)
    opposite = "" if sign else "-"
    offsets = {40: f"{opposite}1e-25", 80: f"{opposite}1e-62", 160: f"{sign}1e-70"}
    monkeypatch.setattr(thresholds, "true_thresholds", near_tie(table, offsets.__getitem__))
    assert generate.__wrapped__(Decimal("0.05"), 3).entries[0] == table.entries[0] + up


def test_an_exact_tie_ends_in_one_of_its_neighbours(monkeypatch: pytest.MonkeyPatch) -> None:
    table = generate(Decimal("0.05"), 3)
    monkeypatch.setattr(thresholds, "true_thresholds", near_tie(table, lambda digits: "0"))
    assert generate.__wrapped__(Decimal("0.05"), 3).entries[0] - table.entries[0] in (0, 1)


def eq_12_multiple(omega: float, m: int) -> float:
    """t/sqrt(m) + 1 in double precision by scipy."""
    return float(scipy.stats.t.isf((1 - omega) / 2, m - 1)) / math.sqrt(m) + 1


def used_multiple(table: Table, m: int) -> float:
    return math.sqrt(table.entry(m) / 2**FRACTION_BITS * (m - 1) / m)


@pytest.mark.parametrize(("omega", "q"), [*SHIPPED, ("0.9", 2), ("0.5", 100), ("0.05", 126), ("0.3", 60)])
def test_the_stated_error_is_the_worst_of_all_thresholds(omega: str, q: int) -> None:
    table = generate(Decimal(omega), q)
    stated = worst_threshold_error(Decimal(omega), table)
    errors = {m: abs(used_multiple(table, m) / eq_12_multiple(float(omega), m) - 1) for m in range(2, 128)}
    beyond = max((errors[m] for m in range(q + 1, 128)), default=0.0)
    assert stated.rounding == pytest.approx(max(errors[m] for m in range(2, q + 1)), rel=0.02, abs=1e-14)
    assert beyond * (1 - 1e-9) <= stated.beyond_q <= beyond * 1.01
    half_unit = 2.0 ** -(FRACTION_BITS + 1)
    assert stated.rounding <= half_unit / 2 / (table.entries[q - 2] / 2**FRACTION_BITS) * 1.01


def test_the_design_figures() -> None:
    assert worst_threshold_error(Decimal("0.05"), generate(Decimal("0.05"), 30)).beyond_q == 0.0183
    assert worst_threshold_error(Decimal("0.05"), generate(Decimal("0.05"), 127)).beyond_q == 0


# --- Omega --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text", ["0.05", "0.050", ".05", "5e-2", "+0.05", " 0.05 ", "0.05000000000000000000000000"]
)
def test_one_omega_in_many_spellings(text: str) -> None:
    assert str(parse_omega(text)) == "0.05"


BAD_OMEGAS = [
    "0",
    "-0.1",
    "0.95",
    "0.900000001",
    "1e400",
    "nan",
    "sNaN",
    "inf",
    "abc",
    "",
    "5%",
    "0,05",
    "1/20",
]
TOO_FINE = ["0.0500000001", "1e-10", "0.1234567891", "0.05" + 40 * "0" + "1"]


@pytest.mark.parametrize("text", BAD_OMEGAS + TOO_FINE)
def test_a_bad_omega_is_named(text: str) -> None:
    with pytest.raises(UsageError) as caught:
        parse_omega(text)
    assert text in str(caught.value)
    assert "0.05" in str(caught.value), "no way out is shown"


def test_an_omega_is_told_by_its_word() -> None:
    source = random.Random(4)
    for digits in [1, 2, 899_999_999, 900_000_000, *(source.randint(1, 900_000_000) for _ in range(2000))]:
        omega = Decimal(digits).scaleb(-9)
        word = thresholds.omega_word(omega)
        assert omega_from_word(word) == omega, f"digits {digits}"
        for other in (word - 1, word + 1):
            assert omega_from_word(other) in (None, omega - Decimal("1e-9"), omega + Decimal("1e-9"))


@pytest.mark.parametrize("word", [0, 1, round(Decimal("0.900000001") * 2**32), 2**32 - 1])
def test_a_word_that_no_omega_gives(word: int) -> None:
    assert omega_from_word(word) is None


def test_file_names_are_short_and_distinct() -> None:
    assert stem(Decimal("0.05"), 127) == "t_table_omega05_q127"
    assert stem(Decimal("0.10"), 30) == "t_table_omega10_q30"
    assert stem(Decimal("0.125"), 2) == "t_table_omega125_q2"
    assert stem(Decimal("1E-9"), 2) == "t_table_omega000000001_q2"
    omegas = {
        Decimal(n).scaleb(-places) for places in range(1, 5) for n in range(1, 9 * 10 ** (places - 1) + 1)
    }
    assert len({stem(omega, 2) for omega in omegas}) == len(omegas)


# --- The files ----------------------------------------------------------------------------------------


def test_the_shipped_files_are_what_the_generator_makes() -> None:
    expected = {"README.md": (ROOT / "tables" / "README.md").read_bytes()}
    for omega, q in SHIPPED:
        expected[f"{stem(Decimal(omega), q)}.c"] = c_text(Decimal(omega), q).encode()
        expected[f"{stem(Decimal(omega), q)}.json"] = json_text(Decimal(omega), q).encode()
    assert {path.name: path.read_bytes() for path in (ROOT / "tables").iterdir()} == expected


@pytest.mark.parametrize(("omega", "q"), SHIPPED + EDGES)
def test_the_json_tells_the_truth(omega: str, q: int) -> None:
    data = json.loads(json_text(Decimal(omega), q), parse_float=Decimal)
    words = (MAGIC | data["q"], data["omega_word"], *data["entries"], data["checksum"])
    assert Table.from_words(words) == generate(Decimal(omega), q)
    assert data["omega"] == Decimal(omega)
    raw = b"".join(word.to_bytes(4, "little") for word in words)
    assert data["sha256"] == hashlib.sha256(raw).hexdigest()
    assert data["bytes"] == len(raw) == 12 + 4 * q
    assert data["bytes_formula"] == "12 + 4 q"
    assert (data["format_version"], data["fraction_bits"]) == (2, FRACTION_BITS)


def compile_c(source: Path, output: Path) -> bytes:
    """Compile as a strict user would; returns the object file. ``-O1`` leaves out what is not used."""
    compiler = shutil.which("gcc")
    assert compiler, "these tests need gcc"
    strict = ["-std=c99", "-O1", "-pedantic-errors", "-Wall", "-Wextra", "-Werror", "-Wmissing-declarations"]
    command = [compiler, *strict, "-I", str(ROOT / "c_ref" / "src"), "-c", str(source), "-o", str(output)]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    return output.read_bytes()


@pytest.mark.parametrize(("omega", "q"), SHIPPED)
def test_the_object_code_is_the_table_and_nothing_else(omega: str, q: int, tmp_path: Path) -> None:
    name = stem(Decimal(omega), q)
    elf = ELFFile(BytesIO(compile_c(ROOT / "tables" / f"{name}.c", tmp_path / "table.o")))
    symbols = elf.get_section_by_name(".symtab")
    assert isinstance(symbols, SymbolTableSection)
    [symbol] = symbols.get_symbol_by_name(f"mcp_asdf_{name}") or []
    assert symbol["st_size"] == 12 + 4 * q
    assert symbol["st_info"]["bind"] == "STB_GLOBAL"
    section = elf.get_section(symbol["st_shndx"])
    start = symbol["st_value"]
    order = "<" if elf.little_endian else ">"
    words = struct.unpack(f"{order}{3 + q}I", section.data()[start : start + symbol["st_size"]])
    assert words == generate(Decimal(omega), q).words()
    assert section.name == ".rodata"
    taken = {s.name: s["sh_size"] for s in elf.iter_sections() if s["sh_flags"] & 2 and s["sh_size"]}
    assert {name: size for name, size in taken.items() if name in (".text", ".data", ".bss", ".rodata")} == {
        ".rodata": 12 + 4 * q
    }


def test_a_changed_character_anywhere_is_noticed(tmp_path: Path) -> None:
    """Line ends aside; the seed and the place printed on failure replay it."""
    source = random.Random(5)
    for name in ("t_table_omega05_q30.c", "t_table_omega05_q30.json"):
        text = (ROOT / "tables" / name).read_text()
        for place in source.sample([i for i, char in enumerate(text) if char != "\n"], 250):
            changed = source.choice([char for char in '0159aFU/* }],."x' if char != text[place]])
            path = tmp_path / name
            path.write_text(text[:place] + changed + text[place + 1 :])
            assert run_table("--check", path) in (1, 2), f"{name}: {changed!r} at {place} went unnoticed"


def test_line_ends_do_not_matter(tmp_path: Path) -> None:
    path = tmp_path / "t_table_omega05_q30.c"
    path.write_bytes((ROOT / "tables" / path.name).read_bytes().replace(b"\n", b"\r\n"))
    assert check_file(path).problem is None


# --- The command: making and checking -----------------------------------------------------------------


def run_table(*arguments: object) -> int:
    """Run ``mcp-asdf table``."""
    return cli.main(["table", *(str(argument) for argument in arguments)])


def test_making_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "new" / "folder"
    assert run_table("--omega", "0.050", "--neighbours", 30, "--output", folder) == 0
    out = capsys.readouterr().out
    assert "132 bytes (12 + 4 q)" in out
    assert "1.83% for 30 < m <= 127" in out
    assert {path.name for path in folder.iterdir()} == {"t_table_omega05_q30.c", "t_table_omega05_q30.json"}
    for path in folder.iterdir():
        assert str(path) in out
        assert path.read_bytes() == (ROOT / "tables" / path.name).read_bytes()


def test_the_defaults_are_the_papers_omega_and_any_neighbours(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_table("--output", tmp_path, "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    files = facts.pop("files")
    assert facts == json.loads((ROOT / "tables" / "t_table_omega05_q127.json").read_text())
    assert sorted(files) == sorted(str(path) for path in tmp_path.iterdir())


@pytest.mark.parametrize("text", BAD_OMEGAS + TOO_FINE)
def test_a_bad_omega_writes_nothing(text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_table(f"--omega={text}", "--output", tmp_path / "folder") == 2
    err = capsys.readouterr().err
    assert err.startswith("mcp-asdf table: error: omega is ")
    assert text in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("q", ["1", "0", "-5", "128", "1000", "2.5", "many"])
def test_a_bad_bound_writes_nothing(q: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_table(f"--neighbours={q}", "--output", tmp_path / "folder") == 2
    err = capsys.readouterr().err
    assert "mcp-asdf table: error: " in err
    assert q in err
    assert list(tmp_path.iterdir()) == []


def test_an_unwritable_place_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "t_table_omega05_q127.c").mkdir()
    for place in (tmp_path / "file", tmp_path / "file" / "below", tmp_path):
        assert run_table("--output", place) == 2
        assert str(place) in capsys.readouterr().err
    assert {path.name for path in tmp_path.iterdir()} == {"file", "t_table_omega05_q127.c"}


@pytest.mark.parametrize("obstructed", [".c", ".json"])
def test_of_a_pair_both_are_written_or_neither(obstructed: str, tmp_path: Path) -> None:
    stands, obstacle = (tmp_path / f"t_table_omega05_q30{suffix}" for suffix in (".c", ".json"))
    if obstructed == ".c":
        stands, obstacle = obstacle, stands
    stands.write_text("old")
    obstacle.mkdir()
    assert run_table("--neighbours", 30, "--output", tmp_path) == 2
    assert stands.read_text() == "old"
    assert set(tmp_path.iterdir()) == {stands, obstacle}, "something is left over"


@pytest.mark.parametrize("fails_at", [1, 2])
def test_a_pair_that_the_disk_does_not_take_leaves_the_old_one(
    fails_at: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk is full when the first or the second file is written, half of which then stands there."""
    assert run_table("--neighbours", 30, "--output", tmp_path) == 0
    for path in tmp_path.iterdir():
        path.write_text("old")
    before, written = sorted(tmp_path.iterdir()), list[int]()

    def sync(file: int) -> None:
        written.append(file)
        if len(written) == fails_at:
            os.ftruncate(file, os.fstat(file).st_size // 2)
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", sync)
    assert run_table("--neighbours", 30, "--output", tmp_path) == 2
    assert len(written) == fails_at
    assert sorted(tmp_path.iterdir()) == before
    assert {path.read_text() for path in before} == {"old"}


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["--omega", "0.05"],
        ["--check", "tables/t_table_omega05_q30.c", "--omega", "0.05"],
        ["--verify", "image.bin", "--neighbours", "30"],
        ["--check", "tables/t_table_omega05_q30.c", "--output", "."],
        ["--check"],
    ],
)
def test_options_that_make_no_sense_together(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_table(*arguments) == 2
    assert "mcp-asdf table: error: " in capsys.readouterr().err


def test_checking_the_shipped_files(capsys: pytest.CaptureFixture[str]) -> None:
    paths = sorted(path for path in (ROOT / "tables").iterdir() if path.suffix != ".md")
    assert run_table("--check", *paths) == 0
    assert [line.endswith(": ok") for line in capsys.readouterr().out.splitlines()] == [True] * len(paths)


def change_json(path: Path, change: Callable[[dict[str, Any]], None]) -> Path:
    """Write a changed copy of a shipped JSON file to ``path``."""
    data = json.loads((ROOT / "tables" / "t_table_omega05_q30.json").read_text())
    change(data)
    path.write_text(json.dumps(data, indent=2) + "\n")
    return path


@pytest.mark.parametrize(("index", "meaning"), [(0, "m = 2"), (17, "m = 19"), (28, "m = 30"), (29, "m > 30")])
def test_the_first_differing_entry_is_told(
    index: int, meaning: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    right = generate(Decimal("0.05"), 30).entries[index]

    def change(data: dict[str, Any]) -> None:
        data["entries"][index] += 1
        data["entries"][-1] += 1

    json_file = change_json(tmp_path / "changed.json", change)
    c_file = tmp_path / "changed.c"
    original = (ROOT / "tables" / "t_table_omega05_q30.c").read_text()
    c_file.write_text(original.replace(f"0x{right:08X}U", f"0x{right + 2 - (index < 29):08X}U"))
    wrong = right + 2 - (index < 29)
    assert run_table("--check", json_file, c_file) == 1
    for line in capsys.readouterr().out.splitlines():
        assert f"entry {index} ({meaning}): found {wrong} " in line
        assert f"expected {right} " in line
    assert run_table("--check", json_file, "--json") == 1
    [report] = json.loads(capsys.readouterr().out)["tables"]
    assert report["difference"] == {"word": index + 2, "found": wrong, "expected": right}


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda data: data["entries"].pop(), "entry 29 (m > 30): found nothing"),
        (lambda data: data["entries"].append(7), "entry 30 (there should be 30 only): found 7"),
        (lambda data: data.update(omega=0.06), "entry 0 (m = 2)"),
        (lambda data: data.update(q=31), "entry 29 (m = 31)"),
        (lambda data: data.update(checksum=1), "line 16: found '  \"checksum\": 1,'"),
        (lambda data: data.update(extra=1), "line 50: found '  ],'"),
    ],
)
def test_a_changed_json_file_is_told(
    change: Callable[[dict[str, Any]], None], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_table("--check", change_json(tmp_path / "changed.json", change)) == 1
    assert told in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("missing.json", None),
        ("folder.c", "folder"),
        ("empty.json", ""),
        ("list.json", "[]"),
        ("number.json", "1"),
        ("partial.json", '{"omega": 0.05, "q": 30}'),
        ("text.json", '{"omega": 0.05, "q": "30", "entries": []}'),
        ("floats.json", '{"omega": 0.05, "q": 30, "entries": [1.5]}'),
        ("omega.json", '{"omega": 0.95, "q": 30, "entries": []}'),
        ("nan.json", '{"omega": NaN, "q": 30, "entries": []}'),
        ("q.json", '{"omega": 0.05, "q": 1, "entries": []}'),
        ("deep.json", "[" * 100_000),
        ("empty.c", ""),
        ("zero.c", "const uint32_t mcp_asdf_t_table_omega00_q30[34] MCP_ASDF_ROM = {};"),
        ("binary.c", b"\xff\xfe\x00"),
        ("table.txt", "x"),
    ],
)
def test_a_file_that_says_no_table_is_bad_usage(
    name: str, content: str | bytes | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / name
    if content == "folder":
        path.mkdir()
    elif content is not None:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert run_table("--check", path) == 2
    err = capsys.readouterr().err
    assert err.startswith("mcp-asdf table: error: ")
    assert str(path) in err


def test_a_checksum_is_told_only_if_nothing_else_differs() -> None:
    table = generate(Decimal("0.05"), 30)
    words = list(table.words())
    words[-1] ^= 1
    assert str(first_difference(words, table)).startswith("the checksum: ")
    words[-2] ^= 1
    words[-1] = checksum(words[:-1])
    assert str(first_difference(words, table)).startswith("entry 29 (m > 30): ")


# --- The command: verifying images --------------------------------------------------------------------


def image_bytes(order: str = "<", omega: str = "0.05", q: int = 30) -> bytes:
    words = generate(Decimal(omega), q).words()
    return struct.pack(f"{order}{len(words)}I", *words)


def bare_elf(data: bytes, address: int) -> bytes:
    """A big-endian 32-bit ELF with one loaded segment and no sections, as after a thorough strip."""
    ident = b"\x7fELF" + bytes([1, 2, 1]) + bytes(9)
    header = struct.pack(">HHIIIIIHHHHHH", 2, 8, 1, address, 52, 0, 0, 52, 32, 1, 40, 0, 0)
    segment = struct.pack(">IIIIIIII", 1, 84, address, address, len(data), len(data), 4, 4)
    return ident + header + segment + data


def write_hex(path: Path, data: bytes, address: int) -> Path:
    image = IntelHex()
    image.puts(address, data)
    image.write_hex_file(str(path))
    return path


def write_images(folder: Path, data: bytes) -> list[Path]:
    """The same bytes in every format."""
    plain, elf = folder / "image.bin", folder / "image.elf"
    plain.write_bytes(data)
    elf.write_bytes(bare_elf(data, 0x08000000))
    return [plain, elf, write_hex(folder / "image.hex", data, 0x08000000)]


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("offset", [0, 1, 64])
def test_tables_are_found_in_every_format(
    order: str, offset: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = bytes(offset) + image_bytes(order) + b"\xff" * 7 + image_bytes(order, "0.125", 2)
    paths = write_images(tmp_path, data)
    assert run_table("--verify", *paths) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 6
    name = "little-endian" if order == "<" else "big-endian"
    assert lines[0] == f"{paths[0]}: {offset:#x} ({name}): omega 0.05, q 30: ok"
    assert lines[3].endswith(f"segment+{offset + 139:#x} ({name}): omega 0.125, q 2: ok")
    assert lines[4] == f"{paths[2]}: {0x08000000 + offset:#x} ({name}): omega 0.05, q 30: ok"


def test_a_linked_program_and_its_object_are_verified(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "program.c"
    source.write_text(
        '#include "mcp_asdf.h"\n'
        "extern const uint32_t mcp_asdf_t_table_omega05_q127[130];\n"
        f"int main(void) {{ return mcp_asdf_t_table_omega05_q127[0] == {MAGIC | 127:#x}U ? 0 : 1; }}\n"
    )
    compile_c(ROOT / "tables" / "t_table_omega05_q127.c", tmp_path / "table.o")
    compile_c(source, tmp_path / "program.o")
    program = tmp_path / "program"
    objects = [str(tmp_path / "table.o"), str(tmp_path / "program.o")]
    subprocess.run(["gcc", *objects, "-o", str(program)], check=True)
    assert subprocess.run([str(program)], check=False).returncode == 0
    subprocess.run(["gcc", "-s", *objects, "-o", str(tmp_path / "stripped")], check=True)
    for path in (program, tmp_path / "table.o", tmp_path / "stripped"):
        assert run_table("--verify", path, "--json") == 0
        report = json.loads(capsys.readouterr().out)
        assert report["ok"]
        [found] = report["tables"]
        assert (found["omega"], found["q"], found["problem"]) == (0.05, 127, None)
        assert ".rodata+0x" in found["place"]
    assert run_table("--verify", tmp_path / "program.o") == 1, "the magic word alone is not a table"


def test_a_flipped_bit_anywhere_in_the_table_is_noticed(tmp_path: Path) -> None:
    data = image_bytes()
    path = tmp_path / "image.bin"
    for bit in range(8 * len(data)):
        flipped = bytearray(data)
        flipped[bit // 8] ^= 1 << bit % 8
        path.write_bytes(flipped)
        assert any(finding.problem for finding in verify_image(path)), f"bit {bit}"


@pytest.mark.parametrize("damaged", [slice(2, 17), slice(17, 32), slice(1, 2), slice(32, 33)])
def test_a_damaged_table_is_found_beside_a_sound_one(damaged: slice, tmp_path: Path) -> None:
    """Erased flash: up to half of the entries, the word of omega, the checksum."""
    words = list(generate(Decimal("0.05"), 30).words())
    words[damaged] = [2**32 - 1] * len(words[damaged])
    (tmp_path / "image.bin").write_bytes(image_bytes() + words_of(words[0], *words[1:]))
    sound, other = verify_image(tmp_path / "image.bin")
    assert sound.problem is None
    assert other.q == 30
    assert other.problem is not None


def test_a_table_of_wrong_entries_with_its_checksum_is_found(tmp_path: Path) -> None:
    """Magic and checksum are enough, also where no entry could be one."""
    words = [MAGIC | 30, 0x0CCCCCCD, *[0] * 30]
    (tmp_path / "image.bin").write_bytes(words_of(*words, checksum(words)))
    [finding] = verify_image(tmp_path / "image.bin")
    assert (finding.omega, finding.q) == (Decimal("0.05"), 30)
    assert finding.problem is not None
    assert finding.problem.startswith("entry 0 (m = 2): found 0 ")


@pytest.mark.parametrize(("omega", "q"), EDGES)
def test_every_table_is_found_without_its_checksum(omega: str, q: int, tmp_path: Path) -> None:
    data = image_bytes(omega=omega, q=q)
    (tmp_path / "image.bin").write_bytes(data[:-4] + bytes(4))
    [finding] = verify_image(tmp_path / "image.bin")
    assert finding.omega == Decimal(omega)
    assert str(finding.problem).startswith("the checksum: found 0 ")


def test_a_wrong_entry_in_an_image_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Even where the checksum was made to fit."""
    words = list(generate(Decimal("0.05"), 30).words())
    words[8] -= 1
    words[-1] = checksum(words[:-1])
    assert Table.from_words(words).q == 30, "the firmware would take it"
    for path in write_images(tmp_path, struct.pack("<33I", *words)):
        assert run_table("--verify", path) == 1
        assert f"entry 6 (m = 8): found {words[8]} " in capsys.readouterr().out


def test_an_omega_word_off_the_grid_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = list(generate(Decimal("0.05"), 30).words())
    words[1] += 1
    (tmp_path / "image.bin").write_bytes(struct.pack("<33I", *words))
    assert run_table("--verify", tmp_path / "image.bin") == 1
    assert "0x0ccccccE".lower() in capsys.readouterr().out.lower()


def test_a_table_cut_short_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = image_bytes()
    for length in range(0, len(data)):
        path = tmp_path / "image.bin"
        path.write_bytes(data[:length])
        assert run_table("--verify", path) == 1
        told = capsys.readouterr().out
        half = 4 * (2 + 15)  # magic and q, omega, and half of the entries
        assert ("no t-table found" if length < half else "found nothing") in told, length


def words_of(first: int, *others: int) -> bytes:
    return struct.pack(f"<{1 + len(others)}I", first, *others)


ENTRIES = generate(Decimal("0.05"), 127).entries
NO_TABLE = [
    b"",
    b"nothing here",
    b"MCT",
    b"TCM",
    b"ITCM and DTCM: memories of a Cortex-M7, and MCTA in capitals" * 9,
    words_of(MAGIC, 0x0CCCCCCD, *ENTRIES),  # q = 0
    words_of(MAGIC | 1, 0x0CCCCCCD, *ENTRIES),
    words_of(MAGIC | 128, 0x0CCCCCCD, *ENTRIES),
    words_of(MAGIC | 255, 0x0CCCCCCD, *ENTRIES, *ENTRIES, *ENTRIES),
    words_of(MAGIC + 0x100 | 30, 0x0CCCCCCD, *ENTRIES),
    words_of(MAGIC - 0x100 | 30, 0x0CCCCCCD, *ENTRIES),
    words_of(MAGIC | 30, *[0] * 31),
    words_of(MAGIC | 30, *[2**32 - 1] * 31),
    words_of(MAGIC | 30, 0x0CCCCCCD, *ENTRIES[:14], *[0] * 17),
    words_of(MAGIC | 30, 0x0CCCCCCD, *[1 << FRACTION_BITS] * 30),
]


@pytest.mark.parametrize("content", NO_TABLE)
def test_an_image_without_a_table_fails(
    content: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "image.bin").write_bytes(content)
    assert run_table("--verify", tmp_path / "image.bin") == 1
    assert "no t-table found" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("missing.elf", None),
        ("short.elf", b"\x7fELF\x01\x01"),
        ("text.hex", b"this is not Intel HEX\n"),
        ("binary.hex", b"\xff\xfe"),
        ("checksum.hex", b":0400000001020304F3\n"),
    ],
)
def test_an_image_that_cannot_be_read_is_bad_usage(
    name: str, content: bytes | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    assert run_table("--verify", tmp_path / name) == 2
    assert str(tmp_path / name) in capsys.readouterr().err


def s_records(data: bytes, address: int) -> bytes:
    """Motorola S-records with 32-bit addresses, as ``objcopy -O srec`` writes them."""

    def record(kind: str, body: bytes) -> str:
        counted = bytes([len(body) + 1]) + body
        return f"S{kind}{counted.hex()}{~sum(counted) & 0xFF:02x}".upper()

    lines = [record("0", b"\0\0image")]
    for at in range(0, len(data), 16):
        lines.append(record("3", (address + at).to_bytes(4, "big") + data[at : at + 16]))
    return "\r\n".join([*lines, record("7", address.to_bytes(4, "big")), ""]).encode()


@pytest.mark.parametrize("name", ["image.hex", "image.IHX", "image.txt", "image", "image.bin"])
def test_intel_hex_is_told_by_its_content(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_hex(tmp_path / name, bytes(3) + image_bytes(), 0x08000000)
    assert run_table("--verify", path) == 0
    assert capsys.readouterr().out == f"{path}: 0x8000003 (little-endian): omega 0.05, q 30: ok\n"
    path.write_bytes(b"\r\n" + path.read_bytes())
    assert run_table("--verify", path) == 0, "an empty line comes first"


@pytest.mark.parametrize("name", ["firmware.srec", "firmware.s19", "firmware.hex", "firmware"])
def test_a_format_of_text_that_is_not_read_is_told(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A table in S-records is not missing: it is not looked for. What the message says to do finds it."""
    path, binary = tmp_path / name, tmp_path / "converted"
    path.write_bytes(s_records(image_bytes(), 0x08000000))
    assert run_table("--verify", path) == 2
    told = capsys.readouterr().err
    assert f"{path} is text, but not Intel HEX" in told
    command = re.search(r"(objcopy -I srec -O binary) makes", told)
    assert command
    subprocess.run([*command[1].split(), str(path), str(binary)], check=True)
    assert run_table("--verify", binary) == 0
    for other in (b"@0800 54 50 43 4D\nq\n", b":zz is no record\n", b"Only words.\n", b"\n"):
        path.write_bytes(other)
        assert run_table("--verify", path) == 2, other


def test_uf2_is_not_searched(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its blocks of 256 bytes would tear a table apart."""
    data = bytes(200) + image_bytes() + bytes(176)
    head = struct.pack("<8I", 0x0A324655, 0x9E5D5157, 0, 0x10000000, 256, 0, 2, 0)
    blocks = [head + data[at : at + 256] + bytes(220) + struct.pack("<I", 0x0AB16F30) for at in (0, 256)]
    (tmp_path / "firmware.uf2").write_bytes(b"".join(blocks))
    assert run_table("--verify", tmp_path / "firmware.uf2") == 2
    assert "is in UF2" in capsys.readouterr().err


@pytest.mark.random
def test_a_damaged_elf_never_ends_in_a_traceback(tmp_path: Path) -> None:
    """Cut anywhere it holds no sound table; with headers overwritten it may, but reading it ends cleanly."""
    whole = compile_c(ROOT / "tables" / "t_table_omega05_q30.c", tmp_path / "table.o")
    path = tmp_path / "damaged.elf"
    source = random.Random(6)
    for length in source.sample(range(4, len(whole)), draws(150)):
        path.write_bytes(whole[:length])
        assert run_table("--verify", path) in (1, 2), f"cut to {length}"
    headers = [*range(4, 64), *range(len(whole) - 64 * 12, len(whole))]
    for _ in range(draws(1000)):
        damaged = bytearray(whole)
        for place in source.sample(headers, 3):
            damaged[place] = source.choice([0xFF, source.randrange(256)])
        path.write_bytes(damaged)
        assert run_table("--verify", path) in (0, 1, 2)


# --- The page -----------------------------------------------------------------------------------------


def page_rows(heading: str) -> list[dict[str, str]]:
    """The rows of the first table below a heading of docs/tables.md, by column."""
    page = (ROOT / "docs" / "tables.md").read_text()
    below = page[page.index(f"## {heading}\n") :]
    lines = re.findall(r"(?:^\|.*\n)+", below, re.MULTILINE)[0].splitlines()
    titles, _, *rows = ([cell.strip() for cell in line.strip("|").split("|")] for line in lines)
    return [dict(zip(titles, row, strict=True)) for row in rows]


def test_the_thresholds_on_the_page() -> None:
    rows = page_rows("Choosing omega")
    assert len(rows) == 6
    for row in rows:
        m = int(row.pop("m"))
        for title, cell in row.items():
            multiple = eq_12_multiple(float(title.removeprefix("omega ")), m)
            assert cell == f"{multiple:.4f} / {multiple**2 * m / (m - 1):.4f}", (m, title)


def rejection_share(omega: float, m: int, distance: float) -> float:
    """P(|mean - own| > multiple S) for an own estimate ``distance`` sigma from the true mean: S is
    sigma times a chi variable over sqrt(m - 1), independent of the mean."""
    multiple, root = eq_12_multiple(omega, m), math.sqrt(m - 1)
    normal, chi = scipy.stats.norm(scale=1 / math.sqrt(m)), scipy.stats.chi(m - 1)

    def share(s: float) -> float:
        tails = normal.sf(multiple * s - distance) + normal.sf(multiple * s + distance)
        return float(chi.pdf(s * root) * root * tails)

    return float(scipy.integrate.quad(share, 0, 6, points=[1], limit=200)[0])


@pytest.mark.slow
def test_the_rejections_on_the_page() -> None:
    distances = {"1/2 sigma": 0.5, "1 sigma": 1, "3/2 sigma": 1.5, "2 sigma": 2, "3 sigma": 3}
    rows = page_rows("What a choice means for one test")
    assert len(rows) == 6
    for row in rows:
        m, omega = int(row["m"]), float(row["omega"])
        spread = math.sqrt(1 + 1 / m)  # of the difference of two that vary
        same = 2 * scipy.stats.t.sf(eq_12_multiple(omega, m) / spread, m - 1)
        assert row["one of them"] == f"{same:.1%}"
        for title, distance in distances.items():
            assert row[title] == f"{rejection_share(omega, m, distance):.1%}", (m, omega, title)


@pytest.mark.slow
def test_the_costs_on_the_page() -> None:
    rows = page_rows("Choosing q")
    assert len(rows) == 5
    for row in rows:
        q = int(row.pop("q"))
        assert row.pop("bytes") == str(4 * len(generate(Decimal("0.05"), q).words()))
        for title, cell in row.items():
            omega = Decimal(title.removeprefix("omega "))
            assert cell == f"{worst_threshold_error(omega, generate(omega, q)).beyond_q:.2%}"
