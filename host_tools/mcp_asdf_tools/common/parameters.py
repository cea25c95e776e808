"""Declaration of parameters: fields of dataclasses with a meaning, a range or choices, and a default.

A class of parameters is a frozen dataclass that declares each field with `parameter` and calls
`check_parameters` in its ``__post_init__``. Options of the command line, TOML keys, JSON keys and columns of
results follow from these declarations.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from functools import cache
from typing import Any, Literal, get_args, get_origin, get_type_hints

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.extensions import Names


class ParameterError(UsageError):
    """A value that a parameter cannot have.

    Attributes:
        key: Name of the parameter.
    """

    def __init__(self, key: str, message: str) -> None:
        """Create the error with the name of the parameter and the whole message."""
        super().__init__(message)
        self.key = key


@contextmanager
def naming_parameter(key: str) -> Iterator[None]:
    """Context manager that turns a UsageError into a ParameterError for the parameter named ``key``."""
    try:
        yield
    except UsageError as error:
        raise ParameterError(key, str(error)) from error


@dataclass(frozen=True)
class Parameter:
    """Declaration of a parameter of a class.

    Attributes:
        name: Name of the field. Its option has dashes in place of underscores.
        kind: Type of the field. Values of int, float and str are checked here, others by the class.
        choices: Texts that it may be, from its ``Literal`` type or its declaration; empty for any text.
        default: Value if none is given.
        meaning: One line on what it means, with the unit.
        minimum: Smallest value, for a number.
        maximum: Largest value, for a number.
    """

    name: str
    kind: Any
    choices: Collection[str] | Names
    default: Any
    meaning: str
    minimum: float
    maximum: float

    def convert(self, value: Any) -> Any:
        """Return a value unchanged or, if the field is an int or a float, converted to that type.

        Raises ParameterError if the value is of another type, out of range or none of the choices. A field
        that is neither a number nor a text, and has no choices, takes any value: its class checks it.
        """
        if self.kind in (int, float):
            return self._number(value)
        is_choice = isinstance(value, str) and value in self.choices
        if self.choices and not is_choice:
            raise self._error(value, f"choose one of {', '.join(self.choices)}")
        if self.kind is str and not isinstance(value, str):
            raise self._error(value, "give a text")
        return value

    def _number(self, value: Any) -> float:
        """Return a value as a number of the field's type; 5.0 may stand for 5.

        Raises ParameterError if it is not a finite number, is out of range, or is not whole but has to be.
        True and False are no numbers here, although Python counts them as such. Neither are texts, although
        int() and float() would read them.
        """
        if isinstance(value, bool | str | bytes):
            raise self._error(value, "give a number")
        try:
            is_finite = math.isfinite(value)
            number: float = self.kind(value)
        except (TypeError, ValueError, ArithmeticError) as error:
            # Such an error may mean that the value is no number, or an integer too large for a float.
            raise self._error(value, "give a number") from error
        if not is_finite:
            raise self._error(value, "give a number")
        # int() has cut off the fraction.
        if self.kind is int and number != value:
            raise self._error(value, "give a whole number")
        if not self.minimum <= number <= self.maximum:
            limits = f"{_format_limit(self.minimum)} to {_format_limit(self.maximum)}"
            raise self._error(value, f"it must be {limits}")
        return number

    def _error(self, value: Any, fix: str) -> ParameterError:
        """Return an error that names the parameter, the value and what to do."""
        return ParameterError(self.name, f"{self.name} is {value!r}; {fix}")


def _format_limit(limit: float) -> str:
    """Return a limit as a text: a whole number with all its digits, any other in short."""
    return str(limit) if isinstance(limit, int) else f"{limit:g}"


def parameter(
    meaning: str,
    minimum: float = -math.inf,
    maximum: float = math.inf,
    *,
    default: Any,
    choices: Collection[str] | Names = (),
) -> Any:
    """Declare a field of a dataclass: its meaning in one line, its range if it is a number, and its default.

    ``choices`` are the texts that it may be; those of a ``Literal`` type need not be listed.
    """
    metadata = {"meaning": meaning, "minimum": minimum, "maximum": maximum, "choices": choices}
    return field(default=default, metadata=metadata)


def parameters_of(kind: Any) -> dict[str, Parameter]:
    """Return the declared parameters of a class by name, in the order of their declaration."""
    return _parameters_of(kind)  # mypy does not let callers pass a class to a cached function


@cache
def _parameters_of(kind: Any) -> dict[str, Parameter]:
    """Return the declared parameters of a dataclass by name, without its fields that are no parameters.

    The result is shared by all callers, so do not change it.
    """
    types = get_type_hints(kind)
    parameters = {}
    for declared_field in fields(kind):
        name, metadata = declared_field.name, declared_field.metadata
        if "meaning" not in metadata:
            continue  # a field that is no parameter
        field_type = types[name]
        is_literal = get_origin(field_type) is Literal
        # The choices of a Literal type are its arguments.
        choices = get_args(field_type) if is_literal else metadata["choices"]
        parameters[name] = Parameter(
            name=name,
            kind=field_type,
            choices=choices,
            default=declared_field.default,
            meaning=metadata["meaning"],
            minimum=metadata["minimum"],
            maximum=metadata["maximum"],
        )
    return parameters


def check_parameters(settings: Any) -> None:
    """Check all parameters of an instance, and convert numbers to their types in place.

    Raises ParameterError for the first parameter that is wrong.
    """
    for name, declared in parameters_of(type(settings)).items():
        # Settings are frozen, but this is called while they are created.
        object.__setattr__(settings, name, declared.convert(getattr(settings, name)))
