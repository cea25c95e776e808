"""Films as JSON for a page: a stage, and blocks of samples in base64 (``page/film.js`` reads them)."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.view.film import QUANTITIES, Samples, Stage

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
