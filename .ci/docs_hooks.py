"""Hooks of MkDocs for the documentation: generated parts, formulas as MathML, and the playground.

A page asks for generated text by a comment: ``<!-- commands -->``, ``<!-- headers -->``, ``<!-- rooms -->``,
``<!-- requirements -->``. ``<!-- file: PATH -->`` asks for a C file of the repository. Each package of the
tools has a page. The picture of the first page becomes the playground, which is compiled for WebAssembly.
Formulas stand between dollar signs, as on GitHub; MathML needs no script, so the site works offline.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import griffe
from latex2mathml.converter import convert
from mkdocs.structure.files import File

from mcp_asdf_tools.common.versions import own_version

ROOT = Path(__file__).resolve().parents[1]
# MkDocs imports this file by its path, not as a module of a package.
sys.path += [str(ROOT / ".ci"), str(ROOT / "tests")]

import generated_pages  # noqa: E402

import requirements  # noqa: E402

TEXT_OF_COMMENT = {
    "<!-- commands -->": generated_pages.describe_commands,
    "<!-- headers -->": generated_pages.list_headers,
    "<!-- rooms -->": generated_pages.list_packages,
    "<!-- requirements -->": requirements.format_table_of_project,
}
"""Functions that return the text in place of a comment."""

SEARCH_BOOSTS = {"internals": 1e-2, "api": 1e-4, "cli": 1e-4, "headers": 1e-4}
"""Weights of pages in the search by how their names begin, where guides have 1: a word in a heading counts
1000 times."""

_CODE = re.compile(r"(^```.*?^```$|``[^`\n]+``|`[^`\n]+`)", re.DOTALL | re.MULTILINE)
_FORMULA = re.compile(r"\$\$(.+?)\$\$|\$([^$\s](?:[^$\n]*[^$\s])?)\$", re.DOTALL)
_FILE_COMMENT = re.compile(r"<!-- file: (\S+) -->")
_POWER = re.compile(r"(?<=[\w)])\*\*(-?\w+|\([^)]*\))")

_FIRST_PICTURE = re.compile(r"^!\[([^\]]*)\]\(images/view\.webp\)$", re.MULTILINE)
_PLAYGROUND = r'<iframe id="playground" title="\1" style="width: 100%; height: 46rem; border: 0"></iframe>'


def on_config(config: Any, **_: Any) -> Any:
    """Put the version beside the name of the site, and the packages below the page of the Python API."""
    config.site_name += f" {own_version()}"
    api_pages = _menu_entry(_menu_entry(config.nav, "Reference"), "Python API")
    api_pages += [{name: f"api/{name}.md"} for name in generated_pages.package_names()]
    return config


def _menu_entry(menu: list[Any], title: str) -> list[Any]:
    """Return what stands below a title in a menu. Raises StopIteration if the title is not there."""
    return next(entry[title] for entry in menu if title in entry)


def on_files(files: Any, config: Any, **_: Any) -> Any:
    """Add a page of each package."""
    for name in generated_pages.package_names():
        files.append(File.generated(config, f"api/{name}.md", content=generated_pages.package_page(name)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Fill in what is generated, and take formulas out, in which Markdown would find markup."""
    for comment, make_text in TEXT_OF_COMMENT.items():
        if comment in markdown:
            markdown = markdown.replace(comment, make_text())
    markdown = _FILE_COMMENT.sub(_list_file, markdown)
    markdown = markdown.replace("<details>", '<details markdown="1">')  # GitHub renders both
    if page.is_homepage:
        markdown = _FIRST_PICTURE.sub(_PLAYGROUND, markdown, count=1)
        page.meta["hide"] = ["navigation", "toc"]  # to make room for the playground
    for beginning, boost in SEARCH_BOOSTS.items():
        if page.file.src_uri.startswith(beginning):
            page.meta["search"] = {"boost": boost}
    page.formulas = []
    return _substitute_outside_code(_FORMULA, lambda match: _take_out(match, page.formulas), markdown)


def on_page_content(content: str, page: Any, **_: Any) -> str:
    """Put the formulas into the HTML of a page."""
    # A formula stays on one line with the brackets and the punctuation around it.
    content = re.sub(r"\(?formula\d+formula[),.;:]*", r'<span class="formula">\g<0></span>', content)
    for number, formula in enumerate(page.formulas):
        content = content.replace(f"formula{number}formula", formula)
    return content


def on_post_build(config: Any, **_: Any) -> None:
    """Make the playground that the first page shows. Raises SystemExit where it cannot be compiled."""
    command = [sys.executable, str(ROOT / ".ci/playground.py"), str(Path(config.site_dir) / "play.html")]
    exit_code = subprocess.run(command, check=False).returncode
    if exit_code != 0:
        raise SystemExit(exit_code)


def _list_file(comment: re.Match[str]) -> str:
    """Return the C file that a comment asks for as a block of code; a missing file ends the build."""
    source = (ROOT / comment[1]).read_text(encoding="utf-8")
    return f"```c\n{source}```"


def _take_out(formula: re.Match[str], formulas: list[str]) -> str:
    """Append a formula to ``formulas`` as MathML, and return the word that stands for it in the text."""
    in_own_line, in_text = formula.groups()
    formulas.append(convert(in_own_line or in_text, display="block" if in_own_line else "inline"))
    return f"formula{len(formulas) - 1}formula"


def _substitute_outside_code(pattern: re.Pattern[str], replacement: Any, markdown: str) -> str:
    """Return a text in Markdown in which a pattern is replaced wherever it is not in code."""
    parts = _CODE.split(markdown)  # text and code by turns, as the pattern is one group
    parts[::2] = [pattern.sub(replacement, text) for text in parts[::2]]
    return "".join(parts)


class Docstrings(griffe.Extension):
    """Writes powers in docstrings, such as 2**-8, as superscripts: in Markdown stars would make text bold."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite the docstring of an object that has one."""
        if obj.docstring:
            obj.docstring.value = _substitute_outside_code(_POWER, r"<sup>\1</sup>", obj.docstring.value)
