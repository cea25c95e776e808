"""Build of the documentation: pages made from the program itself, formulas as MathML, docstrings as Markdown.

A page asks for generated text by a comment: ``<!-- commands -->``, ``<!-- headers -->``, ``<!-- rooms -->``,
``<!-- requirements -->``. ``<!-- file: PATH -->`` asks for a C file of the repository.
Each room of the tools has a page.
The picture of the first page becomes the playground, which is compiled for WebAssembly.
Formulas stand between dollar signs, as on GitHub; MathML needs no script, so the site works offline.
"""

from __future__ import annotations

import argparse
import html
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import griffe
from latex2mathml.converter import convert
from mkdocs.structure.files import File

from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.common.versions import own_version

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "tests"))
requirements = import_module("requirements")
ROOMS = ROOT / "host_tools/mcp_asdf_tools"
HEADERS = ("mcp_asdf", "mcp_asdf_frame", "mcp_asdf_small", "mcp_asdf_image")

SEARCH_BOOSTS = {"internals": 1e-2, "api": 1e-4, "cli": 1e-4, "headers": 1e-4}
"""Weights of pages in the search by how their names begin, where guides have 1: a word in a heading counts
1000 times."""

_CODE = re.compile(r"(^```.*?^```$|``[^`\n]+``|`[^`\n]+`)", re.DOTALL | re.MULTILINE)
_FORMULA = re.compile(r"\$\$(.+?)\$\$|\$([^$\s](?:[^$\n]*[^$\s])?)\$", re.DOTALL)
_FILE = re.compile(r"<!-- file: (\S+) -->")
_INLINE_CODE = re.compile(r"(?<=<code>)[^<\n]+(?=</code>)")
_WORD = re.compile(r"[^ ]{2,}")
_LONGEST_UNBROKEN_WORD = 26
_LINES_OF_A_LISTING = 50
_SEPARATOR = re.compile(r"(?<=\w[/:,])(?=\w)|(?<=[a-z]\.)(?=[A-Za-z_]{5})")
_UNDERSCORE = re.compile(r"(?<=\w_)(?<!\btest_)(?=\w)")
_HYPHENATED = re.compile(r"(?<![\w.&;-])(?:--?\w[\w.]*|\w[\w.]*(?=-\w))(?:-\w[\w.]*)*(?![\w-])(?![^<>]*>)")
_START_OF_COMMENT = re.compile(r"(?<![^ >])(?:/\*|//|#) [^ <]{1,24}")
_LONG_OPTION = re.compile(r"(?<![\w-])--\w[\w-]*")
_JSON_MEMBER = re.compile(r'(?<=[^ ],)(?="|&quot;)')
_OPENING = re.compile(r'<span class="[op]">[.(\[]+</span>')
_LAST_COLUMN = re.compile(r"(?<= {3})[^ <][^<]{0,34}$")
_INDENT = re.compile(r"^((?:<[^<>]+>)*)( +)")
_NUMBER = re.compile(r"(?=.*\d)(?!.*[a-z]{2})[a-z\d.,+ -]+")
_VALUE = re.compile(r"(?!.*[^\W\d_]{2})[^<>]+")
_BLOCK = re.compile(r'<div class="highlight"><pre><span></span><code>(.*?)</code></pre></div>', re.DOTALL)
_TABLE = re.compile(r"^(?:<[^<>]+>)*\|.*\|(?:<[^<>]+>)*$|[\u2502\u2503]", re.MULTILINE)
_TAG = re.compile(r"<[^<>]+>")
_OPTIMISATION = re.compile(r"(?<= )-O[0-3s]\b(?=[^<>]*<)")
_POWER = re.compile(r"(?<=[\w)])\*\*(-?\w+|\([^)]*\))")

_PICTURE = re.compile(r"^!\[([^\]]*)\]\(images/view\.webp\)$", re.MULTILINE)
_FRAME = r'<iframe id="playground" title="\1" style="width: 100%; height: 46rem; border: 0"></iframe>'


def on_config(config: Any, **_: Any) -> Any:
    """The version beside the name, and the rooms below the page of the Python API."""
    config.site_name += f" {own_version()}"
    reference = next(each["Reference"] for each in config.nav if "Reference" in each)
    pages = next(each["Python API"] for each in reference if "Python API" in each)
    pages += [{name: f"api/{name}.md"} for name in room_names()]
    return config


def on_files(files: Any, config: Any, **_: Any) -> Any:
    """Make a page of each room."""
    for name in room_names():
        files.append(File.generated(config, f"api/{name}.md", content=_room(ROOMS / name)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Fill in what is generated; keep formulas out of Markdown's way."""
    makers = {
        "commands": commands,
        "headers": headers,
        "rooms": rooms,
        "requirements": requirements.format_table_of_project,
    }
    for comment, make in makers.items():
        if f"<!-- {comment} -->" in markdown:
            markdown = markdown.replace(f"<!-- {comment} -->", make())
    markdown = _FILE.sub(_listing, markdown)
    markdown = markdown.replace("<details>", '<details markdown="1">')  # GitHub renders both
    if page.is_homepage:
        markdown = _PICTURE.sub(_FRAME, markdown, count=1)
        page.meta["hide"] = ["navigation", "toc"]  # room for it
    for name, boost in SEARCH_BOOSTS.items():
        if page.file.src_uri.startswith(name):
            page.meta["search"] = {"boost": boost}
    page.formulas = []
    parts = _CODE.split(markdown)
    parts[::2] = [_FORMULA.sub(lambda found: _keep(found, page.formulas), part) for part in parts[::2]]
    return "".join(parts)


def on_post_build(config: Any, **_: Any) -> None:
    """Make the playground that the first page shows. Raises SystemExit where it cannot be compiled."""
    command = [sys.executable, str(ROOT / ".ci/playground.py"), str(Path(config.site_dir) / "play.html")]
    if (status := subprocess.run(command, check=False).returncode) != 0:
        raise SystemExit(status)


def on_page_content(content: str, page: Any, **_: Any) -> str:
    """Name the columns in every cell, put the formulas in, and mark where lines may break."""
    content = re.sub(r"<table>.*?</table>", _labelled, content, flags=re.DOTALL)
    content = _INLINE_CODE.sub(lambda code: _WORD.sub(_breakable, code[0]), content)
    content = _BLOCK.sub(_wrapped, content)
    content = _OPTIMISATION.sub(r'<span class="option">\g<0></span>', content)
    content = re.sub(r"\(?formula\d+formula[),.;:]*", r'<span class="formula">\g<0></span>', content)
    for number, formula in enumerate(page.formulas):
        content = content.replace(f"formula{number}formula", formula)
    return content


def _breakable(word: re.Match[str]) -> str:
    """A short word in code stays in one piece, and a long one may break behind its separators."""
    pieces = [word[0]]
    for separator in (_SEPARATOR, _UNDERSCORE):
        pieces = [
            part
            for piece in pieces
            for part in (separator.split(piece) if len(piece) > _LONGEST_UNBROKEN_WORD else [piece])
        ]
    return "<wbr>".join(
        _unbroken(piece) if len(piece) <= _LONGEST_UNBROKEN_WORD else piece for piece in pieces
    )


def _unbroken(text: str) -> str:
    return f'<span class="word">{text}</span>'


def _unbroken_if_short(word: re.Match[str]) -> str:
    return _unbroken(word[0]) if len(word[0]) <= _LONGEST_UNBROKEN_WORD else word[0]


def _wrapped(block: re.Match[str]) -> str:
    """Lines of code may break, except in tables; what follows a break is indented further than the line."""
    if _TABLE.search(block[1]):
        return block[0].replace('class="', 'class="columns ', 1)
    lines = block[1].removesuffix("\n").split("\n")
    kind = "listing wrapped" if len(lines) > _LINES_OF_A_LISTING else "wrapped"
    code = "\n".join(map(_hanging, lines))
    return f'<div class="{kind} highlight"><pre><span></span><code>{code}</code></pre></div>'


def _hanging(line: str) -> str:
    text = _TAG.sub("", line)
    indent = len(text) - len(text.lstrip(" "))
    line = _LAST_COLUMN.sub(lambda column: _unbroken(column[0]), line)
    line = _START_OF_COMMENT.sub(lambda start: _unbroken(start[0]), line)
    line = _HYPHENATED.sub(_unbroken_if_short, line)
    line = _OPENING.sub(r"\g<0><wbr>", line)
    line = _JSON_MEMBER.sub("<wbr>", line)
    line = _INDENT.sub(r'\1<span class="indent">\2</span>', line)
    return f'<span class="line" style="--indent: {indent}">{line}</span>'


def _keep(found: re.Match[str], formulas: list[str]) -> str:
    block, inline = found.groups()
    formulas.append(convert(block or inline, display="block" if block else "inline"))
    return f"formula{len(formulas) - 1}formula"


def commands() -> str:
    """Every command with its options, from the parsers."""
    groups = (
        f"## {title}\n\n" + "\n".join(_command(name) for name in names) for title, names in cli.GROUPS.items()
    )
    return "\n".join(groups)


def _command(name: str) -> str:
    parser = cli._parser_for(name, cli._load(name))
    parser.color = False  # from Python 3.14 on, where it is True, options have escape codes on a terminal
    parts = [f"### {name}\n\n{parser.description}\n"]
    for group in parser._action_groups:
        actions = [action for action in group._group_actions if action.help is not argparse.SUPPRESS]
        if actions:
            rows = "\n".join(_option(parser, action) for action in actions)
            parts.append(f"\n**{_escaped(group.title)}**\n\n| option | meaning |\n|---|---|\n{rows}\n")
    return "".join(parts) + _epilog(parser.epilog or "")


def _epilog(text: str) -> str:
    """The examples as code, and as paragraphs what follows them: sentences, and what the exit codes mean."""
    lines = text.splitlines()
    examples = [line for line in lines[1:] if line.startswith("  ")]
    sentences, start, codes = " ".join(lines[1 + len(examples) :]).partition("exit code:")
    paragraphs = "\n\n".join(_sentences(paragraph) for paragraph in (sentences.strip(), start + codes))
    return "\n```text\n" + "\n".join([lines[0], *examples]) + f"\n```\n\n{paragraphs}\n\n"


def _option(parser: argparse.ArgumentParser, action: argparse.Action) -> str:
    formatter = parser._get_formatter()
    words = _cell(formatter._format_action_invocation(action))
    meaning = formatter._expand_help(action) if action.help else ""
    return f"| `{words}` | {_sentences(_cell(meaning))} |"


def _sentences(text: str) -> str:
    """Sentences of the help in Markdown, with options as code."""
    return _LONG_OPTION.sub(r"`\g<0>`", _escaped(text))


def _escaped(text: str | None) -> str:
    """Keep Markdown from reading a text."""
    return html.escape(text or "", quote=False).replace("*", r"\*")


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def headers() -> str:
    """The C headers, which document themselves."""
    texts = ((name, (ROOT / f"c_ref/src/{name}.h").read_text(encoding="utf-8")) for name in HEADERS)
    return "\n".join(f"## {name}.h\n\n```c\n{text}```\n" for name, text in texts)


def _listing(comment: re.Match[str]) -> str:
    """Return the C file that a comment asks for as a block of code; a missing file ends the build."""
    text = (ROOT / comment[1]).read_text(encoding="utf-8")
    return f"```c\n{text}```"


def room_names() -> list[str]:
    """The rooms that offer something to others."""
    return sorted(path.parent.name for path in ROOMS.glob("*/__init__.py") if path.parent.name != "cli")


def rooms() -> str:
    """A line on each room, which leads to its page."""
    return "\n".join(f"- [{name}](api/{name}.md): {_title(name)}" for name in room_names())


def _title(room: str) -> str:
    return (import_module(f"mcp_asdf_tools.{room}").__doc__ or "").strip()


def _room(folder: Path) -> str:
    """The public classes and functions of a room, module by module."""
    modules = sorted(path.stem for path in folder.glob("[!_]*.py"))
    names = [f"::: mcp_asdf_tools.{folder.name}.{module}\n" for module in modules]
    return f"# {folder.name}\n\n{_title(folder.name)}\n\n" + "\n".join(names)


def _labelled(table: re.Match[str]) -> str:
    """A table whose cells name their columns, for screens on which each row stands by itself."""
    heads = re.findall(r"<th(?:\s[^>]*)?>(.*?)</th>", table[0], re.DOTALL)
    titles = [re.sub(r"<[^>]+>", "", head).replace('"', "&quot;") for head in heads]

    def row(found: re.Match[str]) -> str:
        cells = iter(titles)
        labelled = re.sub(r"<td", lambda _: f'<td data-label="{next(cells)}"', found[0])
        labelled = re.sub(r"<td(.*?)>(.*?)</td>", _first_cell, labelled, count=1, flags=re.DOTALL)
        return re.sub(r"<td( data.*?)>(.*?)</td>", _value, labelled, flags=re.DOTALL)

    without_blanks = re.sub(r"<td>\s+</td>", "<td></td>", table[0])
    return re.sub(r"<tr[ >].*?</tr>", row, without_blanks, flags=re.DOTALL)


def _first_cell(cell: re.Match[str]) -> str:
    """The name of a row stays on one line if it is short, and a number needs the name of its column."""
    text = html.unescape(_TAG.sub("", cell[2]))
    if _NUMBER.fullmatch(text):
        return f'<td class="short number"{cell[1]}>{cell[2]}</td>'
    if len(text) <= _LONGEST_UNBROKEN_WORD:
        return f'<td class="short"{cell[1]}>{cell[2]}</td>'
    return cell[0]


def _value(cell: re.Match[str]) -> str:
    """A short cell without words, such as a range of numbers, stays on one line."""
    text = html.unescape(_TAG.sub("", cell[2]))
    if len(text) <= _LONGEST_UNBROKEN_WORD and _VALUE.fullmatch(text):
        return f'<td class="short"{cell[1]}>{cell[2]}</td>'
    return cell[0]


class Docstrings(griffe.Extension):
    """Powers in docstrings are written as in Python; in Markdown their stars would make text bold."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite the docstring of each object that is documented."""
        if obj.docstring:
            parts = _CODE.split(obj.docstring.value)
            parts[::2] = [_POWER.sub(r"<sup>\1</sup>", part) for part in parts[::2]]
            obj.docstring.value = "".join(parts)
