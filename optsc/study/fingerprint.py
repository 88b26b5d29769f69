"""Fingerprint of a value: a hash of everything that determines a row, the same on every machine and in every process.

Classes of this library go in by name: the version of the engine, which is part of every row's key, stands for their
code. User-defined classes and functions go in with their code, since settings alone do not determine what they do.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import lru_cache
from pathlib import PurePath
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any, TypeAlias

import numpy as np

from optsc.errors import InvalidValue

Plain: TypeAlias = bool | int | float | str | list["Plain"] | dict[str, "Plain"] | None
Coded: TypeAlias = type | FunctionType

LENGTH = 20
"""Hexadecimal digits of a fingerprint: 80 bits, so that a million rows collide with a chance below 1e-12."""

_KNOWN = frozenset({"optsc", "builtins", *sys.stdlib_module_names})
_MAIN = "__main__"
_WORDS = (bool, int, float, complex, str, bytes, type(None))


def plain(value: Any) -> Plain:
    """Return ``value`` as JSON can hold it: dataclasses with their type's name, arrays as lists, functions by name.

    User-defined classes and functions come with fingerprints of their code.

    Raises `InvalidValue` for anything that has no such form, so that nothing enters a fingerprint by its address.
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
        "part of a fingerprint",
        type(value).__name__,
        "numbers, words, sequences, mappings, dataclasses, functions",
    )


def _code(thing: type | FunctionType) -> dict[str, Plain]:
    """Return the entry for user-defined code; none for the classes of this library."""
    code: dict[str, Plain] = dict(code_fingerprints(thing))
    # No field of a dataclass can be called this.
    return {"own code": code} if code else {}


def canonical_json(value: Any) -> str:
    """Return ``value`` as JSON in one spelling: sorted names, no spaces, every digit of every number."""
    return json.dumps(plain(value), sort_keys=True, separators=(",", ":"), allow_nan=False)


def fingerprint(value: Any) -> str:
    """Return the first `LENGTH` digits of the SHA-256 of the canonical form of ``value``; raise as `plain`."""
    try:
        text = canonical_json(value)
    except ValueError as error:
        if isinstance(error, InvalidValue):
            raise
        raise InvalidValue("part of a fingerprint", str(error), "finite numbers") from None
    return hashlib.sha256(text.encode()).hexdigest()[:LENGTH]


def name_of(thing: Coded | BuiltinFunctionType) -> str:
    """Return module and qualified name; the script that was started is called the same in its worker processes."""
    module = thing.__module__ or ""
    # Spawned processes import the script under another name.
    return f"{_MAIN if module == '__mp_main__' else module}.{thing.__qualname__}"


def code_fingerprints(thing: Coded) -> dict[str, str]:
    """Return a fingerprint by name of everything outside of this library that ``thing`` is made of; often nothing.

    For a class these are the class and its bases. A fingerprint is of the source, of the compiled code where there is
    none, and of what the code names in its package: functions, classes, and constants made of numbers, words,
    arrays and collections of them. What it takes from other packages, and objects of other kinds, are not part of it.
    """
    things = [thing] if isinstance(thing, FunctionType) else list(thing.__mro__)
    return {name_of(t): _hash_of_code(t, _root(t)) for t in things if _root(t) not in _KNOWN}


def _root(thing: Any) -> str:
    name = thing.__name__ if isinstance(thing, ModuleType) else thing.__module__
    return (name or "").partition(".")[0]


def _hash_of_code(thing: Coded, root: str) -> str:
    parts: list[str] = []
    _collect(thing, root, parts, set())
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def _collect(thing: Coded, root: str, parts: list[str], seen: set[int]) -> None:
    """Append what ``thing`` says, and what it names, to ``parts``; ``seen`` are the things that are there already."""
    if id(thing) in seen:
        return
    seen.add(id(thing))
    functions = list(_functions(thing))
    parts += [name_of(thing), _source(thing) or repr([_compiled(f.__code__) for f in functions])]
    if isinstance(thing, type) and not _source(thing):
        settings = {n: _constant(x) for n, x in vars(thing).items() if not n.startswith("__")}
        parts += [f"{n} = {x}" for n, x in sorted(settings.items()) if x is not None]
    for function in functions:
        for name, value in _named(function, root):
            if isinstance(value, (type, FunctionType)) and _root(value) == root:
                parts.append(f"{name}: {name_of(value)}")
                _collect(value, root, parts, seen)
            elif (constant := _constant(value)) is not None:
                parts.append(f"{name} = {constant}")


def _functions(thing: Any) -> Iterator[FunctionType]:
    """Yield the functions that a function or class is made of, in the order of their names."""
    if isinstance(thing, FunctionType):
        yield thing
    elif isinstance(thing, (staticmethod, classmethod)):
        yield from _functions(thing.__func__)
    elif isinstance(thing, property):
        for part in (thing.fget, thing.fset, thing.fdel):
            yield from _functions(part)
    elif isinstance(thing, type):
        for _, part in sorted(vars(thing).items()):
            # What is inherited or only referred to is collected where it is defined.
            yield from _functions(getattr(part, "func", part) if not isinstance(part, type) else None)


@lru_cache(maxsize=256)
def _source(thing: Coded) -> str:
    """Return the source without indentation; "" where there is none that is for sure what runs.

    One line may hold several lambdas, and a file may have been edited since it was loaded.
    """
    if thing.__name__ == "<lambda>":
        return ""
    try:
        lines = inspect.getsource(thing).splitlines()
        file = inspect.getsourcefile(thing) or ""
        written = list(_parts(compile("".join(inspect.findsource(thing)[0]), file, "exec", dont_inherit=True)))
    except (OSError, TypeError, SyntaxError):
        return ""
    # What a decorator such as that of dataclasses made has no file.
    loaded = [f.__code__ for f in _functions(thing) if f.__code__.co_filename == inspect.getfile(thing)]
    if any(_compiled(code) not in written for code in loaded):
        return ""
    return inspect.cleandoc("\n".join(["", *(line.rstrip() for line in lines)]))


def _parts(code: CodeType) -> Iterator[list[Any]]:
    """Yield what ``code`` and all functions in it do."""
    yield _compiled(code)
    for part in code.co_consts:
        if isinstance(part, CodeType):
            yield from _parts(part)


def _compiled(code: CodeType) -> list[Any]:
    """Return what the code does, without where it stood."""
    constants = [_compiled(c) if isinstance(c, CodeType) else _constant(c) for c in code.co_consts]
    return [code.co_code.hex(), constants, code.co_names, code.co_varnames, code.co_freevars]


def _named(function: FunctionType, root: str) -> list[tuple[str, Any]]:
    """Return what the function refers to, by name: globals, what it closes over, and defaults."""
    names = _names(function.__code__)
    found = {name: function.__globals__[name] for name in names if name in function.__globals__}
    for module in [m for m in found.values() if isinstance(m, ModuleType) and _root(m) == root]:
        found.update({f"{module.__name__}.{n}": getattr(module, n) for n in names if hasattr(module, n)})
    cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    found.update({f"closure {n}": _content(cell) for n, cell in cells})
    found.update({f"default {k}": value for k, value in enumerate(function.__defaults__ or ())})
    found.update({f"default {n}": value for n, value in (function.__kwdefaults__ or {}).items()})
    return sorted(found.items(), key=lambda item: item[0])


def _content(cell: Any) -> Any:
    try:
        return cell.cell_contents
    except ValueError:
        return NotImplemented


def _names(code: CodeType) -> set[str]:
    inner = (c for c in code.co_consts if isinstance(c, CodeType))
    return set(code.co_names).union(*(_names(c) for c in inner))


def _constant(value: Any) -> str | None:
    """Return a constant in one spelling; None for what is none."""
    if isinstance(value, Enum):
        return f"{type(value).__qualname__}.{value.name}"
    if isinstance(value, (*_WORDS, np.generic)):
        return f"{type(value).__name__} {value!r}"
    if isinstance(value, np.ndarray) and value.dtype != object:
        return f"array {value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}"
    if isinstance(value, Mapping):
        pairs = [(_constant(name), _constant(item)) for name, item in value.items()]
        return None if any(None in pair for pair in pairs) else f"mapping {sorted(map(str, pairs))}"
    if isinstance(value, (tuple, list, set, frozenset)):
        items = [_constant(item) for item in value]
        if any(item is None for item in items):
            return None
        ordered = isinstance(value, (tuple, list))
        return f"{type(value).__name__} {items if ordered else sorted(map(str, items))}"
    return None
