"""The page: one HTML file with its style, its scripts and, if it is sent to somebody, the film."""

from __future__ import annotations

import base64
import json
from functools import cache
from pathlib import Path

from mcp_asdf_tools.view.film import Film
from mcp_asdf_tools.view.wire import samples_as_plain, stage_as_plain

_FOLDER = Path(__file__).parent / "page"
_MODULES = ("arena", "charts", "colours", "film", "main", "panels", "player")
"""Of ``page/``; they import each other as ``view/NAME``."""


def page(film: Film | None = None) -> str:
    """The page with a film in it; without one it asks the server that it comes from."""
    data = "null"
    if film is not None:
        content = {"stage": stage_as_plain(film.stage), "block": samples_as_plain(film.samples, film.stage)}
        data = json.dumps(content).replace("<", "\\u003c")  # no text in it can end the script
    return _empty_page().replace("__FILM__", data)


@cache
def _empty_page() -> str:
    """The page before a film is put in."""
    modules = {f"view/{name}": _as_url(_read(f"{name}.js")) for name in _MODULES}
    parts = {
        "__STYLE__": _read("uplot/uPlot.min.css") + _read("page.css"),
        "__MODULES__": json.dumps({"imports": modules}),
        "__UPLOT_LICENSE__": _read("uplot/LICENSE"),
        "__UPLOT__": _read("uplot/uPlot.iife.min.js"),
    }
    text = _read("page.html")
    for place, content in parts.items():
        text = text.replace(place, content)
    return text


def _read(name: str) -> str:
    return (_FOLDER / name).read_text(encoding="utf-8")


def _as_url(script: str) -> str:
    """A module as a URL, since a page opened as a file may load no other files."""
    return "data:text/javascript;base64," + base64.b64encode(script.encode()).decode("ascii")
