"""The page of a run: one HTML file with its style, its scripts and, if it stands alone, the history as JSON.

In JSON a history is its description and blocks of states in base64, which ``page/history.js`` reads.
"""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.view.history import QUANTITIES, History, RunDescription, State

_FOLDER = Path(__file__).parent / "page"
_SAFE_IN_DATA_URL = " !\"$&'()*+,-./:;=>?@[\\]^_`{|}~"
"""Characters that need no escape in a data URL inside HTML."""


def make_page(history: History | None = None) -> str:
    """Return the page with all states of ``history`` in it, as HTML that needs no other file.

    Without a history the page asks the server that it comes from for one.
    """
    if history is None:
        return assemble_page(None)
    update = history.states_since()  # the first one and all that follow
    content = {
        "description": encode_description(update.description),
        "block": encode_states(update.states, update.description),
    }
    return assemble_page(content)


@dataclass(frozen=True)
class PageAdditions:
    """What another page than that of a run has in addition; the defaults add nothing.

    Attributes:
        entry_script: Name of the script that runs first.
        scripts: Further scripts by the names under which they are imported.
        style: CSS after that of the view.
        html: HTML at the end of the body.
        script_policy: Further sources of scripts that the page's security policy allows.
    """

    entry_script: str = "view/main"
    scripts: Mapping[str, str] = field(default_factory=dict)
    style: str = ""
    html: str = ""
    script_policy: str = ""


def assemble_page(content: object, additions: PageAdditions = PageAdditions()) -> str:
    """Return the page, and ``additions`` to it, with ``content`` as JSON: HTML that needs no other file."""
    content_by_placeholder = {
        "__POLICY__": additions.script_policy,
        "__STYLE__": _read_file("uplot/uPlot.min.css") + _read_file("page.css") + additions.style,
        "__MODULES__": json.dumps({"imports": _encode_scripts(additions.scripts)}),
        "__ENTRY_SCRIPT__": additions.entry_script,
        "__UPLOT_LICENSE__": _read_file("uplot/LICENSE"),
        "__UPLOT__": _read_file("uplot/uPlot.iife.min.js"),
        "__MORE_HTML__": additions.html,
        # The last one, since it may hold any text. Without "<", none of it, such as a file's name, can end
        # the script that it is in.
        "__CONTENT__": json.dumps(content).replace("<", "\\u003c"),
    }
    html = _read_file("page.html")
    for placeholder, text in content_by_placeholder.items():
        html = html.replace(placeholder, text)
    return html


def _read_file(name: str) -> str:
    """Return the text of a file of the folder ``page``."""
    return (_FOLDER / name).read_text(encoding="utf-8")


def _encode_scripts(further_scripts: Mapping[str, str]) -> dict[str, str]:
    """Return the URLs of the page's scripts and of further ones, by the names under which they are imported.

    A URL contains its script, since a page opened as a file may load no other files. Most characters of a
    script may stand in such a URL as they are, which is shorter than base64.
    """
    view_scripts = {f"view/{path.stem}": _read_file(path.name) for path in sorted(_FOLDER.glob("*.js"))}
    urls = {}
    for name, script in (view_scripts | dict(further_scripts)).items():
        urls[name] = "data:text/javascript;charset=utf-8," + quote(script, safe=_SAFE_IN_DATA_URL)
    return urls


# --- Histories as JSON --------------------------------------------------------------------------------

_INTEGER_FOR_ONE = 65534
"""The value 1 in a page, where values 0 .. 1 are 16-bit integers: finer than what a screen shows."""
_INTEGER_FOR_UNKNOWN = 65535
"""A value in a page that is not known."""


def encode_description(description: RunDescription) -> dict[str, Any]:
    """Return a description as plain values for the page's scripts, by the names of its attributes.

    "quantities" names the values of a state. "floor" has its rows, columns and bits: each row starts at a new
    byte, and all are compressed, in base64.
    """
    floor = None
    if description.floor is not None:
        rows, columns = description.floor.shape
        row_bytes = np.packbits(description.floor, axis=1).tobytes()
        floor = {"rows": rows, "columns": columns, "bits": _compress_to_base64(row_bytes)}
    # Those that JSON cannot express are replaced.
    return vars(description) | {
        "flawed": list(description.flawed),
        "unfiltered_errors": list(description.unfiltered_errors),
        "floor": floor,
        "quantities": QUANTITIES,
    }


def encode_states(states: Sequence[State], description: RunDescription) -> dict[str, Any]:
    """Return states as their "count" and their "data", compressed and in base64. O(states N + links).

    The data are, one after the other: the ticks (32 bits each); a series of each quantity, then of x and y of
    the positions if robots move (differences of 16 bits from state to state); the number of links in each
    state (32 bits each), then receiver and sender of each link (differences of 16 bits from link to link).
    """
    ticks = np.array([state.tick for state in states], "<u4")
    sections = [ticks.tobytes(), *_encode_quantities(states)]
    if description.sides is not None:
        sections += _encode_positions(states, description.sides)
    sections += _encode_links(states)
    return {"count": len(states), "data": _compress_to_base64(b"".join(sections))}


def _encode_quantities(states: Sequence[State]) -> list[bytes]:
    """Return four series: x, x_hat, b_hat and b. A series has the values of all robots in all states."""
    values = np.stack([state.values for state in states])  # of shape (states, quantities, N)
    return [_encode_series(values[:, index]) for index in range(len(QUANTITIES))]


def _encode_positions(states: Sequence[State], sides: tuple[float, float]) -> list[bytes]:
    """Return the series of x and of y, as shares of an arena with these sides in metres."""
    # Where robots move, every state has positions: the condition is for mypy alone.
    positions = np.stack([state.positions for state in states if state.positions is not None])
    # Metres from the middle of the arena become shares of its sides, 0 to 1 like all other values.
    positions_in_arena = positions / np.array(sides) + 0.5
    xs = positions_in_arena[:, :, 0]
    ys = positions_in_arena[:, :, 1]
    return [_encode_series(xs), _encode_series(ys)]


def _encode_links(states: Sequence[State]) -> list[bytes]:
    """Return the number of links in each state, and the links of all states: receivers and senders.

    Links are 16-bit differences to the link before, the first one to 0, all modulo 65536. Where all robots
    receive from each other, nearly all are the same, so that they compress well.
    """
    link_counts = np.array([len(state.links) for state in states], "<u4")
    links = np.concatenate([state.links for state in states])  # of shape (links of all states, 2)
    before_first_link = np.zeros((1, 2), np.uint16)
    differences = np.diff(links, axis=0, prepend=before_first_link)
    return [link_counts.tobytes(), differences.astype("<u2").tobytes()]


def _encode_series(values: NDArray[np.float64]) -> bytes:
    """Encode values of robots, shape (states, N), as 16-bit differences from state to state, robot by robot.

    Values are limited to 0 .. 1, and NaN means unknown. The first difference of each robot is from 0, and all
    are modulo 65536. Most are small or 0, so that they compress well.
    """
    scaled_values = np.rint(np.clip(values, 0.0, 1.0) * _INTEGER_FOR_ONE)
    integers = np.nan_to_num(scaled_values, nan=_INTEGER_FOR_UNKNOWN).astype(np.uint16)
    integers_by_robot = integers.T  # shape (N, states)
    # Differences of unsigned integers wrap around, and so are modulo 65536.
    differences = np.diff(integers_by_robot, axis=1, prepend=np.uint16(0))
    return differences.astype("<u2").tobytes()


def _compress_to_base64(content: bytes) -> str:
    """Return bytes deflated by zlib, in base64."""
    return base64.b64encode(zlib.compress(content, level=9)).decode("ascii")
