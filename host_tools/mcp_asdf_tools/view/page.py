"""The page: one HTML file with its style, its scripts and, if it is sent to somebody, the film as JSON.

A film is a stage and blocks of states in base64 (``page/film.js`` reads them).
"""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.view.film import QUANTITIES, History, RunDescription, State
from mcp_asdf_tools.world.topology import MAX_ON_BUS

_FOLDER = Path(__file__).parent / "page"
_MODULES = ("arena", "bus", "charts", "colours", "film", "main", "panels", "player", "playground", "worker")
"""Of ``page/``; they import each other as ``view/NAME``."""


def page(history: History | None = None) -> str:
    """The page with a film in it; without one it asks the server that it comes from."""
    data = "null"
    if history is not None:
        update = history.states_since()
        stage, states = update.description, update.states
        content = {"stage": encode_description(stage), "block": encode_states(states, stage)}
        data = json.dumps(content).replace("<", "\\u003c")  # no text in it can end the script
    return _empty_page().replace("__POLICY__", "").replace("__FILM__", data)


def playground(module: bytes) -> str:
    """The page that computes its films itself, with firmware, engine and arena as a WebAssembly module."""
    data = json.dumps({"module": base64.b64encode(module).decode("ascii")})
    policy = " 'wasm-unsafe-eval'; worker-src data:"
    return _empty_page().replace("__POLICY__", policy).replace("__FILM__", data)


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


# --- Films as JSON ------------------------------------------------------------------------------------

_SCALE, _UNKNOWN = 65534, 65535
"""Values 0 .. 1 are 16-bit integers: a step is a tenth of what a screen shows."""


def encode_description(stage: RunDescription) -> dict[str, Any]:
    """A stage as plain values; the floor as rows of bits, each padded to whole bytes."""
    floor = None
    if stage.floor is not None:
        rows, columns = stage.floor.shape
        bits = _text(np.packbits(stage.floor, axis=1).tobytes())
        floor = {"rows": rows, "columns": columns, "bits": bits}
    plain = vars(stage) | {"twin": [*stage.unfiltered_errors]}
    del plain["unfiltered_errors"]
    return plain | {
        "flawed": [*stage.flawed],
        "floor": floor,
        "quantities": QUANTITIES,
    }


def encode_states(states: Sequence[State], stage: RunDescription) -> dict[str, Any]:
    """A block of states: ticks (32 bits), quantities and positions (16 bits), links, deflated.

    Each series is stored as its differences, which are mostly small or 0. Links are a bit for each two
    robots; of more than MAX_ON_BUS their number in each state (32 bits), then ids (16 bits). O(states N^2).
    """
    parts = [np.array([each.tick for each in states], "<u4").tobytes()]
    values = np.stack([each.values for each in states])
    parts += [_series(values[:, index]) for index in range(len(QUANTITIES))]
    positions = [each.positions for each in states if each.positions is not None]
    if stage.sides is not None:
        places = np.stack(positions) / np.array(stage.sides) + 0.5
        parts += [_series(places[..., axis]) for axis in (0, 1)]
    if len(stage.robots) > MAX_ON_BUS:
        parts.append(np.array([len(each.neighbours) for each in states], "<u4").tobytes())
        parts += [each.neighbours.astype("<u2").tobytes() for each in states]
    else:
        links = np.stack([each.neighbours.ravel() for each in states])
        parts.append(np.packbits(links, axis=1, bitorder="little").tobytes())
    return {"count": len(states), "data": _text(b"".join(parts))}


def _series(values: NDArray[np.float64]) -> bytes:
    """Series of values 0 .. 1, shape (states, N), one robot after the other."""
    known = np.nan_to_num(np.rint(np.clip(values, 0.0, 1.0) * _SCALE), nan=_UNKNOWN).astype(np.uint16)
    return np.diff(known.T, axis=1, prepend=np.uint16(0)).astype("<u2").tobytes()


def _text(content: bytes) -> str:
    return base64.b64encode(zlib.compress(content, 9)).decode("ascii")
