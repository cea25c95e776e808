"""The firmware is a package for Arduino, PlatformIO, ESP-IDF and Zephyr, and each of them gets it whole.

What an ecosystem's own tools can do offline they do here: Arduino's builder makes an image that runs under
emulation; PlatformIO and ESP-IDF pack the folder, and the consumer is built from what they packed; Kconfig
reads Zephyr's options. Where a build needs the ecosystem itself (ESP-IDF, Zephyr), the few functions that our
build file calls are replaced by stubs, as their manuals describe them.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path
from typing import Any

import pytest
import yaml

from c_ref.consumer import CONSUMER, answer, version_of_header
from support import PATIENCE, ROOT, TABLE, require, run

PACKAGE = ROOT / "c_ref"
PARTS = ("mcp_asdf", "mcp_asdf_image", "mcp_asdf_frame")
SOURCES = {f"src/{name}.{kind}" for name in PARTS for kind in "ch"} | {
    "src/mcp_asdf_arithmetic.h",
    "src/mcp_asdf_rom.h",
    *(f"src/mcp_asdf_target{kind}.h" for kind in ("", "_avr", "_small")),
}
WARNINGS = "-Wall -Wextra -Werror"


# --- One version, one licence ----------------------------------------------------------------------------


def properties() -> dict[str, str]:
    lines = (PACKAGE / "library.properties").read_text(encoding="utf-8").splitlines()
    return dict(line.split("=", 1) for line in lines)


def manifests() -> dict[str, dict[str, Any]]:
    return {
        "library.json": json.loads((PACKAGE / "library.json").read_text(encoding="utf-8")),
        "library.properties": properties(),
        "idf_component.yml": yaml.safe_load((PACKAGE / "idf_component.yml").read_text(encoding="utf-8")),
        "CITATION.cff": yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8")),
    }


@pytest.mark.parametrize("key", ["version", "license"])
def test_all_manifests_agree(key: str) -> None:
    right = {"version": version_of_header(), "license": "MIT"}[key]
    assert {name: manifest[key] for name, manifest in manifests().items()} == dict.fromkeys(
        manifests(), right
    )


# --- Arduino ---------------------------------------------------------------------------------------------

SKETCH = (
    (
        CONSUMER.replace("extern const", 'extern "C" const')
        .replace("#include <stdio.h>", "#include <avr/sleep.h>")
        .replace("int main(void)", "static int run()")
        .replace('printf("%lu %lu\\n", (unsigned long)', "Serial.print(")
        .replace(
            ", (unsigned long)mcp_asdf_b_hat(&robot));",
            '); Serial.print(" "); Serial.println(mcp_asdf_b_hat(&robot));',
        )
    )
    + """
void setup() { Serial.begin(115200); run(); Serial.flush(); cli(); sleep_mode(); }
void loop() {}
"""
)
BUILDER = ("arduino-builder", "-compile", "-quiet", "-warnings", "all", "-fqbn", "arduino:avr:uno")
HARDWARE = ("-hardware", "/usr/share/arduino-builder", "-hardware", "/usr/share/arduino/hardware")
TOOLS = ("-tools", "/usr/bin")
# Arduino's core asks for a constant that Debian's avr-gcc 5 does not give to C++.
SETTINGS = ("-prefs", "compiler.cpp.extra_flags=-DDECIMAL_DIG=17")


def arduino_image(folder: Path) -> Path:
    """The sketch's image for the Arduino Uno, with the package among its libraries."""
    shutil.copytree(PACKAGE, folder / "libraries/mcp_asdf")
    (folder / "robot").mkdir()
    (folder / "built").mkdir()
    (folder / "robot/robot.ino").write_text(SKETCH)
    shutil.copy(TABLE, folder / "robot")
    places = ("-libraries", folder / "libraries", "-build-path", folder / "built")
    run(*BUILDER, *HARDWARE, *TOOLS, *SETTINGS, *places, folder / "robot/robot.ino")
    return folder / "built/robot.ino.elf"


@pytest.mark.slow
def test_an_arduino_uno_runs_it(tmp_path: Path) -> None:
    require("arduino-builder", "arduino-builder arduino-core-avr")
    require("simavr", "simavr")
    image = arduino_image(tmp_path)
    built = {path.name for path in (tmp_path / "built/libraries/mcp_asdf").glob("*.o")}
    assert built == {f"{name}.c.o" for name in PARTS}
    simulator = ("simavr", "-m", "atmega328p", "-f", "16000000", image)
    shown = subprocess.run(simulator, capture_output=True, text=True, check=False, timeout=PATIENCE).stderr
    assert re.findall(r"(\d+ \d+)\.", shown) == [answer().strip()]


# --- PlatformIO ------------------------------------------------------------------------------------------

# PlatformIO's own reader, schema and packer; the schema would fetch the list of licences.
PACK = """
import sys
from platformio.package.manifest.parser import ManifestParserFactory
from platformio.package.manifest.schema import ManifestSchema
from platformio.package.pack import PackagePacker
ManifestSchema.load_spdx_licenses = staticmethod(lambda: {"licenses": [{"licenseId": "MIT"}]})
for name in ("library.json", "library.properties"):
    found = ManifestParserFactory.new_from_file(f"{sys.argv[1]}/{name}").as_dict()
    print(ManifestSchema().load_manifest(found)["version"])
print(PackagePacker(sys.argv[1]).pack(sys.argv[2]))
"""


def unpacked(archive: Path, folder: Path) -> set[str]:
    """Unpack; returns the names of the files, relative to the folder."""
    with tarfile.open(archive) as tar:
        tar.extractall(folder, filter="data")
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def test_platformio_packs_it_and_a_consumer_builds(tmp_path: Path) -> None:
    pytest.importorskip("platformio", reason="platformio is not installed: make setup")
    packed = run(sys.executable, "-c", PACK, PACKAGE, tmp_path, PLATFORMIO_CORE_DIR=str(tmp_path / "home"))
    *versions, archive = packed.splitlines()
    assert versions == [version_of_header()] * 2
    files = unpacked(Path(archive), tmp_path / "lib")
    assert files - {".piopm"} == SOURCES | {"library.json", "library.properties", "README.md", "LICENSE"}
    assert set(manifests()["library.json"]["headers"]) == {
        Path(name).name for name in SOURCES if name[-1] == "h" and not re.search("arithmetic|target", name)
    }
    assert consumer_of(tmp_path / "lib", manifests()["library.json"]["build"], tmp_path) == answer()


def consumer_of(library: Path, settings: dict[str, str], folder: Path) -> str:
    """Output of the consumer, built as PlatformIO does: a folder's sources with another's headers."""
    (folder / "main.c").write_text(CONSUMER)
    sources = sorted((library / settings["srcDir"]).glob("*.c"))
    include = f"-I{library / settings['includeDir']}"
    run("cc", *WARNINGS.split(), include, *sources, "main.c", TABLE, "-o", "consumer", cwd=folder)
    return run(folder / "consumer")


# --- ESP-IDF ---------------------------------------------------------------------------------------------

ESP_PROJECT = """
cmake_minimum_required(VERSION 3.21)
project(consumer LANGUAGES C)
set(ESP_PLATFORM 1)
function(idf_component_register)
    cmake_parse_arguments(PARSE_ARGV 0 component "" "" "SRCS;INCLUDE_DIRS")
    if(component_UNPARSED_ARGUMENTS)
        message(FATAL_ERROR "unknown: ${component_UNPARSED_ARGUMENTS}")
    endif()
    add_library(component STATIC ${component_SRCS})
    target_include_directories(component PUBLIC ${component_INCLUDE_DIRS})
endfunction()
add_subdirectory(component)
add_executable(consumer main.c t_table_omega05_q30.c)
target_link_libraries(consumer PRIVATE component)
"""


def build_consumer(folder: Path, project: str) -> Path:
    (folder / "main.c").write_text(CONSUMER)
    (folder / "CMakeLists.txt").write_text(project)
    shutil.copy(TABLE, folder)
    run(require("cmake"), "-S", folder, "-B", folder / "build", f"-DCMAKE_C_FLAGS={WARNINGS}")
    run("cmake", "--build", folder / "build")
    return folder / "build/consumer"


@pytest.mark.slow
def test_esp_idf_packs_it_and_a_consumer_builds(tmp_path: Path) -> None:
    require("compote")
    run("compote", "manifest", "lint", PACKAGE / "idf_component.yml")
    run("compote", "component", "pack", "--name", "mcp_asdf", "--dest-dir", tmp_path / "dist", cwd=PACKAGE)
    archive = tmp_path / f"dist/mcp_asdf_{version_of_header()}.tgz"
    files = unpacked(archive, tmp_path / "component")
    assert files == SOURCES | {"CMakeLists.txt", "idf_component.yml", "README.md", "LICENSE"}
    assert run(build_consumer(tmp_path, ESP_PROJECT)) == answer()


# --- Zephyr ----------------------------------------------------------------------------------------------

ZEPHYR_PROJECT = """
cmake_minimum_required(VERSION 3.21)
project(consumer LANGUAGES C)
add_library(zephyr_interface INTERFACE)
function(zephyr_include_directories)
    foreach(folder IN LISTS ARGN)
        target_include_directories(zephyr_interface INTERFACE ${CMAKE_CURRENT_SOURCE_DIR}/${folder})
    endforeach()
endfunction()
macro(zephyr_library)
    set(ZEPHYR_CURRENT_LIBRARY module)
    add_library(module STATIC)
    target_link_libraries(module PUBLIC zephyr_interface)
endmacro()
function(zephyr_library_sources)
    target_sources(${ZEPHYR_CURRENT_LIBRARY} PRIVATE ${ARGN})
endfunction()
function(zephyr_library_sources_ifdef option)
    if(${option})
        zephyr_library_sources(${ARGN})
    endif()
endfunction()
"""
ZEPHYR_CONSUMER = """
add_subdirectory({} modules/mcp_asdf)
add_executable(consumer main.c t_table_omega05_q30.c)
target_link_libraries(consumer PRIVATE module)
"""


OPTIONS = [name.upper() for name in PARTS]


def zephyr_build() -> dict[str, str]:
    """The module's description of its build: a folder with a CMakeLists.txt, and a Kconfig file."""
    described = yaml.safe_load((PACKAGE / "zephyr/module.yml").read_text(encoding="utf-8"))
    assert described.keys() == {"name", "build"}
    build = described["build"]
    assert build.keys() == {"cmake", "kconfig"}
    assert (PACKAGE / build["cmake"] / "CMakeLists.txt").is_file()
    return dict(build)


def configured(folder: Path, chosen: str) -> dict[str, str]:
    """Options as Kconfig resolves them, by name, from a fragment of configuration."""
    kconfiglib = pytest.importorskip("kconfiglib", reason="kconfiglib is not installed: make setup")
    top = folder / "Kconfig"
    top.write_text(f'osource "{PACKAGE / zephyr_build()["kconfig"]}"\n')
    (folder / "prj.conf").write_text(chosen)
    kconfig = kconfiglib.Kconfig(str(top), warn_to_stderr=False)
    kconfig.load_config(str(folder / "prj.conf"))
    assert kconfig.warnings == []
    return {symbol.name: symbol.str_value for symbol in kconfig.unique_defined_syms}


def test_zephyr_builds_nothing_unless_told_to(tmp_path: Path) -> None:
    assert configured(tmp_path, "") == dict.fromkeys(OPTIONS, "n")
    module = (PACKAGE / zephyr_build()["cmake"] / "CMakeLists.txt").read_text(encoding="utf-8")
    (tmp_path / "without_zephyr.cmake").write_text(module)  # calls nothing of it, then
    run(require("cmake"), "-P", tmp_path / "without_zephyr.cmake")


@pytest.mark.slow
@pytest.mark.parametrize("left_out", [(), ("mcp_asdf_image",), PARTS[1:]])
def test_zephyr_builds_what_its_options_say(left_out: tuple[str, ...], tmp_path: Path) -> None:
    wanted = "".join(f"CONFIG_{name.upper()}={'n' if name in left_out else 'y'}\n" for name in PARTS)
    options = configured(tmp_path, wanted)
    settings = "".join(f"set(CONFIG_{name} {value})\n" for name, value in options.items() if value == "y")
    module = PACKAGE / zephyr_build()["cmake"]
    consumer = build_consumer(tmp_path, ZEPHYR_PROJECT + settings + ZEPHYR_CONSUMER.format(module))
    assert run(consumer) == answer()
    members = set(run("ar", "t", next(consumer.parent.rglob("libmodule.a"))).split())
    assert members == {f"{name}.c.o" for name in PARTS if name not in left_out}


def test_zephyr_s_optional_parts_come_with_the_core(tmp_path: Path) -> None:
    assert configured(tmp_path, "CONFIG_MCP_ASDF=y\n") == dict.fromkeys(OPTIONS, "y")
