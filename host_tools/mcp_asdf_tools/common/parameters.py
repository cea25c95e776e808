"""Parameters: dataclass fields with a meaning and a range, whose values are coerced and checked in one place.

A class of parameters declares each field with `parameter` and calls `check_parameters` in its
``__post_init__``. Values that are unambiguous become those of the field's type (an enum by its value, a whole
number written as a float); everything else is refused with the field, the value and what is allowed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import MISSING, Field, dataclass, field, fields
from decimal import Decimal
from enum import Enum
from functools import cache
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import (
    TYPE_CHECKING,
    Any,
    Generic,
    TypeVar,
    Union,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
)

from mcp_asdf_tools.common.errors import UsageError

Held = TypeVar("Held")
Also = TypeVar("Also")
Kind = TypeVar("Kind")


class ParameterError(UsageError):
    """A value that a parameter cannot have; ``key`` names the parameter."""

    def __init__(self, key: str, message: str) -> None:
        super().__init__(message)
        self.key = key


@dataclass(frozen=True)
class Meaning:
    """Meaning and range of a parameter, for help texts and checks.

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


class Given(Generic[Held, Also]):
    """Annotation of a parameter that holds a ``Held``; its constructor coerces an ``Also`` to one."""

    if TYPE_CHECKING:

        def __get__(self, instance: object, owner: type[Any]) -> Held: ...

        def __set__(self, instance: object, value: Held | Also) -> None: ...


def parameter(text: str, least: float = -math.inf, most: float = math.inf, *, default: Any) -> Any:
    """A dataclass field with its meaning in one line, for a number its range, and its default."""
    return field(default=default, metadata={"meaning": Meaning(text, least, most)})


def special_parameter(text: str, *, default: Any) -> Any:
    """The same for a field that its class coerces and checks."""
    return field(default=default, metadata={"meaning": Meaning(text, is_checked_by_class=True)})


@dataclass_transform(
    kw_only_default=True, frozen_default=False, field_specifiers=(parameter, special_parameter, field)
)
def parameters(kind: type[Kind]) -> type[Kind]:
    """Make a class of parameters: a frozen dataclass with keywords alone.

    Type checkers see what ``Given`` says only in classes that they do not take for frozen.
    """
    return dataclass(frozen=True, kw_only=True)(kind)


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


def check_types(instance: Any) -> None:
    """Coerce every field of a dataclass to its annotated type, whose ranges are the class's own business.

    Types are int, float, bool, str, enums, classes, and tuples, frozen sets and unions of them. Raises
    ParameterError for the first value that is wrong.
    """
    own: Any = type(instance)
    for name, kind in _types_of(own).items():
        object.__setattr__(instance, name, as_type(name, kind, getattr(instance, name)))


@cache
def _types_of(kind: Any) -> dict[str, Any]:
    known = get_type_hints(kind)
    return {name: known[name] for name in kind.__dataclass_fields__}


def coerced(declared: Field[Any], value: Any) -> Any:
    """``value`` as the field holds it. Raises ParameterError if it is not one, or out of range."""
    name, default, meaning = declared.name, declared.default, meaning_of(declared)
    assert meaning is not None
    assert default is not MISSING
    result = as_type(name, type(default), value)
    if isinstance(result, bool | str | Enum):
        return result
    if not meaning.least <= result <= meaning.most:
        least, most = (
            each if isinstance(each, int) else f"{each:g}" for each in (meaning.least, meaning.most)
        )
        raise ParameterError(name, f"{name} is {value}; it must be {least} to {most}")
    return result


def as_type(name: str, kind: Any, value: Any) -> Any:
    """``value`` as a ``kind``, if that is unambiguous. Raises ParameterError if it is not."""
    if get_origin(kind) in (Union, UnionType):
        return _one_of(name, get_args(kind), value)
    if get_origin(kind) in (tuple, frozenset):
        return _all_of(name, get_origin(kind), get_args(kind)[0], value)
    if kind in (int, float, Decimal):
        return _number(name, kind, value)
    if issubclass(kind, Enum):
        return member_of(kind, name, value)
    if type(value) is not kind if kind is bool else not isinstance(value, kind):
        raise ParameterError(name, f"{name} is {value!r}; give {_KINDS.get(kind, f'a {kind.__name__}')}")
    return value


_KINDS: dict[type[Any], str] = {bool: "true or false", str: "a text", NoneType: "nothing"}


def _one_of(name: str, kinds: tuple[Any, ...], value: Any) -> Any:
    """The value as the first kind that it is; None is itself."""
    if value is None and NoneType in kinds:
        return None
    rest = [kind for kind in kinds if kind is not NoneType]
    for kind in rest[:-1]:
        with suppress(ParameterError):
            return as_type(name, kind, value)
    return as_type(name, rest[-1], value)


def _all_of(name: str, whole: Any, kind: Any, values: Any) -> Any:
    if isinstance(values, str | bytes | Mapping) or not isinstance(values, Iterable):
        raise ParameterError(name, f"{name} is {values!r}; give several in a list or tuple")
    return whole(as_type(name, kind, value) for value in values)


def member_of(kind: type[Enum], name: str, value: Any) -> Enum:
    """The member that ``value`` is, or is the value of. Raises ParameterError if there is none."""
    try:
        if isinstance(value, bool):  # equals 0 or 1, which an IntEnum would take
            raise ValueError
        return kind(value)
    except (ValueError, TypeError, ArithmeticError):  # even a signalling NaN
        choices = ", ".join(str(member.value) for member in kind)
        raise ParameterError(name, f"{name} is {value!r}; choose one of {choices}") from None


def _number(name: str, kind: type[Any], value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, Real | Decimal):
        raise ParameterError(name, f"{name} is {value!r}; give a number")
    try:
        # Infinity and NaN have no remainder.
        is_whole = isinstance(value, Integral) or kind is not int or value % 1 == 0
        number = Decimal(str(value)) if kind is Decimal else kind(value if is_whole else 0)
        is_number = number == number  # noqa: PLR0124 (NaN is not)
    except (ArithmeticError, ValueError) as error:
        raise ParameterError(name, f"{name} is {value}; give a number") from error
    if not (is_whole and is_number):
        raise ParameterError(name, f"{name} is {value}; give a {'' if is_whole else 'whole '}number")
    return number


def plain_value(value: Any) -> Any:
    """A coerced parameter as a plain number or word, for JSON and tables."""
    if isinstance(value, Enum):
        return value.value
    return float(value) if isinstance(value, Decimal) else value
