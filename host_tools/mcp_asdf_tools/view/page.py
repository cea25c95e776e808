"""The page: one HTML file with its style, its scripts and, if it is sent to somebody, the film as JSON.

A film is a stage and blocks of samples in base64 (``page/film.js`` reads them).
"""

from __future__ import annotations

import base64
import json
import zlib
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.view.film import QUANTITIES, Film, Samples, Stage

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


# --- Films as JSON ------------------------------------------------------------------------------------

_SCALE, _UNKNOWN = 65534, 65535
"""Values 0 .. 1 are 16-bit integers: a step is a tenth of what a screen shows."""


def stage_as_plain(stage: Stage) -> dict[str, Any]:
    """A stage as plain values; the floor as rows of bits, each padded to whole bytes."""
    floor = None
    if stage.floor is not None:
        rows, columns = stage.floor.shape
        bits = _text(np.packbits(stage.floor, axis=1).tobytes())
        floor = {"rows": rows, "columns": columns, "bits": bits}
    return {
        "title": stage.title,
        "robots": list(stage.robots),
        "flawed": list(stage.flawed),
        "fillRatio": stage.fill_ratio,
        "steps": stage.steps,
        "stepsPerSecond": stage.steps_per_second,
        "commsPeriod": stage.comms_period,
        "sides": stage.sides,
        "radioRange": stage.radio_range,
        "quantities": QUANTITIES,
        "floor": floor,
    }


def samples_as_plain(samples: Samples, stage: Stage) -> dict[str, Any]:
    """A block of samples: ticks (32 bits), quantities and positions (16 bits), links (1 bit), deflated.

    Each series is stored as its differences, which are mostly small or 0. O(samples N^2).
    """
    count = len(samples.ticks)
    parts = [samples.ticks.astype("<u4").tobytes()]
    parts += [_series(samples.values[:, index]) for index in range(len(QUANTITIES))]
    if samples.positions is not None and stage.sides is not None:
        places = samples.positions / np.array(stage.sides) + 0.5
        parts += [_series(places[..., axis]) for axis in (0, 1)]
    parts.append(np.packbits(samples.hears.reshape(count, -1), axis=1, bitorder="little").tobytes())
    return {"count": count, "data": _text(b"".join(parts))}


def _series(values: NDArray[np.float64]) -> bytes:
    """Series of values 0 .. 1, shape (samples, N), one robot after the other."""
    known = np.nan_to_num(np.rint(np.clip(values, 0.0, 1.0) * _SCALE), nan=_UNKNOWN).astype(np.uint16)
    return np.diff(known.T, axis=1, prepend=np.uint16(0)).astype("<u2").tobytes()


def _text(content: bytes) -> str:
    return base64.b64encode(zlib.compress(content, 9)).decode("ascii")
