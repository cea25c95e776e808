"""Marks in the HTML of the documentation that say where lines may break, so that pages fit a narrow screen.

In a table every cell names its column, since on such a screen each row stands by itself.
"""

from __future__ import annotations

import html
import re

LONGEST_UNBROKEN_WORD = 26
"""Number of characters up to which a word, or a cell of a table, stays on one line."""
LINES_OF_LONG_LISTING = 50
"""A block of code with more lines is a listing, which the style sheet sets in smaller letters."""

_TAG = re.compile(r"<[^<>]+>")

# Code between words
_INLINE_CODE = re.compile(r"(?<=<code>)[^<\n]+(?=</code>)")
_WORD = re.compile(r"[^ ]{2,}")
_SEPARATOR = re.compile(r"(?<=\w[/:,])(?=\w)|(?<=[a-z]\.)(?=[A-Za-z_]{5})")
_UNDERSCORE = re.compile(r"(?<=\w_)(?<!\btest_)(?=\w)")
_OPTIMISATION_OPTION = re.compile(r"(?<= )-O[0-3s]\b(?=[^<>]*<)")

# Blocks of code
_CODE_BLOCK = re.compile(
    r'<div class="highlight"><pre><span></span><code>(.*?)</code></pre></div>', re.DOTALL
)
_TABLE_IN_CODE = re.compile(r"^(?:<[^<>]+>)*\|.*\|(?:<[^<>]+>)*$|[\u2502\u2503]", re.MULTILINE)
_HYPHENATED_WORD = re.compile(
    r"(?<![\w.&;-])(?:--?\w[\w.]*|\w[\w.]*(?=-\w))(?:-\w[\w.]*)*(?![\w-])(?![^<>]*>)"
)
_START_OF_COMMENT = re.compile(r"(?<![^ >])(?:/\*|//|#) [^ <]{1,24}")
_BEFORE_JSON_MEMBER = re.compile(r'(?<=[^ ],)(?="|&quot;)')
_OPENING_BRACKET = re.compile(r'<span class="[op]">[.(\[]+</span>')
_LAST_COLUMN = re.compile(r"(?<= {3})[^ <][^<]{0,34}$")
_INDENT = re.compile(r"^((?:<[^<>]+>)*)( +)")

# Tables
_TABLE = re.compile(r"<table>.*?</table>", re.DOTALL)
_HEAD_CELL = re.compile(r"<th(?:\s[^>]*)?>(.*?)</th>", re.DOTALL)
_ROW = re.compile(r"<tr[ >].*?</tr>", re.DOTALL)
_NUMBER = re.compile(r"(?=.*\d)(?!.*[a-z]{2})[a-z\d.,+ -]+")
_TEXT_WITHOUT_WORDS = re.compile(r"(?!.*[^\W\d_]{2})[^<>]+")


def mark_line_breaks(page_html: str) -> str:
    """Return the HTML of a page with line breaks marked in code, and with the columns' names in tables."""
    page_html = _TABLE.sub(lambda table: _name_columns_in_cells(table[0]), page_html)
    page_html = _INLINE_CODE.sub(
        lambda code: _WORD.sub(lambda word: _mark_breaks_in_word(word[0]), code[0]), page_html
    )
    page_html = _CODE_BLOCK.sub(_mark_breaks_in_block, page_html)
    return _OPTIMISATION_OPTION.sub(r'<span class="option">\g<0></span>', page_html)


# --- Code between words ----------------------------------------------------------------------------------


def _mark_breaks_in_word(word: str) -> str:
    """Keep a short word in one piece, and let a long one break behind its separators."""
    pieces = [word]
    # Underscores separate only what is still too long without them.
    for separator in (_SEPARATOR, _UNDERSCORE):
        shorter_pieces: list[str] = []
        for piece in pieces:
            is_long = len(piece) > LONGEST_UNBROKEN_WORD
            shorter_pieces += separator.split(piece) if is_long else [piece]
        pieces = shorter_pieces
    return "<wbr>".join(_keep_together_if_short(piece) for piece in pieces)


def _keep_together(text: str) -> str:
    return f'<span class="word">{text}</span>'


def _keep_together_if_short(text: str) -> str:
    return _keep_together(text) if len(text) <= LONGEST_UNBROKEN_WORD else text


# --- Blocks of code --------------------------------------------------------------------------------------


def _mark_breaks_in_block(block: re.Match[str]) -> str:
    """Let the lines of a block of code break, unless they are the rows of a table."""
    code = block[1]
    if _TABLE_IN_CODE.search(code):
        return block[0].replace('class="', 'class="columns ', 1)
    lines = code.removesuffix("\n").split("\n")
    kind = "listing wrapped" if len(lines) > LINES_OF_LONG_LISTING else "wrapped"
    marked_code = "\n".join(_mark_breaks_in_line(line) for line in lines)
    return f'<div class="{kind} highlight"><pre><span></span><code>{marked_code}</code></pre></div>'


def _mark_breaks_in_line(line: str) -> str:
    """Mark where a line of code may break; what follows a break is indented further than the line."""
    visible_text = _TAG.sub("", line)
    indent = len(visible_text) - len(visible_text.lstrip(" "))
    line = _LAST_COLUMN.sub(lambda column: _keep_together(column[0]), line)
    line = _START_OF_COMMENT.sub(lambda start: _keep_together(start[0]), line)
    line = _HYPHENATED_WORD.sub(lambda word: _keep_together_if_short(word[0]), line)
    line = _OPENING_BRACKET.sub(r"\g<0><wbr>", line)
    line = _BEFORE_JSON_MEMBER.sub("<wbr>", line)
    line = _INDENT.sub(r'\1<span class="indent">\2</span>', line)
    return f'<span class="line" style="--indent: {indent}">{line}</span>'


# --- Tables ----------------------------------------------------------------------------------------------


def _name_columns_in_cells(table: str) -> str:
    """Return a table in which each cell has the title of its column as the attribute ``data-label``."""
    titles = [_TAG.sub("", head).replace('"', "&quot;") for head in _HEAD_CELL.findall(table)]

    def mark_row(row: re.Match[str]) -> str:
        remaining_titles = iter(titles)
        marked_row = re.sub(r"<td", lambda _: f'<td data-label="{next(remaining_titles)}"', row[0])
        marked_row = re.sub(r"<td(.*?)>(.*?)</td>", _mark_first_cell, marked_row, count=1, flags=re.DOTALL)
        # The first cell has a class now in front of its label, so that it is not marked again.
        return re.sub(r"<td( data.*?)>(.*?)</td>", _mark_cell_with_value, marked_row, flags=re.DOTALL)

    table = re.sub(r"<td>\s+</td>", "<td></td>", table)
    return _ROW.sub(mark_row, table)


def _mark_first_cell(cell: re.Match[str]) -> str:
    """Keep the first cell of a row, its name, on one line if it is short; a number there gets a class, too.

    With that class the style sheet shows the title of its column, without which a number says nothing.
    """
    attributes, content = cell[1], cell[2]
    visible_text = html.unescape(_TAG.sub("", content))
    if _NUMBER.fullmatch(visible_text):
        return f'<td class="short number"{attributes}>{content}</td>'
    if len(visible_text) <= LONGEST_UNBROKEN_WORD:
        return f'<td class="short"{attributes}>{content}</td>'
    return cell[0]


def _mark_cell_with_value(cell: re.Match[str]) -> str:
    """Keep a short cell without words, such as a range of numbers, on one line."""
    attributes, content = cell[1], cell[2]
    visible_text = html.unescape(_TAG.sub("", content))
    if len(visible_text) <= LONGEST_UNBROKEN_WORD and _TEXT_WITHOUT_WORDS.fullmatch(visible_text):
        return f'<td class="short"{attributes}>{content}</td>'
    return cell[0]
