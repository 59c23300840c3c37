"""Values of RON, the notation of edits and graphs, from values of Python.

Any capitalized name of this module is a variant: `Off`, `Scale(0.5)`, `Move(by=(0, 0.1, 0))`. The
program checks the names and fields, not this module.
"""

from __future__ import annotations

import json
import numbers
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Variant:
    """A name of RON with values or fields; without them, the name alone."""

    name: str
    values: tuple[Any, ...] = ()
    fields: tuple[tuple[str, Any], ...] = ()

    def __call__(self, *values: Any, **fields: Any) -> Variant:
        if values and fields:
            raise TypeError(f"{self.name}: wanted values or fields, got both")
        return Variant(self.name, values, tuple(fields.items()))


def __getattr__(name: str) -> Variant:
    if not name[:1].isupper():
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return Variant(name)


def dumps(value: Any) -> str:
    """The text of a value: a dictionary is a map, a tuple a tuple, a list or array a list."""
    match value:
        case Variant(name, (), ()):
            return name
        case Variant(name, values, ()):
            return f"{name}({', '.join(map(dumps, values))})"
        case Variant(name, _, fields):
            return f"{name}({_fields(dict(fields))})"
        case None:
            return "None"
        case bool() | np.bool_():
            return "true" if value else "false"
        case str():
            return _string(value)
        case numbers.Integral():
            return str(int(value))
        case numbers.Real():
            return _number(value)
        case Mapping():
            pairs = (f"{dumps(key)}: {dumps(item)}" for key, item in value.items())
            return "{" + ", ".join(pairs) + "}"
        case tuple():
            return "(" + ", ".join(map(dumps, value)) + ")"
        case list() | np.ndarray():
            return "[" + ", ".join(map(dumps, value)) + "]"
    raise TypeError(f"wanted numbers, text, lists, tuples, mappings or variants, got {value!r}")


def edit(fields: Mapping[str, Any]) -> str:
    """The text of an edit file from its fields, one a line; `version` is 1 unless it is there."""
    lines = (f"    {name}: {dumps(value)},\n" for name, value in {"version": 1, **fields}.items())
    return "Edit(\n" + "".join(lines) + ")\n"


def _fields(fields: Mapping[str, Any]) -> str:
    return ", ".join(f"{name}: {dumps(value)}" for name, value in fields.items())


def _string(text: str) -> str:
    # JSON escapes beyond the quote and the backslash differ from those of RON.
    escapes = {"\\": r"\\", '"': r"\"", "\n": r"\n", "\r": r"\r", "\t": r"\t", "\0": r"\0"}
    return '"' + "".join(escapes.get(c, c) for c in text) + '"'


def _number(value: Any) -> str:
    number = float(value)
    if number != number or number in (float("inf"), float("-inf")):
        raise ValueError(f"wanted a finite number, got {number}")
    return json.dumps(number)
