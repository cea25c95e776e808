"""Parameters: dataclass fields with a meaning and a range, whose values are coerced and checked in one place.

A class of parameters declares each field with :func:`parameter` and calls :func:`check_parameters` in its
``__post_init__``. Values that are unambiguous become those of the field's type (an enum by its value, a whole
number written as a float); everything else is refused with the field, the value and what is allowed.
"""

from __future__ import annotations

import math
from dataclasses import MISSING, Field, dataclass, field, fields
from decimal import Decimal, InvalidOperation
from enum import Enum
from numbers import Integral, Real
from typing import Any

from mcp_asdf_tools.common.errors import UsageError


class ParameterError(UsageError):
    """A value that a parameter cannot have; ``key`` names the parameter."""

    def __init__(self, key: str, message: str) -> None:
        super().__init__(message)
        self.key = key


@dataclass(frozen=True)
class Meaning:
    """What a parameter says, for help texts and checks.

    Attributes:
        text: One line, with the unit.
        least: Smallest value, for numbers.
        most: Largest value, for numbers.
        is_checked_by_class: Whether the class coerces and checks the value, since its type is special.
    """

    text: str
    least: float = -math.inf
    most: float = math.inf
    is_checked_by_class: bool = False


def parameter(default: Any, text: str, least: float = -math.inf, most: float = math.inf) -> Any:
    """A dataclass field with a default, its meaning in one line and, for a number, its range."""
    return field(default=default, metadata={"meaning": Meaning(text, least, most)})


def special_parameter(default: Any, text: str) -> Any:
    """The same for a field that its class coerces and checks."""
    return field(default=default, metadata={"meaning": Meaning(text, is_checked_by_class=True)})


def meaning_of(declared: Field[Any]) -> Meaning | None:
    """The meaning of a field that ``parameter`` made, None for other fields."""
    return declared.metadata.get("meaning")


def check_parameters(instance: Any) -> None:
    """Coerce and check every parameter of a dataclass. Raises ParameterError for the first that is wrong."""
    for declared in fields(instance):
        meaning = meaning_of(declared)
        if meaning is not None and not meaning.is_checked_by_class:
            value = coerced(declared, getattr(instance, declared.name))
            object.__setattr__(instance, declared.name, value)


def coerced(declared: Field[Any], value: Any) -> Any:
    """``value`` as the field holds it. Raises ParameterError if it is not one, or out of range."""
    name, default, meaning = declared.name, declared.default, meaning_of(declared)
    assert meaning is not None
    assert default is not MISSING
    if isinstance(default, Enum):
        return member_of(type(default), name, value)
    if isinstance(default, bool | str):
        if type(value) is not type(default):
            kind = "true or false" if isinstance(default, bool) else "a text"
            raise ParameterError(name, f"{name} is {value!r}; give {kind}")
        return value
    number = _number(name, type(default), value)
    if not meaning.least <= number <= meaning.most:
        least, most = (
            each if isinstance(each, int) else f"{each:g}" for each in (meaning.least, meaning.most)
        )
        raise ParameterError(name, f"{name} is {value}; it must be {least} to {most}")
    return number


def member_of(kind: type[Enum], name: str, value: Any) -> Enum:
    """The member that ``value`` is, or is the value of. Raises ParameterError if there is none."""
    try:
        return kind(value)
    except ValueError:
        choices = ", ".join(str(member.value) for member in kind)
        raise ParameterError(name, f"{name} is {value!r}; choose one of {choices}") from None


def _number(name: str, kind: type[Any], value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, Real | Decimal):
        raise ParameterError(name, f"{name} is {value!r}; give a number")
    if kind is int and not isinstance(value, Integral) and value % 1 != 0:  # also infinite and not a number
        raise ParameterError(name, f"{name} is {value}; it must be a whole number")
    try:
        number = Decimal(str(value)) if kind is Decimal else kind(value)
    except (InvalidOperation, OverflowError) as error:
        raise ParameterError(name, f"{name} is {value!r}; give a number") from error
    if math.isnan(number):
        raise ParameterError(name, f"{name} is {value}; give a number")
    return number


def plain_value(value: Any) -> Any:
    """A coerced parameter as a plain number or word, for JSON and tables."""
    if isinstance(value, Enum):
        return value.value
    return float(value) if isinstance(value, Decimal) else value
