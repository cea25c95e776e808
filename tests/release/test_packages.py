"""The wheel and the source archive have every file that git lists, and the commands work from the wheel."""

from __future__ import annotations

import itertools
import re
import shlex
import site
import sys
import tarfile
import tomllib
import zipfile
from functools import partial
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from authors_files import FIXED as FIXED_NETWORK
from authors_files import write_trial
from mcp_asdf_tools.cli import main as cli
from support import CORE, ROOT, block_with, made_once, names_in, require, run, version_of_header

PACKAGE_FOLDERS = ("firmware_py/mcp_asdf", "host_tools/mcp_asdf_tools")
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))

IMPORTED_MODULE = re.compile(
    r"^ *(?:import (\w+)[\w.]*(?: as \w+)?|from (\w+)[\w.]* import [^\n]+?)(?:  #.*)?$", re.MULTILINE
)

COMMANDS = """\
mcp-asdf --version
mcp-asdf swarm --robots 4 --steps 30 --filter-period 10 --quiet --log run.log
mcp-asdf view run.log --export run.html
mcp-asdf replay run.log
mcp-asdf firmware vendor
mcp-asdf calibrate readings.csv
mcp-asdf table --output tables --neighbours 4
mcp-asdf radio --id 3 --robots 3 --steps 1 --steps-per-second 500 --interface virtual
mcp-asdf node --help
mcp-asdf dbc --output mcp_asdf.dbc
mcp-asdf crosscheck --replay robot:2:1:64:0:3221225472,step:1
mcp-asdf simulate --steps 1000 --trials 2 --output run.parquet
mcp-asdf sweep physical --steps 10 --trials 1 --output physical.parquet
mcp-asdf score run.parquet
mcp-asdf plot run.parquet run.png
mcp-asdf export run.log run.csv
mcp-asdf convert authors_trial.json --output authors_trial.parquet
mcp-asdf reproduce --quick --part physical --trials 2 --steps 4000
"""
"""What is run from the wheel: every command. They read the files that are no Python: the C core, the page of
``view``, the studies, the claims and the templates of the report."""


def listed_files(*folders: str) -> set[str]:
    """Return the files in the folders that git tracks or would add, relative to the repository."""
    listed = run("git", "ls-files", "-z", "-co", "--exclude-standard", "--", *folders).split("\0")
    return {name for name in listed if (ROOT / name).is_file()}


def build_wheel(folder: Path) -> None:
    """Build the wheel of this tree into the folder, without the network and without optimising the C."""
    options = ("--quiet", "--no-build-isolation", "--no-deps", "--no-index", "--wheel-dir", folder)
    run(sys.executable, "-m", "pip", "wheel", *options, "--config-settings=cmake.build-type=Debug", ROOT)


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The project's wheel, built once for all tests."""
    folder = made_once(tmp_path_factory, "wheel", build_wheel)
    (path,) = folder.glob(f"mcp_asdf-{version_of_header()}-*.whl")
    return path


def install_wheel(wheel: Path, folder: Path) -> None:
    """Make a virtual environment in a folder, and install the wheel there without the libraries it needs.

    These come from the environment of the tests.
    """
    run(sys.executable, "-m", "venv", folder)
    python = folder / "bin/python"
    (packages,) = folder.glob("lib/python*/site-packages")
    # A path in a .pth file is searched last, and .pth files in it, such as that of this tree, are ignored.
    (packages / "libraries_of_the_tests.pth").write_text("\n".join(site.getsitepackages()))
    run(python, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps", wheel)


@pytest.fixture(scope="session")
def environment(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A virtual environment with the wheel. It is made once for all tests, and none of them changes it."""
    return made_once(tmp_path_factory, "environment", partial(install_wheel, wheel))


def listed_package_files() -> set[str]:
    """Return the files that git lists of the packages, by their paths in a wheel, but for C."""
    files = {name.partition("/")[2] for name in listed_files(*PACKAGE_FOLDERS)}
    return {name for name in files if not name.endswith((".c", ".h"))}


def package_files_in(wheel: Path) -> set[str]:
    """Return the files in a wheel, but for those that describe the wheel itself."""
    return {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}


def test_a_wheel_without_compiled_modules_has_every_file_that_git_lists(tmp_path: Path) -> None:
    """A file that is missing would be missing for users. It takes half a second, so make test notices it."""
    code = """
import sys
from scikit_build_core.build import build_wheel
build_wheel(sys.argv[1], {"wheel.cmake": "false"})
"""

    run(sys.executable, "-c", code, tmp_path)

    [wheel] = tmp_path.glob("*.whl")
    assert package_files_in(wheel) == listed_package_files()


@pytest.mark.slow
def test_the_wheel_has_every_file_that_git_lists_of_the_packages(wheel: Path) -> None:
    """It also has three compiled modules, and the firmware in C, which "mcp-asdf firmware" copies."""
    firmware = {f"mcp_asdf/core/{name}" for name in ["LICENSE", *names_in(CORE.parent)]}

    files = {without_tag_of_platform(name) for name in package_files_in(wheel)}

    compiled_modules = {
        "mcp_asdf/_native.so",
        "mcp_asdf_tools/experiments/_engine.so",
        "mcp_asdf_tools/world/_arena.so",
    }
    assert files == listed_package_files() | firmware | compiled_modules


def without_tag_of_platform(name: str) -> str:
    """Return "_native.so" for a name such as "_native.cpython-311-x86_64-linux-gnu.so"."""
    return re.sub(r"\.(cpython|abi3)[\w-]*\.so$", ".so", name)


def imported_modules() -> set[str]:
    """Return the top-level names of all modules that the packages import, also within functions."""
    modules = set[str]()
    for name in listed_files(*PACKAGE_FOLDERS):
        if name.endswith(".py"):
            text = (ROOT / name).read_text(encoding="utf-8")
            modules |= {imported or from_ for imported, from_ in IMPORTED_MODULE.findall(text)}
    return modules


def stated_dependencies() -> set[str]:
    """Return the names of all dependencies, and what their extras add: python-can[serial] adds pyserial."""
    project = PYPROJECT["project"]
    texts = itertools.chain(project["dependencies"], *project["optional-dependencies"].values())
    names = set[str]()
    for requirement in map(Requirement, texts):
        names.add(requirement.name)
        for extra in requirement.extras:
            further = map(Requirement, metadata.requires(requirement.name) or ())
            names |= {needed.name for needed in further if is_needed_by_extra(needed, extra)}
    return {canonicalize_name(name) for name in names}


def is_needed_by_extra(requirement: Requirement, extra: str) -> bool:
    """Return whether a package has this requirement because of one of its extras."""
    marker = requirement.marker
    return marker is not None and "extra" in str(marker) and marker.evaluate({"extra": extra})


def test_every_package_that_is_imported_is_a_stated_dependency() -> None:
    """Otherwise only users would miss it, since the environment of the tests has many packages more."""
    third_party_modules = imported_modules() - sys.stdlib_module_names - {"mcp_asdf", "mcp_asdf_tools"}
    assert {"can", "numpy", "scipy", "serial"} <= third_party_modules

    dependencies = stated_dependencies()
    packages_by_module = metadata.packages_distributions()

    for module in third_party_modules:
        packages = {canonicalize_name(package) for package in packages_by_module.get(module, [])}
        assert packages & dependencies, f"no stated dependency has the module {module}"


def test_the_commands_that_are_run_from_the_wheel_are_all() -> None:
    """A command that is not run from it could lack a file without a failing test."""
    commands_of_test = set(re.findall(r"^mcp-asdf (\S+)", COMMANDS, re.MULTILINE))
    assert commands_of_test - {"--version"} == set(cli.COMMANDS)


@pytest.mark.slow
def test_every_command_runs_from_the_wheel(environment: Path, tmp_path: Path) -> None:
    """None of COMMANDS ends with an error, so the files of the wheel that are no Python are there, too.

    Two commands read files that the test writes: readings of a sensor, and a trial of the paper's authors.
    """
    (tmp_path / "readings.csv").write_text("100,black\n800,white\n" * 10)
    first_trial = 0
    write_trial(tmp_path / "authors_trial.json", FIXED_NETWORK, first_trial)

    for line in COMMANDS.splitlines():
        program, *words = shlex.split(line)
        run(environment / "bin" / program, *words, cwd=tmp_path, MPLBACKEND="Agg")


@pytest.mark.slow
def test_the_packages_are_imported_from_the_wheel_in_these_tests(environment: Path, tmp_path: Path) -> None:
    """If they came from the source, no missing file would be noticed."""
    code = "import mcp_asdf, mcp_asdf_tools; print(mcp_asdf.__file__, mcp_asdf_tools.__file__)"

    firmware, tools = run(environment / "bin/python", "-c", code, cwd=tmp_path).split()

    assert Path(firmware).is_relative_to(environment)
    assert Path(tools).is_relative_to(environment)


@pytest.mark.slow
def test_the_wheel_passes_the_commands_that_test_a_release(environment: Path, tmp_path: Path) -> None:
    """They stand in pyproject.toml, for the program that builds the wheels of a release, cibuildwheel.

    It writes the project's folder in the place of {project}.
    """
    for command in PYPROJECT["tool"]["cibuildwheel"]["test-command"]:
        program, *words = shlex.split(command.replace("{project}", shlex.quote(str(ROOT))))
        run(environment / "bin" / program, *words, cwd=tmp_path)


def build_release(folder: Path) -> None:
    """Build and check an archive and a wheel in a folder with the commands of RELEASING.md."""
    require("twine")
    commands = block_with(ROOT / ".github/RELEASING.md", "twine check", "sh")
    assert "build/dist" in commands
    commands = commands.replace("build/dist", shlex.quote(str(folder)))
    commands = commands.replace("-m build", "-m build --quiet")
    printed = run("sh", "-exc", commands, cwd=ROOT)
    assert printed.count("PASSED") == len(names_in(folder))


@pytest.fixture(scope="session")
def release(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the source archive and the wheel of a release, built once for all tests."""
    return made_once(tmp_path_factory, "release", build_release)


@pytest.mark.slow
def test_the_commands_of_a_release_build_an_archive_and_a_wheel_that_an_index_accepts(release: Path) -> None:
    """They are those of RELEASING.md, among them the check that an index of packages makes."""
    wheel, archive = names_in(release)

    assert wheel.endswith(".whl")
    assert archive == f"mcp_asdf-{version_of_header()}.tar.gz"


@pytest.mark.slow
def test_the_source_archive_has_every_file_that_git_lists(release: Path) -> None:
    """pip builds from it where there is no wheel. It has one file more, which describes it."""
    [archive] = release.glob("*.tar.gz")
    with tarfile.open(archive) as opened:
        paths = [member.name for member in opened if member.isfile()]
    paths_without_first_folder = {path.partition("/")[2] for path in paths}
    assert paths_without_first_folder - {"PKG-INFO"} == listed_files()
