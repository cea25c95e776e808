"""Files of a t-table: what ``mcp-asdf table`` writes, and what it finds wrong in a file."""

from __future__ import annotations

import hashlib
import json
import random
import struct
from decimal import Decimal
from pathlib import Path

import pytest

from mcp_asdf.table import MAGIC, Table
from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.tables.table_files import check_file, format_c_source, format_json, table_name
from mcp_asdf_tools.tables.thresholds import generate
from support import ROOT, run

Capture = pytest.CaptureFixture[str]
SHIPPED_TABLES = [(Decimal("0.05"), 127), (Decimal("0.05"), 30)]
TABLE = generate(Decimal("0.05"), 30)
C_FILE = ROOT / "tables/t_table_omega05_q30.c"
JSON_FILE = C_FILE.with_suffix(".json")


def run_table(*arguments: object) -> int:
    """Run ``mcp-asdf table`` and return its exit code."""
    return cli.main(["table", *map(str, arguments)])


# --- Names and content --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("omega", "name"),
    [
        ("0.05", "t_table_omega05_q2"),
        ("0.10", "t_table_omega10_q2"),
        ("0.125", "t_table_omega125_q2"),
        ("1E-9", "t_table_omega000000001_q2"),
    ],
)
def test_a_table_is_named_after_the_decimal_places_of_omega(omega: str, name: str) -> None:
    assert table_name(Decimal(omega), 2) == name


def test_no_two_tables_share_a_name() -> None:
    """All omegas up to 0.9 with at most four decimal places have different names."""
    omegas = {Decimal(number).scaleb(-4) for number in range(1, 9001)}
    assert len({table_name(omega, 2) for omega in omegas}) == len(omegas)


@pytest.mark.parametrize(("omega", "q"), SHIPPED_TABLES)
def test_the_shipped_files_are_what_the_generator_makes(omega: Decimal, q: int) -> None:
    path = ROOT / "tables" / table_name(omega, q)
    assert path.with_suffix(".c").read_text() == format_c_source(omega, q)
    assert path.with_suffix(".json").read_text() == format_json(omega, q)


def test_no_other_tables_are_shipped() -> None:
    names = {f"{table_name(omega, q)}{suffix}" for omega, q in SHIPPED_TABLES for suffix in (".c", ".json")}
    assert {path.name for path in (ROOT / "tables").iterdir()} == {"README.md", *names}


def test_the_json_file_has_all_words_of_the_table() -> None:
    content = json.loads(JSON_FILE.read_text())
    words = (MAGIC | content["q"], content["omega_word"], *content["entries"], content["checksum"])
    assert Table.from_words(words) == TABLE
    assert content["sha256"] == hashlib.sha256(struct.pack("<33I", *words)).hexdigest()


def test_a_strict_compiler_makes_the_array_and_nothing_else_of_the_c_file(tmp_path: Path) -> None:
    warnings = ["-pedantic-errors", "-Wall", "-Wextra", "-Werror", "-Wmissing-declarations"]
    object_file = tmp_path / "table.o"
    run("gcc", "-std=c99", "-O1", *warnings, f"-I{ROOT}/c_ref/src", "-c", C_FILE, "-o", object_file)
    symbols = run("nm", "-S", object_file).split()

    # Address, size, section (read-only data) and name
    size = 12 + 4 * 30
    assert symbols == [f"{0:016x}", f"{size:016x}", "R", "mcp_asdf_t_table_omega05_q30"]


# --- Writing ------------------------------------------------------------------------------------------


def test_table_writes_the_shipped_files_again(tmp_path: Path) -> None:
    folder = tmp_path / "new/folder"
    assert run_table("--omega", "0.050", "--neighbours", 30, "--output", folder) == 0
    assert {path.name for path in folder.iterdir()} == {C_FILE.name, JSON_FILE.name}
    assert (folder / C_FILE.name).read_bytes() == C_FILE.read_bytes()
    assert (folder / JSON_FILE.name).read_bytes() == JSON_FILE.read_bytes()


def test_table_prints_size_error_and_files(tmp_path: Path, capsys: Capture) -> None:
    run_table("--omega", "0.050", "--neighbours", 30, "--output", tmp_path)
    printed = capsys.readouterr().out

    assert printed.startswith("omega 0.05, q 30: 132 bytes (12 + 4 q)\nworst threshold error: ")
    assert " by rounding, 1.83% for 30 < m <= 127\n" in printed
    assert f"wrote {tmp_path / C_FILE.name}\n" in printed
    assert f"wrote {tmp_path / JSON_FILE.name}\n" in printed


def test_table_reports_its_default_table_in_json(tmp_path: Path, capsys: Capture) -> None:
    assert run_table("--output", tmp_path, "--json") == 0
    report = json.loads(capsys.readouterr().out)
    assert sorted(report.pop("files")) == sorted(map(str, tmp_path.iterdir()))
    assert report == json.loads((ROOT / "tables/t_table_omega05_q127.json").read_text())


BAD_OMEGAS = ("0", "-0.1", "0.95", "0.900000001", "1e400", "nan", "sNaN", "inf", "abc", "", "5%", "1e-10")
BAD_NEIGHBOURS = ("1", "-5", "128", "2.5", "many")


@pytest.mark.parametrize(
    "option", [*(f"--omega={omega}" for omega in BAD_OMEGAS), *(f"--neighbours={q}" for q in BAD_NEIGHBOURS)]
)
def test_a_bad_value_writes_nothing(option: str, tmp_path: Path, capsys: Capture) -> None:
    assert run_table(option, "--output", tmp_path / "folder") == 2
    message = capsys.readouterr().err
    assert message.startswith("mcp-asdf table: error: ") and option.partition("=")[2] in message
    assert list(tmp_path.iterdir()) == []


# --- Checking -----------------------------------------------------------------------------------------


def test_check_accepts_the_shipped_files(capsys: Capture) -> None:
    assert run_table("--check", C_FILE, JSON_FILE) == 0
    assert capsys.readouterr().out.splitlines() == [
        f"{C_FILE}: omega 0.05, q 30: ok",
        f"{JSON_FILE}: omega 0.05, q 30: ok",
    ]


@pytest.mark.parametrize("file", [C_FILE, JSON_FILE], ids=["C", "JSON"])
def test_check_notices_a_changed_character_anywhere(file: Path, tmp_path: Path) -> None:
    """Sixty characters are changed, one at a time; they are drawn with a fixed seed."""
    draw, text, path = random.Random(5), file.read_text(), tmp_path / file.name
    indices = [index for index, character in enumerate(text) if character != "\n"]
    for index in draw.sample(indices, 60):
        other_characters = [character for character in '0159aFU/* }],."x' if character != text[index]]
        path.write_text(text[:index] + draw.choice(other_characters) + text[index + 1 :])
        assert run_table("--check", path) in (1, 2), f"the change at {index} went unnoticed"


@pytest.mark.parametrize("file", [C_FILE, JSON_FILE], ids=["C", "JSON"])
def test_check_notices_a_missing_line_end(file: Path, tmp_path: Path) -> None:
    path = tmp_path / file.name
    path.write_text(file.read_text().removesuffix("\n"))
    assert check_file(path).problem is not None


@pytest.mark.parametrize("file", [C_FILE, JSON_FILE], ids=["C", "JSON"])
def test_check_notices_a_line_too_many(file: Path, tmp_path: Path) -> None:
    path = tmp_path / file.name
    path.write_text(file.read_text() + "\n")
    assert check_file(path).problem is not None


def test_check_accepts_line_ends_of_other_systems(tmp_path: Path) -> None:
    path = tmp_path / JSON_FILE.name
    path.write_bytes(JSON_FILE.read_bytes().replace(b"\n", b"\r\n"))
    assert check_file(path).problem is None


def test_check_names_the_first_line_that_differs(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / JSON_FILE.name
    changed_entry = TABLE.entries[17]  # which is in line 37
    path.write_text(JSON_FILE.read_text().replace(f" {changed_entry},", " 7,"))

    assert run_table("--check", path) == 1

    problem = f"line 37: found '    7,', expected '    {changed_entry},'"
    assert capsys.readouterr().out == f"{path}: omega 0.05, q 30: {problem}\n"


def test_check_reports_in_json(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / JSON_FILE.name
    path.write_text(JSON_FILE.read_text() + "\n")
    assert run_table("--check", C_FILE, path, "--json") == 1
    problem = "line 53: found '', expected None"  # the file ends with line 52

    assert json.loads(capsys.readouterr().out) == {
        "ok": False,
        "tables": [
            {"place": str(C_FILE), "omega": 0.05, "q": 30, "problem": None},
            {"place": str(path), "omega": 0.05, "q": 30, "problem": problem},
        ],
    }


@pytest.fixture
def folder_of_wrong_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the working directory one with files that are not tables."""
    monkeypatch.chdir(tmp_path)
    Path("folder.c").mkdir()
    Path("no_symbol.c").touch()
    Path("omega.json").write_text('"mcp_asdf_t_table_omega95_q30"')
    Path("q.c").write_text("mcp_asdf_t_table_omega05_q1")
    Path("binary.c").write_bytes(b"\xff\xfe")
    Path("table.txt").touch()


@pytest.mark.usefixtures("folder_of_wrong_files")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("", "one of the arguments --output --check is required"),
        (f"--check {C_FILE} --omega 0.05", "--omega and --neighbours go with --output"),
        (f"--check {C_FILE} --neighbours 30", "--omega and --neighbours go with --output"),
        (f"--check {C_FILE} --output .", "not allowed with argument"),
        ("--output no_symbol.c", "cannot write no_symbol.c: File exists; choose a folder"),
        ("--check missing.json", "cannot read missing.json: No such file"),
        ("--check folder.c", "cannot read folder.c: Is a directory"),
        ("--check no_symbol.c", "no_symbol.c names no array mcp_asdf_t_table_omega.._q..; make it anew"),
        ("--check omega.json", "omega.json: omega is 0.95; it must be above 0"),
        ("--check q.c", "q.c: the number of neighbours is 1; it must be 2 to 127"),
        ("--check binary.c", "binary.c is not a text file; give a file that --output has written"),
        ("--check table.txt", "table.txt is neither .c nor .json; give a file that --output has written"),
    ],
)
def test_table_names_what_it_cannot_do(arguments: str, message: str, capsys: Capture) -> None:
    assert run_table(*arguments.split()) == 2
    assert message in capsys.readouterr().err
