"""Keys: a hash of everything that determines a row, the same on every machine and in every process.

Classes of this library go in by name, for the version of the engine, which is part of every row's key, stands for their
code. Classes and functions from elsewhere go in with their code, see `optsc.study.own_code`.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import PurePath
from types import BuiltinFunctionType, FunctionType
from typing import Any, TypeAlias

import numpy as np

from optsc.errors import InvalidValue
from optsc.study.own_code import name_of, own_code

Plain: TypeAlias = bool | int | float | str | list["Plain"] | dict[str, "Plain"] | None

LENGTH = 20
"""Hexadecimal digits of a key: 80 bits, so that a million rows collide with a chance below 1e-12."""


def plain(value: Any) -> Plain:
    """Return ``value`` as JSON can hold it: dataclasses with their type's name, arrays as lists, functions by name.

    What is not this library's own comes with fingerprints of its code.

    Raises `InvalidValue` for anything that has no such form, so that nothing slips into a key by its address.
    """
    if value is None or isinstance(value, (bool, str)):
        return value
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value)
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, np.ndarray):
        return [plain(item) for item in value.tolist()]
    if is_dataclass(value) and not isinstance(value, type):
        content = {field.name: plain(getattr(value, field.name)) for field in fields(value)}
        return {"type": type(value).__name__, **_code(type(value)), **content}
    if isinstance(value, (type, FunctionType, BuiltinFunctionType)):
        code = {} if isinstance(value, BuiltinFunctionType) else _code(value)
        return {"named": name_of(value), **code}
    if isinstance(value, Mapping):
        return {str(name): plain(item) for name, item in value.items()}
    if isinstance(value, (Sequence, frozenset, set)):
        items = sorted(value) if isinstance(value, (frozenset, set)) else value
        return [plain(item) for item in items]
    raise InvalidValue(
        "part of a key", type(value).__name__, "numbers, words, sequences, mappings, dataclasses, functions"
    )


def _code(thing: type | FunctionType) -> dict[str, Plain]:
    """Return the entry that tells own code; none for classes of this library, whose keys stay what they are."""
    code: dict[str, Plain] = dict(own_code(thing))
    # No field of a dataclass can be called this.
    return {"own code": code} if code else {}


def canonical(value: Any) -> str:
    """Return ``value`` as JSON in one spelling: sorted names, no spaces, every digit of every number."""
    return json.dumps(plain(value), sort_keys=True, separators=(",", ":"), allow_nan=False)


def key(value: Any) -> str:
    """Return the key of ``value``: the first `LENGTH` digits of the SHA-256 of its canonical form."""
    try:
        text = canonical(value)
    except ValueError as error:
        if isinstance(error, InvalidValue):
            raise
        raise InvalidValue("part of a key", str(error), "finite numbers") from None
    return hashlib.sha256(text.encode()).hexdigest()[:LENGTH]
