"""Text in pictures of results: names of series, parameters with their values, and captions."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

from mcp_asdf_tools.common.figures import format_for_legend
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials, find_differences
from mcp_asdf_tools.experiments.scores import Limits
from mcp_asdf_tools.robots.filters import FILTERS

MAX_LABEL_LENGTH = 20
"""Characters of a value that fit into a legend: the edges of a graph do not."""

ALWAYS_SHOWN_PARAMETERS = ("fill_ratio", "true_accuracy", "flawed_accuracy", "flawed", "trials", "filter")
"""Parameters that pictures always show, by their axes, titles and series, without the parameter's name."""

_FILTER_PARAMETERS = ("filter_period", "omega", "activation")
_CAPTION_PARAMETERS = ("robots", "topology", "steps", "seed", "filter_period", "omega")


def filter_name(experiment: Experiment) -> str:
    """Return the name of the experiment's filter, as the paper typesets it."""
    return experiment.swarm_filter.typeset_term


def flawed_share(experiment: Experiment) -> float:
    """Return P, the share of flawed robots."""
    return float(experiment.flawed / experiment.robots)


def shown_value(experiment: Experiment, parameter_name: str) -> Any:
    """Return the value of a parameter as pictures show it: for ``flawed`` a share of the robots."""
    if parameter_name == "flawed":
        return flawed_share(experiment)
    return experiment.parameters()[parameter_name]


def shown_values(experiments: Sequence[Trials], parameter_name: str) -> list[Any]:
    """Return the different values of a parameter as pictures show them, sorted; filters as in FILTERS."""
    values = {shown_value(trials.experiment, parameter_name) for trials in experiments}
    if parameter_name == "filter":
        return [name for name in FILTERS if name in values]
    return sorted(values)


def sorted_by_filter(experiments: Sequence[Trials]) -> list[Trials]:
    """Return experiments in the order of FILTERS; those of the same filter keep their order."""
    filter_names = list(FILTERS)
    return sorted(experiments, key=lambda trials: filter_names.index(trials.experiment.filter))


def has_effect(experiment: Experiment, parameter_name: str) -> bool:
    """Return whether a parameter has an effect in an experiment.

    Only parameters of filters may have none: without a filter, or with one that does not use them.
    """
    if parameter_name not in _FILTER_PARAMETERS:
        return True
    return experiment.swarm_filter.is_on and parameter_name not in experiment.unused_parameters()


def varying_parameters(experiments: Sequence[Trials], excluded: Collection[str]) -> list[str]:
    """Return the names of the parameters in which experiments differ, but for those ``excluded``.

    Values that have no effect in their experiment do not count.
    """
    differences = find_differences(_effective_parameters(trials.experiment) for trials in experiments)
    return [parameter_name for parameter_name in differences if parameter_name not in excluded]


def _effective_parameters(experiment: Experiment) -> dict[str, Any]:
    """Return the parameters of an experiment that have an effect in it, with their values."""
    parameters = experiment.parameters()
    return {name: value for name, value in parameters.items() if has_effect(experiment, name)}


def name_series(experiment: Experiment, varying_names: Sequence[str]) -> str:
    """Return the name of an experiment's series, such as "ASDF+, omega 2".

    It has the name of the filter, and those parameters of ``varying_names`` that have an effect.
    """
    names = [filter_name(experiment)]
    # A parameter without effect, such as omega without a test, would split experiments that are alike.
    for parameter_name in varying_names:
        if has_effect(experiment, parameter_name):
            value = format_for_legend(experiment.parameters()[parameter_name])
            names.append(f"{parameter_name.replace('_', ' ')} {value}")
    return ", ".join(names)


def parameter_in_words(parameter_name: str) -> str:
    """Return the name of a parameter as pictures show it, such as "filter period" for filter_period.

    The name of ``flawed`` is "share of flawed robots", as pictures show shares and not counts of them.
    """
    return "share of flawed robots" if parameter_name == "flawed" else parameter_name.replace("_", " ")


def parameter_with_value(parameter_name: str, value: Any) -> str:
    """Return a parameter with its value, such as "filter period 100"."""
    return f"{parameter_in_words(parameter_name)} {shorten(format_for_legend(value))}"


def shorten(text: str) -> str:
    """Return the text, or its first MAX_LABEL_LENGTH characters and " ..." if it is longer."""
    return text if len(text) <= MAX_LABEL_LENGTH else f"{text[:MAX_LABEL_LENGTH]} ..."


def make_caption(experiments: Sequence[Trials], marks: str, limits: Limits) -> str:
    """Return a sentence with what all experiments of a picture have in common.

    It names the filter and parameters that all have alike, the number of trials and the limits of the scores
    (K_max and e_max, the convergence step and the error that score 0), and ends with ``marks``, which
    says what the picture's points, lines and areas mean.
    """
    details: list[str] = []
    filter_names = {filter_name(trials.experiment) for trials in experiments}
    if len(filter_names) == 1:
        details.append(filter_names.pop())
    all_parameters = [_effective_parameters(trials.experiment) for trials in experiments]
    for name in _CAPTION_PARAMETERS:
        values = {parameters[name] for parameters in all_parameters if name in parameters}
        # A parameter that differs is named in the legend or in the titles of the panels.
        if len(values) == 1:
            details.append(f"{name.replace('_', ' ')} {format_for_legend(values.pop())}")
    details.append(f"{_describe_trial_counts(experiments)} trials of each experiment")
    details.append(_describe_limits(experiments, limits))
    return f"{', '.join(details)}; {marks}."


def _describe_limits(experiments: Sequence[Trials], limits: Limits) -> str:
    """Return a text with K_max and e_max; if experiments have different K_max, it names all of them."""
    k_limits = {limits.of(trials.experiment)[0] for trials in experiments}
    k_text = " and ".join(format_for_legend(k_max) for k_max in sorted(k_limits))
    return f"$K_{{max}}$ = {k_text}, $e_{{max}}$ = {format_for_legend(limits.e_max)}"


def _describe_trial_counts(experiments: Sequence[Trials]) -> str:
    """Return how many trials each experiment has: "30", or "12 to 30" if they have different numbers."""
    trial_counts = [len(trials.numbers) for trials in experiments]
    fewest, most = min(trial_counts), max(trial_counts)
    if fewest == most:
        return str(fewest)
    return f"{fewest} to {most}"
