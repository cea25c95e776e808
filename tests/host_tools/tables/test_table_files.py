"""Files of a t-table: what ``mcp-asdf table`` writes, and what it finds wrong in a file."""

from __future__ import annotations

import hashlib
import json
import struct
from decimal import Decimal
from pathlib import Path

import pytest

from mcp_asdf.table import MAGIC, Table
from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.tables.table_files import check_file, format_c_source, format_json, table_name
from mcp_asdf_tools.tables.thresholds import generate
from support import ROOT, names_in, run

Capture = pytest.CaptureFixture[str]
SHIPPED_TABLES = [(Decimal("0.05"), 127), (Decimal("0.05"), 30)]
SHIPPED_C_FILE = ROOT / "tables/t_table_omega05_q30.c"
SHIPPED_JSON_FILE = SHIPPED_C_FILE.with_suffix(".json")


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
    """A table is for one omega, an error probability, and for up to q neighbours, here 2."""
    assert table_name(Decimal(omega), q=2) == name


def test_no_two_tables_share_a_name() -> None:
    """All omegas up to 0.9 with at most four decimal places have different names."""
    omegas = [Decimal(ten_thousandths) / 10_000 for ten_thousandths in range(1, 9001)]
    names = {table_name(omega, q=2) for omega in omegas}
    assert len(names) == len(omegas)


@pytest.mark.parametrize(("omega", "q"), SHIPPED_TABLES)
def test_the_shipped_files_are_what_the_generator_makes(omega: Decimal, q: int) -> None:
    """The folder tables has each table as a file in C and one in JSON, which are generated anew here."""
    path_without_suffix = ROOT / "tables" / table_name(omega, q)
    assert path_without_suffix.with_suffix(".c").read_text() == format_c_source(omega, q)
    assert path_without_suffix.with_suffix(".json").read_text() == format_json(omega, q)


def test_no_other_tables_are_shipped() -> None:
    """The folder has only the tables for omega 0.05 and for 127 or 30 neighbours, in C and in JSON."""
    assert {path.name for path in (ROOT / "tables").iterdir()} == {
        "README.md",
        "t_table_omega05_q127.c",
        "t_table_omega05_q127.json",
        "t_table_omega05_q30.c",
        "t_table_omega05_q30.json",
    }


def test_the_json_file_has_all_words_of_the_table() -> None:
    """A table is 33 words of 32 bits in the memory of a robot, which the file lists with their checksum.

    The words are two of the header, 30 entries and a checksum of the table. The file is for 30 neighbours.
    """
    content = json.loads(SHIPPED_JSON_FILE.read_text())
    first_word = MAGIC | content["q"]  # marks a table, and has the number of neighbours in its lowest bits
    words = (first_word, content["omega_word"], *content["entries"], content["checksum"])
    assert Table.from_words(words) == generate(Decimal("0.05"), q=30)

    words_in_memory = struct.pack("<33I", *words)  # little-endian
    assert content["sha256"] == hashlib.sha256(words_in_memory).hexdigest()


def test_a_strict_compiler_accepts_the_c_file_which_has_an_array_and_nothing_else(tmp_path: Path) -> None:
    """The only symbol of the compiled file is an array of 33 words of 4 bytes, in read-only data (R)."""
    warnings = ["-pedantic-errors", "-Wall", "-Wextra", "-Werror", "-Wmissing-declarations"]
    object_file = tmp_path / "table.o"
    run("gcc", "-std=c99", "-O1", *warnings, f"-I{ROOT}/c_ref/src", "-c", SHIPPED_C_FILE, "-o", object_file)

    [line_of_only_symbol] = run("nm", "-S", object_file).splitlines()
    _address, hexadecimal_size, section, name = line_of_only_symbol.split()
    words = 2 + 30 + 1  # of the header, entries, and the checksum
    assert int(hexadecimal_size, 16) == 4 * words
    assert section == "R"
    assert name == "mcp_asdf_t_table_omega05_q30"


# --- Writing ------------------------------------------------------------------------------------------


def test_table_writes_the_shipped_files_again(tmp_path: Path) -> None:
    """It makes the folder, and 0.050 is the same omega as 0.05. Files are compared byte for byte."""
    folder = tmp_path / "new/folder"

    exit_code = run_table("--omega", "0.050", "--neighbours", 30, "--output", folder)

    assert exit_code == 0
    assert names_in(folder) == ["t_table_omega05_q30.c", "t_table_omega05_q30.json"]
    assert (folder / "t_table_omega05_q30.c").read_bytes() == SHIPPED_C_FILE.read_bytes()
    assert (folder / "t_table_omega05_q30.json").read_bytes() == SHIPPED_JSON_FILE.read_bytes()


def test_table_prints_the_size_of_a_table_its_errors_and_the_files_that_it_writes(
    tmp_path: Path, capsys: Capture
) -> None:
    """A table takes 12 bytes for header and checksum and 4 for each of its q entries, here 30: 132 bytes.

    Thresholds have errors from rounding. For more neighbours than the table has entries, up to 127, they have
    larger ones: docs/internals/t_tables.md has the 1.83 %.
    """
    run_table("--omega", "0.05", "--neighbours", 30, "--output", tmp_path)
    output = capsys.readouterr().out

    assert output.startswith("omega 0.05, q 30: 132 bytes (12 + 4 q)\nworst threshold error: ")
    assert " by rounding, 1.83% for 30 < m <= 127\n" in output
    assert f"wrote {tmp_path / 't_table_omega05_q30.c'}\n" in output
    assert f"wrote {tmp_path / 't_table_omega05_q30.json'}\n" in output


def test_table_reports_its_default_table_in_json(tmp_path: Path, capsys: Capture) -> None:
    """The report has the same content as the table's JSON file, and the paths of the two files.

    Without options the table is for omega 0.05 and 127 neighbours.
    """
    exit_code = run_table("--output", tmp_path, "--json")
    report = json.loads(capsys.readouterr().out)
    written_files = report.pop("files")

    assert exit_code == 0
    assert sorted(written_files) == sorted(str(path) for path in tmp_path.iterdir())
    assert report == json.loads((ROOT / "tables/t_table_omega05_q127.json").read_text())


@pytest.mark.parametrize(
    ("option", "value"),
    [
        *(("--omega", text) for text in ("0", "-0.1", "0.900000001", "1e400", "nan", "sNaN", "abc", "1e-10")),
        *(("--neighbours", text) for text in ("1", "128", "2.5")),
    ],
)
def test_table_refuses_a_value_out_of_range_and_writes_nothing(
    option: str, value: str, tmp_path: Path, capsys: Capture
) -> None:
    """Omega is above 0, at most 0.9 and has at most nine decimal places; neighbours are 2 to 127."""
    exit_code = run_table(f"{option}={value}", "--output", tmp_path / "folder")
    message = capsys.readouterr().err

    assert exit_code == 2
    assert message.startswith("mcp-asdf table: error: ")
    assert value in message
    assert names_in(tmp_path) == []


# --- Checking -----------------------------------------------------------------------------------------


def test_check_accepts_the_shipped_files(capsys: Capture) -> None:
    """``mcp-asdf table --check`` compares files with what they should be, and prints a line for each.

    Their names end in omega05_q30: they have the table for omega = 0.05 and up to 30 neighbours.
    """
    assert run_table("--check", SHIPPED_C_FILE, SHIPPED_JSON_FILE) == 0
    assert capsys.readouterr().out.splitlines() == [
        f"{SHIPPED_C_FILE}: omega 0.05, q 30: ok",
        f"{SHIPPED_JSON_FILE}: omega 0.05, q 30: ok",
    ]


def check_finds_a_problem(path: Path) -> bool:
    """Return whether the check finds a problem in a file, or refuses to read it."""
    try:
        return check_file(path).problem is not None
    except UsageError:
        return True


@pytest.mark.parametrize("file", [SHIPPED_C_FILE, SHIPPED_JSON_FILE], ids=["C", "JSON"])
def test_check_notices_a_changed_character_anywhere(file: Path, tmp_path: Path) -> None:
    """``mcp-asdf table --check`` compares a file with a correct one.

    Every 97th character is replaced by a 7, or by an 8 if it is one, one at a time.
    """
    text = file.read_text()
    path = tmp_path / file.name
    for index in range(0, len(text), 97):
        other_character = "8" if text[index] == "7" else "7"
        path.write_text(text[:index] + other_character + text[index + 1 :])
        assert check_finds_a_problem(path), f"the change at {index} went unnoticed"


@pytest.mark.parametrize("file", [SHIPPED_C_FILE, SHIPPED_JSON_FILE], ids=["C", "JSON"])
@pytest.mark.parametrize("line_ends", ["", "\n\n"])
def test_check_notices_a_line_end_too_few_or_too_many(file: Path, line_ends: str, tmp_path: Path) -> None:
    """A correct file ends in a single line end. A copy ends in none or in two."""
    text_without_line_end = file.read_text().removesuffix("\n")
    path = tmp_path / file.name
    path.write_text(text_without_line_end + line_ends)
    assert check_finds_a_problem(path)


def test_check_accepts_line_ends_of_other_systems(tmp_path: Path) -> None:
    """Some programs replace \\n by \\r\\n when they copy a text."""
    path = tmp_path / SHIPPED_JSON_FILE.name
    path.write_bytes(SHIPPED_JSON_FILE.read_bytes().replace(b"\n", b"\r\n"))
    assert check_file(path).problem is None


def test_check_names_the_first_line_that_differs(tmp_path: Path, capsys: Capture) -> None:
    """Each line of the file has one entry of the table. The entry in line 37 is replaced by 7."""
    lines = SHIPPED_JSON_FILE.read_text().splitlines()
    index_of_line_37 = 36
    right_line = lines[index_of_line_37]
    lines[index_of_line_37] = "    7,"
    path = tmp_path / SHIPPED_JSON_FILE.name
    path.write_text("\n".join(lines))

    exit_code = run_table("--check", path)

    assert exit_code == 1
    problem = f"line 37: found '    7,', expected '{right_line}'"
    assert capsys.readouterr().out == f"{path}: omega 0.05, q 30: {problem}\n"


def test_check_reports_in_json(tmp_path: Path, capsys: Capture) -> None:
    """The first of two files is right, and the second has an empty line 53 behind its last one.

    Their names end in omega05_q30: they have the table for omega = 0.05 and up to 30 neighbours.
    """
    wrong_file = tmp_path / SHIPPED_JSON_FILE.name
    wrong_file.write_text(SHIPPED_JSON_FILE.read_text() + "\n")

    exit_code = run_table("--check", SHIPPED_C_FILE, wrong_file, "--json")
    report = json.loads(capsys.readouterr().out)

    assert exit_code == 1
    assert report["ok"] is False
    problem = "line 53: found '', expected None"
    assert report["tables"] == [
        {"place": str(SHIPPED_C_FILE), "omega": 0.05, "q": 30, "problem": None},
        {"place": str(wrong_file), "omega": 0.05, "q": 30, "problem": problem},
    ]


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
        (f"--check {SHIPPED_C_FILE} --omega 0.05", "--omega and --neighbours go with --output"),
        (f"--check {SHIPPED_C_FILE} --neighbours 30", "--omega and --neighbours go with --output"),
        (f"--check {SHIPPED_C_FILE} --output .", "not allowed with argument"),
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
def test_table_refuses_what_it_cannot_do_and_says_why(arguments: str, message: str, capsys: Capture) -> None:
    """Each file of the working directory is wrong in another way, and options go only with some others.

    The command ends with exit code 2 and prints the message to stderr.
    """
    assert run_table(*arguments.split()) == 2
    assert message in capsys.readouterr().err
