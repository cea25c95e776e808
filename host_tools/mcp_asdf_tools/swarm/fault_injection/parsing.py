"""Reading a fault from one line of text.

A fault is its kind, with a rate unless it is certain, then any options, separated by commas:
``loss=0.2,from=100,to=500,robots=3-5`` loses each frame that robots 3, 4 and 5 send from tick 100 on, until
before tick 500, with probability 0.2 on its way to each neighbour.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mcp_asdf_tools.common.errors import UsageError, did_you_mean
from mcp_asdf_tools.common.parameters import Parameter, parameters_of
from mcp_asdf_tools.robots.robot_setup import parse_ids
from mcp_asdf_tools.swarm.fault_injection.fault import OPTION_OF_FIELD, Fault
from mcp_asdf_tools.swarm.fault_injection.kinds import FAULT_KINDS

_KINDS_BY_NAME = {kind.name: kind for kind in FAULT_KINDS}
_FIELD_OF_OPTION = {option: name for name, option in OPTION_OF_FIELD.items()}
_COMMON_OPTIONS = ("from", "to", "robots")


def parse_fault(fault_text: str) -> Fault:
    """Read a fault such as ``delay=0.5,ticks=3,from=100,to=500,robots=0+3-5``.

    The first item is the kind and its rate (1 if left out); ``robots``, ``receivers`` and ``ids`` take ids
    and ranges of ids, separated by +. Raises UsageError that names the error and the fix.
    """
    first_item, *items = (item.strip() for item in fault_text.split(","))
    # The first item is the kind, with its rate if there is one.
    name, equals_sign, rate = first_item.partition("=")
    kind = _kind_called(name, fault_text)
    values = _parse_options(fault_text, kind, items)
    if equals_sign:
        values["rate"] = _parse_option(fault_text, kind, "rate", rate)
    fault = kind(**values)
    # The options must go together.
    fault.check()
    if fault.stop is not None and fault.stop <= fault.start:
        raise _option_error(fault_text, "to", fault.stop, f"above from, {fault.start}")
    return fault


def _kind_called(name: str, fault_text: str) -> type[Fault]:
    """Return the kind of faults with this name. Raises UsageError, with the names, if there is none."""
    if name not in _KINDS_BY_NAME:
        # Either text continues the message, and begins with a semicolon.
        ending = did_you_mean(name, _KINDS_BY_NAME) or f"; choose one of {', '.join(_KINDS_BY_NAME)}"
        raise UsageError(f"fault {fault_text!r}: no kind is called {name!r}{ending}")
    return _KINDS_BY_NAME[name]


def _parse_options(fault_text: str, kind: type[Fault], items: Sequence[str]) -> dict[str, Any]:
    """Return the values of a fault's options, such as ``ticks=3``, by the name of their field.

    Raises UsageError for an option that the kind does not have, or that is given twice, and for a wrong
    value.
    """
    values: dict[str, Any] = {}
    for item in items:
        option, _, value = item.partition("=")
        _check_option(fault_text, kind, option)
        field_name = _FIELD_OF_OPTION.get(option, option)
        if field_name in values:
            raise UsageError(f"fault {fault_text!r}: {option} is given twice; give it once")
        values[field_name] = _parse_option(fault_text, kind, option, value)
    return values


def _check_option(fault_text: str, kind: type[Fault], option: str) -> None:
    """Raise UsageError, with the options that there are, if a kind of faults does not have this one."""
    options = [*_COMMON_OPTIONS, *kind.own_options()]
    if option not in options:
        ending = did_you_mean(option, options) or f"; its options are {', '.join(options)}"
        raise UsageError(f"fault {fault_text!r}: {kind.name} has no option {option!r}{ending}")


def _parse_option(fault_text: str, kind: type[Fault], option: str, value: str) -> Any:
    """Return the value of an option of a fault: a set of ids, one of the option's choices, or a number.

    Raises UsageError if the value is no such thing, or a number out of the option's range.
    """
    field_name = _FIELD_OF_OPTION.get(option, option)
    parameter = parameters_of(kind).get(field_name)
    if parameter is None:  # all options that are no declared parameters are sets of ids
        return parse_ids(value, f"fault {fault_text!r}: {option}")
    if not parameter.choices:
        return _parse_number(fault_text, parameter, option, value)
    if value not in parameter.choices:
        raise _option_error(fault_text, option, value, " or ".join(parameter.choices))
    return value


def _parse_number(fault_text: str, parameter: Parameter, option: str, value: str) -> float:
    """Return the number in the text ``value``, an integer unless the parameter takes floats.

    Raises UsageError if the text is no such number, or the number is out of the parameter's range.
    """
    is_float = parameter.kind is float
    limits = f"{parameter.minimum:g} to {parameter.maximum:g}"
    requirement = f"a number, {limits}" if is_float else f"a whole number, {limits}"
    try:
        number = float(value) if is_float else int(value)
    except ValueError:
        raise _option_error(fault_text, option, value, requirement) from None
    if not parameter.minimum <= number <= parameter.maximum:  # this refuses NaN, too
        raise _option_error(fault_text, option, value, requirement)
    return number


def _option_error(fault_text: str, option: str, value: object, requirement: str) -> UsageError:
    """Return the error for a value that an option cannot have."""
    return UsageError(f"fault {fault_text!r}: {option} is {value!r}; it must be {requirement}")
