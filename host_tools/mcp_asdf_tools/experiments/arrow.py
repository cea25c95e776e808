"""pyarrow, loaded when a name of it is first used: it loads slowly, and is not in every installation."""

from importlib import import_module
from typing import Any

_MODULES = ("compute", "parquet")


def __getattr__(name: str) -> Any:
    if name.startswith("__"):
        raise AttributeError(name)
    return import_module(f"pyarrow.{name}") if name in _MODULES else getattr(import_module("pyarrow"), name)
