"""The firmware is a package for Arduino, PlatformIO, ESP-IDF and Zephyr, and each of them gets it whole.

What an ecosystem's own tools can do offline they do here: PlatformIO reads its manifest and Arduino's, and
packs the folder, as ESP-IDF does; Kconfig reads Zephyr's options.
"""

from __future__ import annotations

import json
import re
import sys
import tarfile
from pathlib import Path
from typing import Any

import pytest
import yaml

from c_ref.consumer import version_of_header
from support import ROOT, require, run

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


# --- PlatformIO, Arduino -----------------------------------------------------------------------------------

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


def test_platformio_packs_it(tmp_path: Path) -> None:
    pytest.importorskip("platformio", reason="platformio is not installed: make setup")
    packed = run(sys.executable, "-c", PACK, PACKAGE, tmp_path, PLATFORMIO_CORE_DIR=str(tmp_path / "home"))
    *versions, archive = packed.splitlines()
    assert versions == [version_of_header()] * 2
    files = unpacked(Path(archive), tmp_path / "lib")
    assert files - {".piopm"} == SOURCES | {"library.json", "library.properties", "README.md", "LICENSE"}
    manifest = manifests()["library.json"]
    assert set(manifest["headers"]) == {
        Path(name).name for name in SOURCES if name[-1] == "h" and not re.search("arithmetic|target", name)
    }
    assert manifest["build"] == {"srcDir": "src", "includeDir": "src"}


# --- ESP-IDF and Zephyr ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_esp_idf_packs_it(tmp_path: Path) -> None:
    require("compote")
    run("compote", "manifest", "lint", PACKAGE / "idf_component.yml")
    run("compote", "component", "pack", "--name", "mcp_asdf", "--dest-dir", tmp_path / "dist", cwd=PACKAGE)
    files = unpacked(tmp_path / f"dist/mcp_asdf_{version_of_header()}.tgz", tmp_path / "component")
    assert files == SOURCES | {"CMakeLists.txt", "idf_component.yml", "README.md", "LICENSE"}
    component = (PACKAGE / "CMakeLists.txt").read_text(encoding="utf-8")
    (sources,) = re.findall(r"idf_component_register\(SRCS (.*) INCLUDE_DIRS src\)", component)
    assert set(sources.split()) == {f"src/{name}.c" for name in PARTS}


@pytest.mark.parametrize(("chosen", "built"), [("", ()), ("", PARTS), ("_IMAGE=n", PARTS[::2])])
def test_zephyr_builds_what_its_options_say(chosen: str, built: tuple[str, ...], tmp_path: Path) -> None:
    """The optional parts come with the core, unless they are left out; nothing comes unasked."""
    kconfiglib = pytest.importorskip("kconfiglib", reason="kconfiglib is not installed: make setup")
    module = yaml.safe_load((PACKAGE / "zephyr/module.yml").read_text(encoding="utf-8"))
    (tmp_path / "Kconfig").write_text(f'osource "{PACKAGE / module["build"]["kconfig"]}"\n')
    wanted = ["CONFIG_MCP_ASDF=y"] * bool(built) + [f"CONFIG_MCP_ASDF{each}" for each in chosen.split()]
    (tmp_path / "prj.conf").write_text("\n".join(wanted))
    kconfig = kconfiglib.Kconfig(str(tmp_path / "Kconfig"), warn_to_stderr=False)
    kconfig.load_config(str(tmp_path / "prj.conf"))
    assert kconfig.warnings == []
    options = {symbol.name: symbol.str_value for symbol in kconfig.unique_defined_syms}
    assert options == {name.upper(): "y" if name in built else "n" for name in PARTS}
    text = (PACKAGE / module["build"]["cmake"] / "CMakeLists.txt").read_text(encoding="utf-8")
    for name, option in zip(PARTS[1:], ("IMAGE", "FRAME"), strict=True):
        assert f"zephyr_library_sources_ifdef(CONFIG_MCP_ASDF_{option} ../src/{name}.c)" in text
    (tmp_path / "without_zephyr.cmake").write_text(text)  # calls nothing of it where the core is off
    run(require("cmake"), "-P", tmp_path / "without_zephyr.cmake")
