"""Pictures of scores: by cell, against each other, and over any parameter; and over time."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Literal, cast

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError, offer
from mcp_asdf_tools.common.figures import (
    COLOURS,
    FLAWED,
    INK,
    MEDIUM,
    OTHER,
    SMALL,
    WIDTH,
    add_caption,
    add_legend,
    clean,
    empty_figure,
    number_in_words,
    ordered_colours,
)
from mcp_asdf_tools.common.parameters import parameters_of
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.scores import PAPERS, SCORES, Limits
from mcp_asdf_tools.robots.filters import FILTERS

_BOXES = (
    "a point is a trial; boxes from quartile to quartile with the median, whiskers to the last trial within "
    "1.5 of their length"
)
_SCATTER = (
    "a point is a trial: blue where flawed robots are overconfident, red where they are underconfident, "
    "darker the farther off"
)
FEWEST = 6
"""Trials from which on a median has a 95 % interval."""
_MOST_SERIES, _MOST_PANELS = 8, 32
_OF_CELLS = ("fill_ratio", "true_accuracy", "flawed_accuracy", "flawed", "trials", "filter")
"""What pictures say without a parameter's name."""
_FILTER_PARAMETERS = ("filter_period", "omega", "activation")

Name = Callable[[Experiment], str]
"""Names the series that an experiment belongs to."""


# --- What all share --------------------------------------------------------------------------------------


def _panels(
    rows: int, columns: int, height: float, series: int, sharex: bool = True
) -> tuple[Figure, NDArray[Any]]:
    """A figure of empty panels. Raises UsageError if panels or series are too many."""
    if rows * columns > _MOST_PANELS or series > _MOST_SERIES:
        raise UsageError(
            f"{rows * columns} panels with {series} series do not fit a picture; plot at most "
            f"{_MOST_PANELS} with {_MOST_SERIES}, or a parameter along an axis: --kind curve --x NAME"
        )
    figure = empty_figure(WIDTH if columns > 1 else 0.7 * WIDTH, 1.4 + height * rows)
    return figure, figure.subplots(rows, columns, sharex=sharex, sharey=True, squeeze=False)


def _panels_in_rows(count: int, height: float, series: int = 1, most: int = 3) -> tuple[Figure, list[Axes]]:
    """A figure of so many panels, in rows of ``most``. Raises UsageError as ``_panels``."""
    columns = min(count, most)
    figure, grid = _panels(-(-count // columns), columns, height, series)
    for axes in grid.flat[count:]:
        axes.set_axis_off()
    return figure, [*grid.flat[:count]]


def _finish(figure: Figure, labels: tuple[str, str], words: str, handles: Sequence[Line2D]) -> Figure:
    """Names of the axes, a caption and a legend."""
    figure.supylabel(labels[1], fontsize=MEDIUM)
    add_caption(figure, labels[0], words)
    add_legend(figure, handles)
    return figure


def _handle(label: str, colour: str, marker: str = "o", line: Literal["", "-"] = "") -> Line2D:
    return Line2D([], [], linestyle=line, marker=marker, color=colour, label=label)


def filter_name(experiment: Experiment) -> str:
    """The paper's name of who filters, or robust."""
    return experiment.swarm_filter.typeset_term


def _share(experiment: Experiment) -> float:
    """P, the share of flawed robots."""
    return float(experiment.flawed / experiment.robots)


def _offset(experiment: Experiment) -> float:
    """b_hat less b of flawed robots; 0 where there are none."""
    return round(experiment.flawed_accuracy - experiment.true_accuracy, 9) if experiment.flawed else 0.0


def _by_series(experiments: Sequence[Trials], name: Name | None) -> dict[str, list[Trials]]:
    """Swarms without filter first, then those that filter less, then robust ones; named by all that varies
    unless given."""
    name = name or _name_of(experiments)
    series: dict[str, list[Trials]] = {}
    for trials in sorted(experiments, key=lambda trials: _place("filter", trials.experiment.filter)):
        series.setdefault(name(trials.experiment), []).append(trials)
    return series


def _name_of(experiments: Sequence[Trials]) -> Name:
    """Names made of the parameters that vary; those of filters do not name swarms without one."""
    varying = _varying(experiments, *_OF_CELLS)

    def name(experiment: Experiment) -> str:
        words = [filter_name(experiment)]
        for key in varying:
            if _has(experiment, key):
                words.append(f"{key.replace('_', ' ')} {number_in_words(experiment.parameters()[key])}")
        return ", ".join(words)

    return name


def _varying(experiments: Sequence[Trials], *others: str) -> list[str]:
    """The parameters in which experiments differ, but for ``others``; of filters those that run."""
    every = [(trials.experiment, trials.experiment.parameters()) for trials in experiments]
    return [
        name
        for name in parameters_of(Experiment)
        if name not in others
        and len({parameters[name] for experiment, parameters in every if _has(experiment, name)}) > 1
    ]


def _has(experiment: Experiment, name: str) -> bool:
    """Whether a parameter means anything in an experiment: those of filters do not in all."""
    if name not in _FILTER_PARAMETERS:
        return True
    return experiment.swarm_filter.is_on and name not in experiment.unused_parameters()


def _place(name: str, value: Any) -> Any:
    """What values of a parameter are sorted by."""
    return list(FILTERS).index(value) if name == "filter" else value


def _colours_of(series: dict[str, list[Trials]]) -> list[str]:
    """Colours of series whose experiments have one filter each, or several."""
    filters = [{each.experiment.filter for each in own} for own in series.values()]
    return filter_colours([each.pop() if len(each) == 1 else "" for each in filters])


def filter_colours(filters: Sequence[str]) -> list[str]:
    """Return a colour for each series, by the name of its filter: the filter's colour for its first series,
    otherwise the next free one of the palette. A name that is none, such as "", gets a free one, too."""
    filter_colours = {name: known.colour for name, known in FILTERS.items() if known.colour is not None}
    free_colours = iter([colour for colour in COLOURS if colour not in filter_colours.values()])
    series_colours: list[str] = []
    for name in filters:
        colour = filter_colours.pop(name, None)
        series_colours.append(next(free_colours) if colour is None else colour)
    return series_colours


def _caption(experiments: Sequence[Trials], marks: str, limits: Limits) -> str:
    """Parameters that all experiments have in common, their trials, limits of the scores, and ``marks``."""
    words: list[str] = []
    filter_names = {filter_name(trials.experiment) for trials in experiments}
    if len(filter_names) == 1:
        words += filter_names
    for name in ("robots", "topology", "steps", "seed", *_FILTER_PARAMETERS[:2]):
        own = [trials.experiment for trials in experiments if _has(trials.experiment, name)]
        common = {experiment.parameters()[name] for experiment in own}
        if len(common) == 1:
            words.append(f"{name.replace('_', ' ')} {number_in_words(common.pop())}")
    counts = {len(trials.numbers) for trials in experiments}
    words.append(f"{' to '.join(map(str, sorted({min(counts), max(counts)})))} trials of each experiment")
    chosen = [limits.of(trials.experiment) for trials in experiments]
    for name, values in zip(("K", "e"), zip(*chosen, strict=True), strict=True):
        words.append(f"${name}_{{max}}$ = {' and '.join(map(number_in_words, sorted(set(values))))}")
    return f"{', '.join(words)}; {marks}."


# --- Scores by cell --------------------------------------------------------------------------------------


def boxes(experiments: Sequence[Trials], limits: Limits = PAPERS, name: Name | None = None) -> Figure:
    """H over the proportion of flawed robots P and their accuracy b_hat: a panel for each f and b, as in the
    paper's figures 3 and 5; a colour for each ``name``, by default made of all else that varies.

    A point for each trial shows what a box hides: cells whose trials fall into two groups. Raises UsageError
    if there is more than fits a picture, as ``scatter`` does.
    """
    series = _by_series(experiments, name)
    colours, width = _colours_of(series), 0.86 / len(series)
    fills, accuracies = _values(experiments, "fill_ratio"), _values(experiments, "true_accuracy")
    figure, grid = _panels(len(fills), len(accuracies), 2.6, len(series), sharex=False)
    for (row, column), axes in np.ndenumerate(grid):
        f, b = fills[row], accuracies[column]
        cells = [
            (index, trials)
            for index, own in enumerate(series.values())
            for trials in own
            if (trials.experiment.fill_ratio, trials.experiment.true_accuracy) == (f, b)
        ]
        places = [(_share(trials.experiment), _offset(trials.experiment)) for _, trials in cells]
        slots = sorted(set(places))
        for (index, trials), place in zip(cells, places, strict=True):
            middle = slots.index(place) + (index + 0.5) * width - 0.43
            _draw_cell(axes, trials.scores(limits)["H"], middle, 0.85 * width, colours[index])
        axes.set(ylim=(0, 103), xlim=(-0.5, len(slots) - 0.5))
        axes.set_xticks(range(len(slots)), [f"{offset:+.2g}\n{share:.0%}" for share, offset in slots])
        axes.set_title(f"$f = {f:g}$, $b = {b:g}$", fontsize=MEDIUM)
        clean(axes)
    labels = (r"$\hat{b} - b$ of flawed robots, and their proportion $P$", "score $H$")
    handles = [_handle(key, colour, "s") for key, colour in zip(series, colours, strict=True)]
    return _finish(figure, labels, _caption(experiments, _BOXES, limits), handles)


_GOLDEN = 0.618


def _draw_cell(axes: Axes, scores: NDArray[np.float64], place: float, width: float, colour: str) -> None:
    """A box, and a point for each trial, spread evenly over its width."""
    line = {"color": colour, "linewidth": 0.8}
    axes.boxplot(
        scores,
        positions=[place],
        widths=width,
        showfliers=False,
        medianprops={"color": INK, "linewidth": 1.2},
        boxprops=line,
        whiskerprops=line,
        capprops=line,
    )
    aside = (np.arange(len(scores)) * _GOLDEN % 1 - 0.5) * width
    axes.plot(place + aside, scores, ".", color=colour, markersize=3.5, alpha=0.6, markeredgewidth=0)


def scatter(experiments: Sequence[Trials], limits: Limits = PAPERS) -> Figure:
    """h_e against h_K, a point for each trial, as the paper's figure 4: a row for each series and f, a column
    for each P; overconfident swarms blue, underconfident ones red, a shape for each b."""
    series, fills = _by_series(experiments, None), _values(experiments, "fill_ratio")
    shares = _values(experiments, "flawed")
    accuracies = _values(experiments, "true_accuracy")
    rows = [(key, f) for key in series for f in fills]
    figure, grid = _panels(len(rows), len(shares), 1.7, len(series))
    looks = {}
    for (row, column), axes in np.ndenumerate(grid):
        key, f = rows[row]
        for trials in series[key]:
            experiment = trials.experiment
            if (experiment.fill_ratio, _share(experiment)) != (f, shares[column]):
                continue
            b, offset, scores = experiment.true_accuracy, _offset(experiment), trials.scores(limits)
            look = looks[b, offset] = _shade(offset), _MARKERS[accuracies.index(b) % len(_MARKERS)]
            axes.plot(scores["h_K"], scores["h_e"], look[1], color=look[0], markersize=3, alpha=0.6)
        axes.set_title(f"{key}\n$f = {f:g}$, $P$ = {shares[column]:.0%}", fontsize=SMALL)
        axes.set(xlim=(-4, 104), ylim=(-4, 104))
        clean(axes)
    handles = [
        _handle(
            rf"$b$ = {b:g}, $\hat{{b}}$ = {b + offset:g}" if offset else f"$b$ = {b:g}, none flawed", *look
        )
        for (b, offset), look in sorted(looks.items())
    ]
    labels = ("convergence score $h_K$", "accuracy score $h_e$")
    return _finish(figure, labels, _caption(experiments, _SCATTER, limits), handles)


_MARKERS = "osD^v"


def _shade(offset: float) -> str:
    """Blue above 0, red below, darker the farther off; -0.5 and 0.5 are the ends."""
    return to_hex(colormaps["RdBu"](0.5 + offset)) if offset else INK


# --- Over a parameter ------------------------------------------------------------------------------------

MEASURES = (*SCORES, "K", "e")

Measure = Callable[[Trials], NDArray[np.float64]]
"""A value for each trial of an experiment."""


def curve(  # noqa: PLR0913 (each is given by name)
    experiments: Sequence[Trials],
    x: str,
    hue: str = "",
    y: str | Measure = "H",
    limits: Limits = PAPERS,
    *,
    facet: str = "",
    ax: Axes | None = None,
) -> Figure:
    """The median of ``y``, one of MEASURES or a function, over the parameter ``x`` with its 95 % interval: a
    curve for each value of the parameter ``hue``, a panel for each of ``facet``; or drawn into ``ax``.

    Flawed robots are a share. Raises UsageError for unknown parameters, and if the experiments differ in any
    other.
    """
    _check_axes(experiments, x, hue, y, facet)
    hues: list[Any] = _values(experiments, hue) if hue else [None]
    colours = filter_colours(hues) if hue == "filter" else ordered_colours(len(hues))
    looks = dict(zip(hues, colours, strict=True))
    handles = [_handle(_said(hue, each), colour, line="-") for each, colour in looks.items() if hue]
    labels = (_word(x), y if isinstance(y, str) else getattr(y, "__name__", "y"))

    def draw(axes: Axes, own: Sequence[Trials]) -> None:
        for chosen, colour in looks.items():
            measured = {
                _value(each.experiment, x): _measured(each, y, limits)
                for each in own
                if not hue or _value(each.experiment, hue) == chosen
            }
            _draw_curve(axes, measured, _values(experiments, x), colour)

    if ax is not None:
        if facet:
            raise UsageError("facet makes panels and ax is one; give one of them")
        draw(ax, experiments)
        ax.set(xlabel=labels[0], ylabel=labels[1])
        if hue:
            ax.legend(handles=handles, frameon=False, fontsize=SMALL)
        return cast(Figure, ax.get_figure(root=True))
    facets: list[Any] = _values(experiments, facet) if facet else [None]
    figure, panels = _panels_in_rows(len(facets), 3.8 if len(facets) == 1 else 2.6, len(hues))
    for axes, value in zip(panels, facets, strict=True):
        draw(axes, [each for each in experiments if not facet or _value(each.experiment, facet) == value])
        if facet:
            axes.set_title(_said(facet, value), fontsize=MEDIUM)
    words = f"points are medians over the trials, {_interval_words(experiments)}"
    return _finish(figure, labels, _caption(experiments, words, limits), handles)


def _draw_curve(
    axes: Axes, measured: Mapping[Any, NDArray[np.float64]], places: Sequence[Any], colour: str
) -> None:
    """A curve through the medians of what was measured at some places; long texts stand in a row."""
    is_long = any(isinstance(each, str) and len(each) > _LONGEST for each in places)
    own = [place for place in places if place in measured]
    if own:
        at = [places.index(each) for each in own] if is_long else own
        _draw_band(axes, at, _intervals(measured[place] for place in own), colour, "o-")
    if is_long:
        axes.set_xticks(range(len(places)), [_shortened(each) for each in places])
    clean(axes)


def _draw_band(axes: Axes, at: Any, values: NDArray[np.float64], colour: str, style: str = "-") -> None:
    """A line in a band, whose ``values`` are middle, low and high."""
    middle, low, high = values
    axes.fill_between(at, low, high, facecolor=colour, alpha=0.2)
    axes.plot(at, middle, style, color=colour, markersize=3.5, linewidth=1.4)


def _measured(trials: Trials, y: str | Measure, limits: Limits) -> NDArray[np.float64]:
    """The values of ``y``. Raises UsageError unless a function gives one number for each trial."""
    if isinstance(y, str):
        return np.asarray(trials.measures(limits)[y], dtype=np.float64)  # updates are counted in integers
    values = np.asarray(y(trials), dtype=np.float64)
    if values.shape != (len(trials.numbers),):
        raise UsageError(
            f"y gives shape {values.shape}; return a number for each of {len(trials.numbers)} trials"
        )
    return values


def _said(name: str, value: Any) -> str:
    """A parameter and its value."""
    return f"{_word(name)} {_shortened(number_in_words(value))}"


def _shortened(text: str) -> str:
    """A text that fits a legend: the edges of a graph do not."""
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."


_LONGEST = 20


def _interval_words(experiments: Sequence[Trials]) -> str:
    """What the band around a median covers."""
    if min(len(trials.numbers) for trials in experiments) < FEWEST:
        return f"bands all trials where there are fewer than {FEWEST}, else 95 % intervals of the medians"
    return "bands their 95 % intervals"


def _values(experiments: Sequence[Trials], name: str) -> list[Any]:
    """Values of a parameter; filters from none to robust."""
    values = {_value(trials.experiment, name) for trials in experiments}
    return sorted(values, key=lambda value: _place(name, value))


def _word(name: str) -> str:
    return "share of flawed robots" if name == "flawed" else name.replace("_", " ")


def _value(experiment: Experiment, name: str) -> Any:
    """A parameter's value for an axis: P as a share, words for choices."""
    return _share(experiment) if name == "flawed" else experiment.parameters()[name]


def _check_axes(experiments: Sequence[Trials], x: str, hue: str, y: str | Measure, facet: str) -> None:
    known = parameters_of(Experiment)
    for option, name in (("x", x), ("hue", hue), ("facet", facet)):
        if name not in known and (name or option == "x"):
            fix = offer(name, known) or f"; choose a parameter: {', '.join(known)}"
            raise UsageError(f"{option} is {name!r}{fix}")
    if not callable(y) and y not in MEASURES:
        raise UsageError(f"y is {y!r}; choose one of {', '.join(MEASURES)}")
    others = _varying(experiments, x, hue, facet, "trials", "flawed")
    if "flawed" not in (x, hue, facet) and len({_share(each.experiment) for each in experiments}) > 1:
        others.append("flawed")
    if others:
        raise UsageError(
            f"the results differ in {', '.join(others)} too; choose with where NAME=VALUE, or name one "
            "with x, hue or facet"
        )


def _intervals(samples: Iterable[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Medians of samples with their intervals, shape (3, samples)."""
    return np.array([median_interval(sample) for sample in samples]).T


def median_interval(sample: NDArray[np.float64]) -> tuple[float, float, float]:
    """The median and its 95 % interval from order statistics, exact for any distribution; of fewer than six
    trials, their extremes."""
    from scipy.stats import quantile_test  # type: ignore[import-untyped]  # noqa: PLC0415 (loads slowly)

    low, high = quantile_test(sample, p=0.5).confidence_interval(0.95)
    ends = (low, high) if low <= high else (sample.min(), sample.max())  # NaN, NaN where there is none
    return float(np.median(sample)), float(ends[0]), float(ends[1])


# --- Over time -------------------------------------------------------------------------------------------


def errors_over_time(panels: Mapping[str, Sequence[Trials]], limits: Limits = PAPERS) -> Figure:
    """The mean error |x - f| of a swarm over time: a panel for each title, in it a line for each filter.

    Trials of one panel and filter are taken together. All need records of x.
    """
    together = [trials for own in panels.values() for trials in own]
    filters = {trials.experiment.filter for trials in together}
    all_looks = zip(FILTERS, filter_colours([*FILTERS]), strict=True)
    looks = [(each, colour) for each, colour in all_looks if each in filters]
    figure, grid = _panels_in_rows(len(panels), 1.9, len(looks))
    for axes, (title, own) in zip(grid, panels.items(), strict=True):
        axes.set_title(title, fontsize=SMALL, loc="left")
        for each, colour in looks:
            chosen = [trials for trials in own if trials.experiment.filter == each]
            if chosen:
                errors = [abs(t.records["x"] - t.experiment.fill_ratio).mean(axis=2) for t in chosen]
                found = _intervals(np.concatenate(errors).T)
                _draw_band(axes, np.arange(found.shape[1]) * own[0].sampling_interval, found, colour)
        axes.set_yscale("log")
        clean(axes)
    handles = [_handle(FILTERS[each].typeset_term, colour, "", "-") for each, colour in looks]
    words = f"lines are medians over the trials of a swarm's mean error, {_interval_words(together)}"
    return _finish(figure, ("step", "error |x \u2212 f|"), _caption(together, words, limits), handles)


_OFF = 0.05
"""Error above which b_hat is counted as wrong."""
_BANDS = "lines are medians over robots and trials, bands the middle 90 %"


def bands(experiments: Sequence[Trials], limits: Limits = PAPERS) -> Figure:
    """b_hat of all robots over all trials: the median and the middle 90 % after each filter step, a panel for
    each experiment; its title says how many of the robots that began with the right accuracy end far off it.

    Raises UsageError if there are too many, or no filter step.
    """
    if any(not trials.b_hat.shape[1] for trials in experiments):
        raise UsageError("these trials have no filter step; run more steps, or a shorter filter_period")
    figure, grid = _panels_in_rows(len(experiments), 2.1, most=2 if len(experiments) == 4 else 3)
    ordered = [trials for own in _by_series(experiments, filter_name).values() for trials in own]
    for axes, trials, title in zip(grid, ordered, _titles(ordered), strict=True):
        _draw_bands(axes, trials, title)
    handles = [_handle(*look, "", "-") for look in (("flawed", FLAWED), ("healthy", OTHER), ("true", INK))]
    labels = ("step", r"assumed accuracy $\hat{b}$")
    return _finish(figure, labels, _caption(experiments, _BANDS, limits), handles)


def _titles(experiments: Sequence[Trials]) -> list[str]:
    """f, b, b_hat and P of each experiment, and every other parameter in which they differ."""
    varying = _varying(experiments, *_OF_CELLS)
    filters = {each.experiment.filter for each in experiments}
    titles = []
    for each in (trials.experiment for trials in experiments):
        words = [_said(name, each.parameters()[name]) for name in varying if _has(each, name)]
        words += [f"$f$ = {each.fill_ratio:g}", f"$b$ = {each.true_accuracy:g}"]
        words += [rf"$\hat{{b}}$ = {each.flawed_accuracy:g}", f"$P$ = {_share(each):.0%}"]
        whole = ", ".join(words).replace(" = ", "\N{NO-BREAK SPACE}=\N{NO-BREAK SPACE}")
        lines = textwrap.wrap(whole, _TITLE)
        titles.append("\n".join([filter_name(each), *lines] if len(filters) > 1 else lines))
    return titles


_TITLE = 56
"""Letters of a line, those of formulas, which are drawn shorter, included."""


def _draw_bands(axes: Axes, trials: Trials, title: str) -> None:
    e = trials.experiment
    at = e.filter_period * np.arange(1, trials.b_hat.shape[1] + 1)
    flawed, healthy = np.split(trials.b_hat, [e.flawed], axis=2)
    for colour, values in ((FLAWED, flawed), (OTHER, healthy)):
        if values.size:
            _draw_band(axes, at, np.percentile(values, [50, 5, 95], axis=(0, 2)), colour)
    axes.axhline(e.true_accuracy, color=INK, linewidth=1.2, linestyle="--")
    right = e.unflawed_accuracy or e.true_accuracy
    off = f"{np.mean(abs(healthy[:, -1] - right) > _OFF):.0%} of healthy robots" if healthy.size else "-"
    axes.set_title(f"{title}\nmore than {_OFF} off: {off}", fontsize=SMALL)
    clean(axes)


_SERIES = (
    ("b_hat", r"assumed accuracy $\hat{b}$", "b", "true_accuracy"),
    ("x_hat", r"local estimate $\hat{x}$", "f", "fill_ratio"),
    ("x", r"informed estimate $x$", "f", "fill_ratio"),
)
"""A quantity and its label; the letter and the parameter of its true value."""
_LINES = ("flawed robots", "healthy robots", "true value")


def series_beside(runs: Sequence[Trials], number: int) -> Figure:
    """b_hat, x_hat and x of every robot over the steps of one recorded trial of each run, side by side, as in
    the paper's figure 6.

    Raises UsageError if there is no such trial or nothing was recorded.
    """
    for trials in runs:
        if number not in trials.numbers:
            there = f"{trials.numbers[0]} .. {trials.numbers[-1]}"
            raise UsageError(f"there is no trial {number}; choose one of {there}")
        if not trials.records:
            raise UsageError("nothing was recorded over time; run mcp-asdf simulate with --record")
    figure, longest = empty_figure(WIDTH, 7.5), max(trials.experiment.steps for trials in runs)
    grid = figure.subplots(len(_SERIES), len(runs), sharex=True, sharey="row", squeeze=False)
    for row, panel in zip(grid, _SERIES, strict=True):
        shown = [_draw_panel(axes, trials, number, panel) for axes, trials in zip(row, runs, strict=True)]
        low, high = min(map(np.min, shown)), max(map(np.max, shown))
        margin = max(0.06 * (high - low), 0.01)
        row[0].set(xlim=(0, longest), ylim=(low - margin, high + margin))
    for trials, column in zip(runs, grid.T, strict=True):
        title = _title(trials.experiment, number)
        column[0].set_title(title, fontsize=SMALL, loc="left")
        column[-1].set_xlabel("step", fontsize=MEDIUM)
    for axes, (_, label, *_) in zip(grid[:, 0], _SERIES, strict=True):
        axes.set_ylabel(label, fontsize=MEDIUM)
    lines = {line.get_label(): line for axes in grid.flat for line in axes.lines}
    add_legend(figure, [lines[label] for label in _LINES if label in lines])
    return figure


def _title(experiment: Experiment, number: int) -> str:
    words = filter_name(experiment)
    if experiment.swarm_filter.is_on:
        words += rf", $\tau$ = {experiment.filter_period}"
    robots = f"{experiment.robots} robots, {experiment.flawed} flawed"
    topology = experiment.parameters()["topology"]
    return f"{words}: {robots},\n{topology}, seed {experiment.seed}, trial {number}"


def _draw_panel(
    axes: Axes, trials: Trials, number: int, panel: tuple[str, str, str, str]
) -> NDArray[np.float64]:
    """A line for each robot, the flawed ones on top, and the true value; returns all values but those of the
    first moments, when estimates still jump between 0 and 1."""
    (name, _, letter, parameter), experiment = panel, trials.experiment
    values, truth = trials.records[name][trials.numbers.index(number)], getattr(experiment, parameter)
    steps = np.arange(len(values)) * trials.sampling_interval
    style = "steps-post" if name == "b_hat" else "default"  # b_hat stands still between its jumps
    for robot in range(experiment.robots - 1, -1, -1):
        color, label = (FLAWED, _LINES[0]) if robot < experiment.flawed else (OTHER, _LINES[1])
        axes.plot(
            steps, values[:, robot], color=color, label=label, linewidth=1.1, alpha=0.75, drawstyle=style
        )
    axes.axhline(truth, color=INK, label=_LINES[2], linewidth=1.2, linestyle="--")
    beside = axes.get_yaxis_transform()
    axes.text(1, truth, f" {letter} = {truth:g}", transform=beside, va="center", fontsize=SMALL)
    clean(axes)
    return np.append(values[len(values) // 50 :], truth)
