"""Names, colours and captions of experiments in pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from mcp_asdf_tools.common import (
    COLOURS,
    INK,
    WITHOUT,
    UsageError,
    are_distinct,
    number_in_words,
    period_colour,
)
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.scores import LimitsOf
from mcp_asdf_tools.robots import Filtering

FILTER_NAMES = {
    Filtering.NONE: "no filter",
    Filtering.ASDF_MINUS: "ASDF\N{MINUS SIGN}",
    Filtering.ASDF_PLUS: "ASDF+",
}
_MOST_SERIES = 8
_MOST_PANELS = 32
_NOT_A_SERIES = ("fill_ratio", "true_accuracy", "flawed_accuracy", "flawed", "trials")
_OF_FILTERS = ("filter_period", "omega", "activation")

Name = Callable[[Experiment], str]
"""Names the series that an experiment belongs to."""


def share_of(trials: Trials) -> float:
    """P, the share of flawed robots."""
    return trials.experiment.flawed / trials.experiment.robots


def by_series(experiments: Sequence[Trials], name: Name | None) -> dict[str, list[Trials]]:
    """Swarms without filter first, then those that filter less; named by all that varies unless given."""
    name = name or _name_of(experiments)
    series: dict[str, list[Trials]] = {}
    for trials in sorted(experiments, key=lambda trials: list(Filtering).index(trials.experiment.filter)):
        series.setdefault(name(trials.experiment), []).append(trials)
    return series


def _name_of(experiments: Sequence[Trials]) -> Name:
    """Names made of the parameters that vary; those of filters do not name swarms without one."""
    parameters = [trials.experiment.parameters() for trials in experiments]
    filtering = [each for each in parameters if each["filter"] != Filtering.NONE.value] or parameters
    varying = [
        key
        for key in parameters[0]
        if key not in (*_NOT_A_SERIES, "filter")
        and len({each[key] for each in (filtering if key in _OF_FILTERS else parameters)}) > 1
    ]

    def name(experiment: Experiment) -> str:
        has_filter = experiment.filter is not Filtering.NONE
        own = [key for key in varying if has_filter or key not in _OF_FILTERS]
        return ", ".join(
            [FILTER_NAMES[experiment.filter], *(_words(key, experiment.parameters()[key]) for key in own)]
        )

    return name


def _words(key: str, value: Any) -> str:
    words = number_in_words(value)
    if key == "filter_period":
        return rf"$\tau$ = {words}"
    return words if isinstance(value, str) else f"{key.replace('_', ' ')} {words}"


def check_size(panels: int, series: int) -> None:
    """Raise UsageError if that is more than fits a picture."""
    if panels > _MOST_PANELS or series > _MOST_SERIES:
        raise UsageError(
            f"{panels} panels with {series} series do not fit a picture; "
            f"plot at most {_MOST_PANELS} with {_MOST_SERIES}, or a parameter along an axis: "
            "--kind curve --x NAME"
        )


# --- Colours ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Style:
    """Look of a series.

    Attributes:
        colour: Grey without a filter, green by the filtering period.
        is_hollow: True for the first of two of one colour.
    """

    colour: str
    is_hollow: bool = False

    @property
    def face(self) -> str:
        """Colour of an area."""
        return "white" if self.is_hollow else self.colour

    @property
    def edge(self) -> str:
        """Colour of the line around it."""
        return self.colour if self.is_hollow else INK


def styles_of(series: dict[str, list[Trials]]) -> dict[str, Style]:
    """Looks of series that differ in filter or filtering period, and in one thing more; otherwise any."""
    colours = {name: _colour_of([each.experiment for each in own]) for name, own in series.items()}
    found = [colour for colour in colours.values() if colour]
    are_crowded = any(found.count(colour) > 2 for colour in found) or not are_distinct(found)
    if len(found) < len(series) or are_crowded:
        return {name: Style(colour) for name, colour in zip(series, COLOURS, strict=False)}
    return {
        name: Style(colour, colour in found[index + 1 :])
        for index, (name, colour) in enumerate(zip(series, found, strict=True))
    }


def _colour_of(experiments: Sequence[Experiment]) -> str | None:
    """None if they do not have one filtering period in common."""
    if all(each.filter is Filtering.NONE for each in experiments):
        return WITHOUT
    periods = {each.filter_period for each in experiments}
    return None if len(periods) > 1 else period_colour(periods.pop())


# --- Captions --------------------------------------------------------------------------------------------

_LETTERS = {
    "robots": "{} robots",
    "topology": "{}",
    "steps": "{} steps",
    "filter_period": r"$\tau$ = {}",
    "omega": r"$\omega$ = {}",
    "density": "$D$ = {}",
    "seed": "seed {}",
}


def caption_of(experiments: Sequence[Trials], *more: str, limits: LimitsOf | None = None) -> str:
    """Parameters that all experiments have in common, their trials, limits of the scores, and ``more``."""
    parameters = [trials.experiment.parameters() for trials in experiments]
    common = [
        words.format(number_in_words(parameters[0][name]))
        for name, words in _LETTERS.items()
        if _is_common(name, parameters)
    ]
    words = [", ".join([*common, trials_in_words(experiments)])]
    if limits is not None:
        words.append(_limits_in_words({limits(trials.experiment) for trials in experiments}))
    return "; ".join([*words, *more]) + "."


def _is_common(name: str, parameters: Sequence[dict[str, Any]]) -> bool:
    """True if a parameter has one value, and one that matters."""
    if name == "density" and any(each["topology"] != "dynamic" or each["width"] for each in parameters):
        return False
    own = parameters
    if name in _OF_FILTERS:
        own = [each for each in parameters if each["filter"] != Filtering.NONE.value]
    return len({each[name] for each in own}) == 1


def trials_in_words(experiments: Sequence[Trials]) -> str:
    """How many trials each experiment has."""
    counts = {len(trials.numbers) for trials in experiments}
    if len(counts) > 1:
        return f"{min(counts)} to {max(counts)} trials of each experiment"
    return f"{min(counts)} trial{'s' * (counts != {1})} of each experiment"


def _limits_in_words(limits: set[Any]) -> str:
    k_max, e_max = (sorted({each[index] for each in limits}) for index in (0, 1))
    return "$K_{max}$ = " + _listed(k_max) + ", $e_{max}$ = " + _listed(e_max)


def _listed(values: Sequence[float]) -> str:
    return " and ".join(number_in_words(value) for value in values)
