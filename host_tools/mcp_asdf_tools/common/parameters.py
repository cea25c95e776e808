"""Parameters: fields of dataclasses with a meaning, a range and a default, declared in one place.

A class of parameters is a frozen dataclass that declares each with `parameter` and calls `check_parameters`
in its ``__post_init__``. Options, TOML keys, JSON and table columns follow from these declarations.
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
    """A value that a parameter cannot have; ``key`` names the parameter."""

    def __init__(self, key: str, message: str) -> None:
        super().__init__(message)
        self.key = key


@contextmanager
def value_of(key: str) -> Iterator[None]:
    """Turn a UsageError about the value of this parameter into a ParameterError."""
    try:
        yield
    except UsageError as error:
        raise ParameterError(key, str(error)) from error


@dataclass(frozen=True)
class Parameter:
    """A declared parameter of a class.

    Attributes:
        name: Name of the field; its option has dashes in place of underscores.
        kind: int, float or str; a value of any other type is checked by the class.
        choices: Texts that it may be, those of a ``Literal`` or the ones declared; empty: any.
        default: Value if none is given.
        text: Meaning in one line, with the unit.
        least: Smallest value, for numbers.
        most: Largest value, for numbers.
    """

    name: str
    kind: Any
    choices: Collection[str] | Names
    default: Any
    text: str
    least: float
    most: float

    def checked(self, value: Any) -> Any:
        """Return ``value`` in the field's type. Raises ParameterError for what is none, or out of range."""
        if self.kind in (int, float):
            return self._number(value)
        if self.choices and not (isinstance(value, str) and value in self.choices):
            raise self._error(value, f"choose one of {', '.join(self.choices)}")
        if self.kind is str and not isinstance(value, str):
            raise self._error(value, "give a text")
        return value

    def _number(self, value: Any) -> float:
        """Return a value as a number of the field's type; a float may stand for a whole number."""
        try:
            is_number = not isinstance(value, bool | str | bytes) and math.isfinite(value)
            number: float = self.kind(value) if is_number else math.nan
        except (TypeError, ValueError, ArithmeticError):
            is_number = False
        if not is_number:
            raise self._error(value, "give a number")
        if self.kind is int and number != value:
            raise self._error(value, "give a whole number")
        if not self.least <= number <= self.most:
            raise self._error(value, f"it must be {_plain(self.least)} to {_plain(self.most)}")
        return number

    def _error(self, value: Any, fix: str) -> ParameterError:
        return ParameterError(self.name, f"{self.name} is {value!r}; {fix}")


def _plain(limit: float) -> str:
    return str(limit) if isinstance(limit, int) else f"{limit:g}"


def parameter(
    text: str,
    least: float = -math.inf,
    most: float = math.inf,
    *,
    default: Any,
    choices: Collection[str] | Names = (),
) -> Any:
    """Declare a field of a dataclass with its meaning in one line, its default, and its range or choices."""
    return field(default=default, metadata={"choices": choices, "parameter": (text, least, most)})


def parameters_of(kind: Any) -> dict[str, Parameter]:
    """Return the declared parameters of a class, by name, in order."""
    return _declared(kind)


@cache
def _declared(kind: Any) -> dict[str, Parameter]:
    """Read the declarations from the fields of a dataclass."""
    types = get_type_hints(kind)
    parameters = {}
    for declared_field in fields(kind):
        metadata = declared_field.metadata
        if "parameter" not in metadata:
            continue
        name, field_type = declared_field.name, types[declared_field.name]
        is_literal = get_origin(field_type) is Literal
        choices = get_args(field_type) if is_literal else metadata["choices"]
        text, least, most = metadata["parameter"]
        parameters[name] = Parameter(name, field_type, choices, declared_field.default, text, least, most)
    return parameters


def check_parameters(settings: Any) -> None:
    """Check every parameter of an instance. Raises ParameterError for the first that is wrong."""
    for name, declared in parameters_of(type(settings)).items():
        # Settings are frozen, but for this moment of their making.
        object.__setattr__(settings, name, declared.checked(getattr(settings, name)))
