"""Dataclasses that check the declared ranges of their fields, and how they are made from a file's keys."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from inspect import get_annotations
from types import NoneType, SimpleNamespace, UnionType
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin, get_type_hints

from optsc.checks.rules import ArrayOf, Each, Flag, Number, OneOf, Range, Rule, Whole, broken, described
from optsc.errors import InvalidValue, UnknownName

T = TypeVar("T")


class Checked:
    """Base of dataclasses that check their fields when they are made, see the module's first lines.

    Raises:
        InvalidValue: a field with a value outside its range or of another type; it is named ``Class.field``.
        UnknownName: a name that is not among those of its kind.
    """

    __slots__ = ()

    def __post_init__(self) -> None:
        kind: Any = type(self)
        sizes: dict[str, int] = {}
        for name, rules, optional, array, as_tuple in _declared(kind):
            value = getattr(self, name)
            if value is None and optional:
                continue
            if array is not None:
                kept = array.read(f"{kind.__name__}.{name}", value, rules, sizes)
                object.__setattr__(self, name, kept)
                continue
            wrong = broken(rules, value)
            if wrong is not None:
                raise wrong.error(f"{kind.__name__}.{name}", value, described(rules))
            if as_tuple and not isinstance(value, tuple):
                object.__setattr__(self, name, tuple(value))


class _Declaration(NamedTuple):
    """What the type of a field says."""

    name: str
    rules: tuple[Rule, ...] = ()
    optional: bool = False
    array: ArrayOf | None = None
    as_tuple: bool = False


@cache
def _declared(cls: type) -> tuple[_Declaration, ...]:
    found = (_declaration(name, hint) for name, hint in _hints(cls).items())
    return tuple(field for field in found if field.rules or field.array)


@cache
def _hints(cls: type) -> dict[str, Any]:
    """Return the types of the fields that are given; those that only a type checker can resolve are left out."""
    hints: dict[str, Any] = {}
    for field in fields(cls):
        if not field.init:
            continue
        owner = next(base for base in cls.__mro__ if field.name in get_annotations(base))
        one: Any = SimpleNamespace(__annotations__={field.name: field.type})
        try:
            # The module's names go before the class's, as in `typing.get_type_hints` of a class.
            scope = vars(sys.modules[owner.__module__])
            hints |= get_type_hints(one, dict(vars(owner)), scope, include_extras=True)
        except NameError:
            if "Annotated" in str(field.type):
                raise
    return hints


def _declaration(name: str, hint: Any) -> _Declaration:
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        inner = _declaration(name, arguments[0])
        rules = tuple(rule for rule in arguments[1:] if isinstance(rule, Rule))
        array = next((rule for rule in rules if isinstance(rule, ArrayOf)), inner.array)
        rules = tuple(rule for rule in rules if not isinstance(rule, ArrayOf))
        if rules and array is None:
            rules = _with_type(_without_none(arguments[0]), rules)
        return inner._replace(
            rules=inner.rules + rules, array=array, as_tuple=get_origin(_without_none(arguments[0])) is tuple
        )
    if origin in (Union, UnionType):
        members = [kind for kind in arguments if kind is not NoneType]
        inner = _declaration(name, members[0]) if len(members) == 1 else _Declaration(name)
        return inner._replace(optional=len(members) < len(arguments))
    if origin is Literal:
        return _Declaration(name, (OneOf(arguments),))
    return _Declaration(name, (Flag,) if hint is bool else ())


def _without_none(hint: Any) -> Any:
    members = [kind for kind in get_args(hint) if kind is not NoneType]
    return members[0] if get_origin(hint) in (Union, UnionType) and len(members) == 1 else hint


def _with_type(kind: Any, rules: tuple[Rule, ...]) -> tuple[Rule, ...]:
    """Return ``rules`` with what the type itself says: whole numbers, the length of a tuple."""
    if kind is int:
        return (Whole, *rules)
    if kind is float:
        return rules if any(isinstance(rule, Range) for rule in rules) else (Number, *rules)
    if get_origin(kind) is not tuple:
        return rules
    elements = get_args(kind)
    length = None if Ellipsis in elements else len(elements)
    each = next((rule for rule in rules if isinstance(rule, Each)), Each())
    inner = _with_type(elements[0], each.rules) if len({*elements} - {Ellipsis}) == 1 else each.rules
    return (Each(*inner, length=length, words=each.words), *(rule for rule in rules if rule is not each))


def from_mapping(cls: type[T], mapping: Mapping[str, Any]) -> T:
    """Return settings of the dataclass ``cls`` from the keys of a file or a command line.

    A mapping in the place of another dataclass becomes one, a list in the place of a tuple a tuple.

    Raises:
        UnknownName: a key that is no field; it says which there are.
        InvalidValue: a field without a default is missing, or a value is outside its range.
    """
    known: Any = cls
    if not isinstance(mapping, Mapping):
        raise InvalidValue(cls.__name__, mapping, "settings by name")
    names = {field.name: field for field in fields(known) if field.init}
    for key in mapping:
        if key not in names:
            raise UnknownName(f"setting of {cls.__name__}", str(key), names)
    for name, field in names.items():
        if name not in mapping and field.default is MISSING and field.default_factory is MISSING:
            raise InvalidValue(f"{cls.__name__}.{name}", None, "given: it has no default")
    hints = _hints(known)
    return known(**{name: _built(value, hints.get(name)) for name, value in mapping.items()})


def _built(value: Any, hint: Any) -> Any:
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _built(value, arguments[0])
    if origin in (Union, UnionType):
        for kind in arguments:
            built = _built(value, kind) if is_dataclass(kind) == isinstance(value, Mapping) else value
            if built is not value:
                return built
        return value
    if origin is tuple and isinstance(value, list):
        kinds = arguments[:1] * len(value) if Ellipsis in arguments else arguments
        return tuple(_built(x, kind) for x, kind in zip(value, kinds, strict=False)) + tuple(value[len(kinds) :])
    if isinstance(hint, type) and is_dataclass(hint) and not isinstance(value, hint):
        return from_mapping(hint, value)
    return value
