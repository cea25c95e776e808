"""Files of a t-table, and tables in built images: what is sound is found, and every damage is told."""

from __future__ import annotations

import hashlib
import json
import random
import struct
from decimal import Decimal
from pathlib import Path

import pytest
from intelhex import IntelHex  # type: ignore[import-untyped]

from mcp_asdf.table import FRACTION_BITS, MAGIC, Table, checksum
from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.tables.image_scan import verify_image
from mcp_asdf_tools.tables.table_files import c_text, check_file, json_text, stem
from mcp_asdf_tools.tables.thresholds import generate
from support import ROOT, run

Capture = pytest.CaptureFixture[str]
SHIPPED = [("0.05", 127), ("0.05", 30)]
TABLE = generate(Decimal("0.05"), 30)
C_FILE = ROOT / "tables/t_table_omega05_q30.c"


def run_table(*arguments: object) -> int:
    """Run ``mcp-asdf table``."""
    return cli.main(["table", *map(str, arguments)])


# --- Files --------------------------------------------------------------------------------------------


def test_file_names_are_short_and_distinct() -> None:
    names = {"0.05": "omega05", "0.10": "omega10", "0.125": "omega125", "1E-9": "omega000000001"}
    assert all(stem(Decimal(omega), 2) == f"t_table_{name}_q2" for omega, name in names.items())
    grid = [(n, places) for places in range(1, 5) for n in range(1, 9 * 10 ** (places - 1) + 1)]
    omegas = {Decimal(n).scaleb(-places) for n, places in grid}
    assert len({stem(omega, 2) for omega in omegas}) == len(omegas)


def test_the_shipped_files_are_what_the_generator_makes(capsys: Capture) -> None:
    expected = {"README.md": (ROOT / "tables/README.md").read_bytes()}
    for omega, q in SHIPPED:
        expected[f"{stem(Decimal(omega), q)}.c"] = c_text(Decimal(omega), q).encode()
        expected[f"{stem(Decimal(omega), q)}.json"] = json_text(Decimal(omega), q).encode()
    assert {path.name: path.read_bytes() for path in (ROOT / "tables").iterdir()} == expected
    data = json.loads(json_text(Decimal("0.05"), 30))
    words = (MAGIC | data["q"], data["omega_word"], *data["entries"], data["checksum"])
    assert Table.from_words(words) == TABLE
    assert data["sha256"] == hashlib.sha256(packed(words)).hexdigest()
    assert run_table("--check", *(ROOT / "tables").glob("t_*")) == 0
    assert all(line.endswith(": ok") for line in capsys.readouterr().out.splitlines())


def test_a_changed_character_anywhere_is_noticed(tmp_path: Path, capsys: Capture) -> None:
    """Line ends aside; the place printed on failure replays it."""
    source = random.Random(5)
    for name in (C_FILE.name, f"{C_FILE.stem}.json"):
        text, path = (ROOT / "tables" / name).read_text(), tmp_path / name
        for place in source.sample([i for i, char in enumerate(text) if char != "\n"], 60):
            changed = source.choice([char for char in '0159aFU/* }],."x' if char != text[place]])
            path.write_text(text[:place] + changed + text[place + 1 :])
            assert run_table("--check", path) in (1, 2), f"{name}: {changed!r} at {place} went unnoticed"
        for whole in (text[:-1], text + "\n"):
            path.write_text(whole)
            assert check_file(path).problem is not None
    path.write_bytes(text.replace("\n", "\r\n").encode())
    assert check_file(path).problem is None
    path.write_text(text.replace(f" {TABLE.entries[17]},", " 7,"))
    capsys.readouterr()
    assert run_table("--check", C_FILE, path) == 1
    expected = f"line 37: found '    7,', expected '    {TABLE.entries[17]},'"
    lines = [f"{C_FILE}: omega 0.05, q 30: ok", f"{path}: omega 0.05, q 30: {expected}"]
    assert capsys.readouterr().out.splitlines() == lines


def test_making_a_table(tmp_path: Path, capsys: Capture) -> None:
    folder = tmp_path / "new/folder"
    assert run_table("--omega", "0.050", "--neighbours", 30, "--output", folder) == 0
    out = capsys.readouterr().out
    assert out.startswith("omega 0.05, q 30: 132 bytes (12 + 4 q)\nworst threshold error: ")
    assert " by rounding, 1.83% for 30 < m <= 127\n" in out
    assert {path.name for path in folder.iterdir()} == {C_FILE.name, f"{C_FILE.stem}.json"}
    for path in folder.iterdir():
        assert f"wrote {path}\n" in out
        assert path.read_bytes() == (ROOT / "tables" / path.name).read_bytes()
    assert run_table("--output", tmp_path / "default", "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert sorted(facts.pop("files")) == sorted(map(str, (tmp_path / "default").iterdir()))
    assert facts == json.loads((ROOT / "tables/t_table_omega05_q127.json").read_text())


OMEGAS = ("0", "-0.1", "0.95", "0.900000001", "1e400", "nan", "sNaN", "inf", "abc", "", "5%", "1e-10")
BOUNDS = ("1", "-5", "128", "2.5", "many")


@pytest.mark.parametrize(
    "option", [*(f"--omega={each}" for each in OMEGAS), *(f"--neighbours={q}" for q in BOUNDS)]
)
def test_a_bad_value_writes_nothing(option: str, tmp_path: Path, capsys: Capture) -> None:
    assert run_table(option, "--output", tmp_path / "folder") == 2
    err = capsys.readouterr().err
    assert err.startswith("mcp-asdf table: error: ") and option.partition("=")[2] in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("", "one of the arguments --output --check --verify is required"),
        (f"--check {C_FILE} --omega 0.05", "--omega and --neighbours go with --output"),
        ("--verify image.bin --neighbours 30", "--omega and --neighbours go with --output"),
        (f"--check {C_FILE} --output .", "not allowed with argument"),
        ("--output no_symbol.c", "cannot write no_symbol.c: File exists; choose a folder"),
        ("--check missing.json", "cannot read missing.json: No such file"),
        ("--check folder.c", "cannot read folder.c: Is a directory"),
        ("--check no_symbol.c", "no_symbol.c names no array mcp_asdf_t_table_omega.._q..; make it anew"),
        ("--check omega.json", "omega.json: omega is 0.95; it must be above 0"),
        ("--check q.c", "q.c: the number of neighbours is 1; it must be 2 to 127"),
        ("--check binary.c", "binary.c is not a text file; for a built image use --verify"),
        ("--check table.txt", "table.txt is neither .c nor .json; for a built image use --verify"),
        ("--verify missing.elf", "cannot read missing.elf: No such file"),
        ("--verify binary.elf", "cannot read binary.elf: "),
        ("--verify wrong.hex", "cannot read wrong.hex: "),
    ],
)
def test_what_cannot_be_done_is_refused(
    line: str, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("folder.c").mkdir()
    Path("no_symbol.c").touch()
    Path("omega.json").write_text('"mcp_asdf_t_table_omega95_q30"')
    Path("q.c").write_text("mcp_asdf_t_table_omega05_q1")
    Path("binary.c").write_bytes(b"\xff\xfe")
    Path("binary.elf").write_bytes(b"\x7fELF\x01\x01")
    Path("wrong.hex").write_bytes(b"\r\n:0400000001020304F3\n")
    assert run_table(*line.split()) == 2
    assert told in capsys.readouterr().err


# --- Images -------------------------------------------------------------------------------------------


def packed(words: tuple[int, ...] | list[int], order: str = "<") -> bytes:
    return struct.pack(f"{order}{len(words)}I", *words)


def bare_elf(data: bytes, address: int) -> bytes:
    """A big-endian 32-bit ELF with one loaded segment and no sections, as after a thorough strip."""
    ident = b"\x7fELF" + bytes([1, 2, 1]) + bytes(9)
    header = struct.pack(">HHIIIIIHHHHHH", 2, 8, 1, address, 52, 0, 0, 52, 32, 1, 40, 0, 0)
    segment = struct.pack(">IIIIIIII", 1, 84, address, address, len(data), len(data), 4, 4)
    return ident + header + segment + data


@pytest.mark.parametrize(("order", "offset"), [("<", 0), ("<", 1), (">", 0), (">", 67)])
def test_tables_are_found_in_every_format(order: str, offset: int, tmp_path: Path, capsys: Capture) -> None:
    other = generate(Decimal("0.125"), 2)
    data = bytes(offset) + packed(TABLE.words(), order) + b"\xff" * 7 + packed(other.words(), order)
    plain, elf, intel = (tmp_path / name for name in ("image.bin", "image.elf", "image"))
    plain.write_bytes(data)
    elf.write_bytes(bare_elf(data, 0x08000000))
    image = IntelHex()
    image.puts(0x08000000, data)
    image.write_hex_file(str(intel))
    assert run_table("--verify", plain, elf, intel) == 0
    lines = capsys.readouterr().out.splitlines()
    name = "little-endian" if order == "<" else "big-endian"
    assert len(lines) == 6
    assert lines[0] == f"{plain}: {offset:#x} ({name}): omega 0.05, q 30: ok"
    assert lines[3] == f"{elf}: segment+{offset + 139:#x} ({name}): omega 0.125, q 2: ok"
    assert lines[4] == f"{intel}: {0x08000000 + offset:#x} ({name}): omega 0.05, q 30: ok"


def test_a_linked_program_and_its_object_are_verified(tmp_path: Path, capsys: Capture) -> None:
    """A strict compiler makes the table and nothing else of it; the magic alone, in code, is no table."""
    symbol, program, stripped = f"mcp_asdf_{C_FILE.stem}", tmp_path / "program", tmp_path / "stripped"
    (tmp_path / "program.c").write_text(
        f'#include "mcp_asdf.h"\nextern const uint32_t {symbol}[33];\n'
        f"int main(void) {{ return {symbol}[0] == {MAGIC | 30:#x}U ? 0 : 1; }}\n"
    )
    objects = [tmp_path / "table.o", tmp_path / "program.o"]
    for file, made in zip((C_FILE, tmp_path / "program.c"), objects, strict=True):
        warnings = ["-pedantic-errors", "-Wall", "-Wextra", "-Werror", "-Wmissing-declarations"]
        run("gcc", "-std=c99", "-O1", *warnings, f"-I{ROOT}/c_ref/src", "-c", file, "-o", made)
    assert run("nm", "-S", objects[0]).split() == ["0" * 16, f"{132:016x}", "R", symbol]
    run("gcc", *objects, "-o", program)
    run(program)
    run("gcc", "-s", *objects, "-o", stripped)
    for path in (program, objects[0], stripped):
        assert run_table("--verify", path, "--json") == 0
        report = json.loads(capsys.readouterr().out)
        [found] = report["tables"]
        assert report["ok"] and ".rodata+0x" in found["place"]
        assert (found["omega"], found["q"], found["problem"]) == (0.05, 30, None)
    assert run_table("--verify", objects[1]) == 1


def problems(path: Path, data: bytes) -> list[str | None]:
    """What is wrong with the tables of a plain image."""
    path.write_bytes(data)
    return [finding.problem for finding in verify_image(path)]


@pytest.mark.parametrize(
    ("damaged", "value", "told"),
    [
        (slice(2, 17), 2**32 - 1, "entry 0 (m = 2): found 4294967295 (0xffffffff), expected "),
        (slice(17, 32), 0, "entry 15 (m = 17): found 0 "),
        (slice(31, 32), 7, f"entry 29 (m > 30): found 7 (0x00000007), expected {TABLE.entries[29]} "),
        (slice(32, 33), 1, f"the checksum: found 1 (0x00000001), expected {TABLE.words()[-1]} "),
        (slice(1, 2), 0x0CCCCCCE, "word 1 (omega) is 0x0ccccCce, which no omega gives".lower()),
        (slice(17, 33), None, "entry 15 (m = 17): found nothing, expected "),
        (slice(32, 33), None, "the checksum: found nothing, expected "),
    ],
)
def test_a_damaged_table_is_found_behind_a_sound_one(
    damaged: slice, value: int | None, told: str, tmp_path: Path
) -> None:
    """Erased, overwritten or cut off: up to half of the entries, the word of omega, the checksum."""
    words = list(TABLE.words())
    words[damaged] = [] if value is None else [value] * len(words[damaged])
    sound, problem = problems(tmp_path / "image.bin", packed(TABLE.words()) + packed(words))
    assert sound is None and problem is not None and problem.startswith(told)


@pytest.mark.parametrize("changed", [{8: 7}, dict.fromkeys(range(2, 32), 0)])
def test_wrong_entries_are_told_also_where_the_checksum_was_made_to_fit(
    changed: dict[int, int], tmp_path: Path
) -> None:
    words = [changed.get(place, word) for place, word in enumerate(TABLE.words()[:-1])]
    first = min(changed)
    (problem,) = problems(tmp_path / "image.bin", packed([*words, checksum(words)]))
    assert str(problem).startswith(f"entry {first - 2} (m = {first}): found {changed[first]} ")


@pytest.mark.parametrize(("omega", "q"), [("0.9", 127), ("0.9", 2), ("0.000000001", 127), ("0.000000001", 2)])
def test_every_table_is_found_without_its_checksum(omega: str, q: int, tmp_path: Path) -> None:
    words = generate(Decimal(omega), q).words()
    (problem,) = problems(tmp_path / "image.bin", packed(words[:-1]) + bytes(4))
    assert str(problem).startswith("the checksum: found 0 ")
    (problem,) = problems(
        tmp_path / "image.bin", packed([MAGIC | 2, words[1], 0, (33 << FRACTION_BITS) - 1, 0])
    )
    assert str(problem).startswith("entry 0 (m = 2): found 0 "), "it has one that is possible, just"


ENTRIES = generate(Decimal("0.05"), 127).entries
NO_TABLE = [
    b"",
    b"MCT",
    b"ITCM and DTCM: memories of a Cortex-M7, and MCTA in capitals" * 9,
    *(packed([first, 0x0CCCCCCD, *ENTRIES, *ENTRIES, *ENTRIES]) for first in (MAGIC, MAGIC | 1, MAGIC | 128)),
    *(packed([MAGIC + change | 30, 0x0CCCCCCD, *ENTRIES]) for change in (0x100, -0x100)),
    *(packed([MAGIC | 30, *[value] * 31]) for value in (0, 1 << FRACTION_BITS, 2**32 - 1)),
    packed([MAGIC | 30, 0x0CCCCCCD, *ENTRIES[:14], *[0] * 17]),
    packed([MAGIC | 2, 0x0CCCCCCD, 0, 33 << FRACTION_BITS, 0]),
]


@pytest.mark.parametrize("content", NO_TABLE)
def test_an_image_without_a_table_fails(content: bytes, tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "image.bin").write_bytes(content)
    assert run_table("--verify", tmp_path / "image.bin") == 1
    assert "no t-table found" in capsys.readouterr().out
