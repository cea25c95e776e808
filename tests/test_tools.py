"""The analysers find nothing: style, types, formats and what compilers and checkers of C warn of."""

from __future__ import annotations

import json
import shutil
import tomllib
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from _pytest.mark import ParameterSet

from proofs.source import HERE, Variant
from support import PAGES, ROOT, blocks, matching_files, require, run, slow

C_FILES = sorted(
    path
    for folder in ("c_ref", "docs", "host_tools", "tables", "tests")
    for path in matching_files(ROOT / folder, "**/*.[ch]")
)
ARENA, ENGINE = (f"host_tools/mcp_asdf_tools/{folder}" for folder in ("world/arena", "experiments/engine"))
INCLUDES = [f"-I{ROOT / folder}" for folder in ("c_ref/src", "c_ref/ports", ARENA, ENGINE)]
PRESETS = json.loads((ROOT / "CMakePresets.json").read_text(encoding="utf-8"))
STUBS = f"{ROOT}/tests/c_ref"
"""Folder with the headers of the boards that examples are for."""
WARNINGS = PRESETS["configurePresets"][0]["environment"]["WARNINGS"].split()
"""Warnings with which the C tests are built, as errors."""


@dataclass(frozen=True)
class FileGroup:
    """C files that are compiled in one way, whatever compiles or analyses them.

    Attributes:
        name: Of the group.
        files: Patterns of its files' paths.
        definitions: Macros that its build sets.
        gcc: Its compiler with the flags that choose a processor.
        packages: Debian's packages with the compiler and the headers.
        clang: Flags that choose the same processor for clang.
        headers: Folders of libraries' headers.
        can_analyse: Whether its gcc has ``-fanalyzer``.
        not_clang_tidy: What clang-tidy takes for wrong there, and is right.
        not_cppcheck: The same for cppcheck.
    """

    name: str
    files: tuple[str, ...]
    definitions: tuple[str, ...] = ()
    gcc: tuple[str, ...] = ("gcc",)
    packages: str = "gcc"
    clang: tuple[str, ...] = ()
    headers: tuple[str, ...] = ()
    can_analyse: bool = True
    not_clang_tidy: str = ""
    not_cppcheck: tuple[str, ...] = ()

    @property
    def sources(self) -> list[Path]:
        return sorted(path for pattern in self.files for path in matching_files(ROOT, pattern))

    def flags(self) -> list[str]:
        """Return flags for every compiler and analyser. Skips the test where the library is missing."""
        header_options = []
        for folder in self.headers:
            if not Path(folder).is_dir():
                pytest.skip(f"{folder} is missing: apt-get install {self.packages}")
            header_options += ["-isystem", folder]
        return ["-std=c99", *INCLUDES, *header_options, *self.definitions]


# A byte that counts to a constant below 256 saves an AVR two instructions in each round of the loop.
COUNTS_BYTES = "bugprone-too-small-loop-variable"
# Start-up code compares addresses that its linker script defines, and registers are there to lie in between.
ON_BARE_METAL = ("comparePointers", "unusedStructMember")
CORTEX_M = ("-mcpu=cortex-m3", "-mthumb", "-mfloat-abi=soft", "-ffreestanding")
NOT_FOR_AVR_LIBC = ("-Wno-gnu-zero-variadic-macro-arguments", "-Wno-unknown-attributes")
WASM = ("--target=wasm32", "-ffreestanding")
RISC_V = ("-march=rv32imc", "-mabi=ilp32", "-ffreestanding")
GROUPS = (
    FileGroup("core", ("c_ref/src/*.c",)),
    FileGroup("tables", ("tables/*.c",)),
    FileGroup("arena and engine", (f"{ARENA}/*.c", f"{ENGINE}/*.c")),
    FileGroup("linux", ("c_ref/ports/linux/*.c",), ("-D_GNU_SOURCE", "-DMCP_ASDF_NODE_TABLE=some_table")),
    FileGroup(
        "ports",
        ("c_ref/ports/*.c", "c_ref/ports/node/*.c", "c_ref/ports/slcan/*.c"),
        ("-DROBOT_ID=0", "-DROBOT_B_HAT=0.55", "-DROBOT_FILTER_PERIOD=1000"),
        not_clang_tidy=COUNTS_BYTES,
    ),
    FileGroup(
        "cortex_m",
        ("c_ref/ports/cortex_m/*.c",),
        gcc=("arm-none-eabi-gcc", *CORTEX_M),
        packages="gcc-arm-none-eabi",
        clang=("--target=arm-none-eabi", *CORTEX_M),
        not_cppcheck=ON_BARE_METAL,
    ),
    FileGroup(
        "riscv",
        ("c_ref/ports/riscv/*.c",),
        gcc=("riscv64-unknown-elf-gcc", *RISC_V),
        packages="gcc-riscv64-unknown-elf",
        clang=("--target=riscv32-unknown-elf", *RISC_V),
        not_cppcheck=ON_BARE_METAL,
    ),
    FileGroup(
        "wasm",
        ("c_ref/ports/wasm/*.c", "docs/playground/*.c"),
        gcc=("clang", *WASM),
        packages="clang",
        clang=WASM,
        can_analyse=False,
    ),
    FileGroup(
        "avr",
        ("c_ref/ports/avr/*.c",),
        gcc=("avr-gcc", "-mmcu=atmega328p"),
        packages="gcc-avr avr-libc",
        clang=("--target=avr", "-mmcu=atmega328p", *NOT_FOR_AVR_LIBC),
        headers=("/usr/lib/avr/include",),
        can_analyse=False,
    ),
    FileGroup("ESP-NOW", ("c_ref/examples/radios/esp_now.c",), headers=(STUBS, f"{STUBS}/esp_now")),
    FileGroup(
        "Crazyflie",
        ("c_ref/examples/radios/crazyflie.c",),
        headers=(f"{STUBS}/freertos", f"{STUBS}/crazyflie"),
    ),
)
TESTS = FileGroup("tests", ("tests/**/*.c",), ("-DREAL=double", "-D_GNU_SOURCE"))
"""C of the tests, which compilers must not warn of; the analysers' rules are for code that is delivered."""


def each_of(groups: Iterable[FileGroup]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("group", groups, ids=lambda group: group.name)


def quick_for(names: Collection[str], groups: Iterable[FileGroup]) -> list[ParameterSet]:
    """Return the groups as parameters of an analysis that make test does for the named groups alone.

    Of the others make test has the warnings of clang.
    """
    return [
        pytest.param(group, id=group.name, marks=[] if group.name in names else [pytest.mark.slow])
        for group in groups
    ]


def test_ruff_finds_nothing() -> None:
    """It checks the style of all Python. run() raises what it prints if it finds something."""
    run(require("ruff"), "check")


def test_python_is_formatted() -> None:
    """ruff would change nothing, or run() raises the changes that it prints."""
    run(require("ruff"), "format", "--diff")


def test_mypy_finds_no_wrong_type_in_the_project_and_in_the_programs_of_its_pages() -> None:
    """Readers who check types find nothing wrong in them either.

    The programs are written to files, since mypy reads files. run() raises what it finds.
    """
    folder = ROOT / "build/programs"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for page in PAGES:
        for number, code in enumerate(blocks(page, "python")):
            (folder / f"{page.stem}_{number}.py").write_text(code, encoding="utf-8")
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["mypy"]

    run(require("mypy"), *settings["files"], folder)


def test_biome_finds_nothing_in_the_javascript_and_it_is_formatted() -> None:
    """run() raises what it prints if it finds something, or would change the format."""
    folders = [
        "host_tools/mcp_asdf_tools/view/page",
        "docs/playground",
        "docs/javascripts",
        "tests/host_tools/view/scripts",
    ]
    run(require("biome"), "check", "--config-path=.ci", "--error-on-warnings", *folders)


def test_c_and_cpp_are_formatted() -> None:
    """clang-format would change nothing in C, C++ and the sketches for Arduino."""
    sketches = (ROOT / "c_ref/examples").rglob("*.ino")
    cpp_files = [*(ROOT / "c_ref").rglob("*.cpp"), *(ROOT / "tests").rglob("*.cpp")]
    run(require("clang-format"), "--dry-run", "-Werror", *C_FILES, *sketches, *cpp_files)


def test_every_c_file_is_among_those_that_are_analysed() -> None:
    """A group has C files that are compiled in one way; each analyser is run on each group."""
    files_in_groups = set[Path]()
    for group in (*GROUPS, TESTS):
        files_in_groups |= set(group.sources)
    all_files = {path for path in C_FILES if path.suffix == ".c"}
    assert files_in_groups == all_files


TIDIED_QUICKLY = ("mcp_asdf_image.c", "mcp_asdf_frame.c", "mcp_asdf_small.c", "mcp_asdf_accessors.c")
"""Files that clang-tidy analyses in make test; the core alone takes longer than these together."""


@pytest.mark.parametrize(
    ("group", "path"),
    [
        pytest.param(
            group,
            path,
            id=str(path.relative_to(ROOT)),
            marks=[] if path.name in TIDIED_QUICKLY else [pytest.mark.slow],
        )
        for group in GROUPS
        for path in group.sources
    ],
)
def test_clang_tidy_finds_nothing_in_a_file(group: FileGroup, path: Path) -> None:
    """A group has C files that are compiled in one way. Findings fail the test."""
    analyse_by_clang_tidy(group, path)


def analyse_by_clang_tidy(group: FileGroup, path: Path) -> None:
    """Analyse a file of a group by clang-tidy; raises AssertionError with what it finds."""
    checks = [f"--checks=-{group.not_clang_tidy}"] if group.not_clang_tidy else []
    run(require("clang-tidy"), "--quiet", *checks, path, "--", *group.flags(), *group.clang)


CPPCHECK = ("--enable=warning,style,performance,portability", "--std=c99", "--inline-suppr", "--quiet")
# Locals may be named like the function whose result they hold, and cppcheck takes 0 - x for negative.
NOT_CPPCHECK = ("shadowFunction", "knownConditionTrueFalse")


def analyse_by_cppcheck(group: FileGroup, *choices: str) -> None:
    """Analyse a group by cppcheck; raises AssertionError with what it finds."""
    left_out = [f"--suppress={name}" for name in (*NOT_CPPCHECK, *group.not_cppcheck)]
    options = [*INCLUDES, *group.definitions, *choices]
    run(require("cppcheck", "cppcheck"), *CPPCHECK, *left_out, *options, "--error-exitcode=1", *group.sources)


@pytest.mark.parametrize("variant", [HERE[0], *slow(HERE[1:])], ids=str)
def test_cppcheck_finds_nothing_in_the_core_as_a_target_compiles_it(variant: Variant) -> None:
    """A variant is how a target divides, multiplies and shifts, which macros choose."""
    core, *_other_groups = GROUPS
    choices = [flag for flag in variant.flags() if flag.startswith("-DMCP")]
    analyse_by_cppcheck(core, *choices)


@pytest.mark.parametrize("group", quick_for(("tables", "ports"), GROUPS[1:]))
def test_cppcheck_finds_nothing_in_a_group_of_c_files(group: FileGroup) -> None:
    """A group has C files that are compiled in one way. Findings fail the test."""
    analyse_by_cppcheck(group)


@pytest.mark.parametrize("group", quick_for(("core", "tables", "tests"), (*GROUPS, TESTS)))
def test_gcc_and_its_analyser_find_nothing_in_a_group_of_c_files(group: FileGroup, tmp_path: Path) -> None:
    """A group has C files that are compiled in one way. Findings fail the test."""
    analyse_by_gcc(group, tmp_path)


def analyse_by_gcc(group: FileGroup, folder: Path) -> None:
    """Compile a group with all warnings into a folder, and analyse it where its gcc can."""
    require(group.gcc[0], group.packages)
    if group == TESTS:
        mode = ["-fsyntax-only"]
    elif group.can_analyse:
        mode = ["-fanalyzer", "-O2", "-c"]
    else:
        mode = ["-O2", "-c"]
    run(*group.gcc, *group.flags(), *WARNINGS, *mode, *group.sources, cwd=folder)


@each_of((*GROUPS, TESTS))
def test_clang_warns_of_nothing_in_a_group_of_c_files(group: FileGroup) -> None:
    """A group has C files that are compiled in one way. A warning fails the test."""
    analyse_by_clang(group)


def analyse_by_clang(group: FileGroup) -> None:
    """Let clang look for warnings in a group; raises AssertionError with what it finds."""
    run(require("clang", "clang"), *group.flags(), *WARNINGS, *group.clang, "-fsyntax-only", *group.sources)


@dataclass(frozen=True)
class PlantedGroup(FileGroup):
    """A group with one file, which need not be in this project."""

    path: Path = Path()

    @property
    def sources(self) -> list[Path]:
        return [self.path]


MISTAKES = """
int flag_of(int count);
int flag_of(int count)
{
    int flag;
    if (count > 3) {
        flag = 1;
    }
    return flag;
}
int value_at(const int *place, int count);
int value_at(const int *place, int count)
{
    if (place == 0 && count > 3) {
        return *place;
    }
    return count;
}
"""
"""A variable that may have no value yet, and a pointer that may lead nowhere."""


@pytest.fixture
def group_with_mistakes() -> Iterator[PlantedGroup]:
    """A group with one file, inside the project, where analysers find their settings."""
    (ROOT / "build").mkdir(exist_ok=True)
    with TemporaryDirectory(dir=ROOT / "build") as folder:
        path = Path(folder) / "mistakes.c"
        path.write_text(MISTAKES)
        yield PlantedGroup("planted", (), path=path)


@pytest.mark.parametrize(
    ("analyse", "expected_finding"),
    [
        (analyse_by_cppcheck, "uninitvar"),
        (analyse_by_clang, "-Wsometimes-uninitialized"),
        (lambda group: analyse_by_gcc(group, group.path.parent), "analyzer-null-dereference"),
        (lambda group: analyse_by_clang_tidy(group, group.path), "clang-analyzer-core"),
    ],
    ids=["cppcheck", "clang", "gcc", "clang-tidy"],
)
def test_an_analyser_finds_a_mistake(
    analyse: Callable[[PlantedGroup], None], expected_finding: str, group_with_mistakes: PlantedGroup
) -> None:
    """The group has a C file with a variable that may have no value and a pointer that may lead nowhere.

    ``analyse`` raises an error with the analyser's report. One that is called wrongly would find nothing.
    """
    with pytest.raises(AssertionError, match=expected_finding):
        analyse(group_with_mistakes)


@pytest.mark.parametrize("script", [".ci/setup", ".ci/run", ".ci/newest", "tests/release/evidence.sh"])
def test_shellcheck_finds_nothing_in_a_script(script: str) -> None:
    """run() raises what it prints if it finds something in a program for the shell."""
    run(require("shellcheck", "shellcheck"), ROOT / script)
