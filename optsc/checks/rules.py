"""Rules: valid ranges of numbers, sequences, names and arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import inf
from numbers import Integral, Real
from typing import Any

from optsc.errors import InvalidValue, OptscError, UnknownName


class Rule:
    """What a value has to be. Subclasses define `describe` and `holds`; for a single condition see `Where`."""

    def describe(self) -> str:
        """Return the valid range, in words."""
        raise NotImplementedError

    def holds(self, value: Any) -> bool:
        """Tell whether ``value`` is valid; a TypeError or ValueError counts as no."""
        raise NotImplementedError

    def first_wrong(self, array: Any) -> Any:
        """Return the first invalid element of a numpy array, or None."""
        return next((x for x in array.ravel().tolist() if not self.holds(x)), None)

    def error(self, field: str, value: object, valid: str) -> OptscError:
        """Return the error for an invalid value."""
        return InvalidValue(field, value, valid)


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


@dataclass(frozen=True)
class Range(Rule):
    """A real number from ``low`` to ``high``; an open end is not part of the range. NaN is in no range."""

    words: str
    low: float = -inf
    high: float = inf
    open_low: bool = False
    open_high: bool = False

    def describe(self) -> str:
        """Return the words."""
        return self.words

    def holds(self, value: Any) -> bool:
        """Tell whether ``value`` is a number in the range."""
        if type(value) is not float and not _is_number(value):
            return False
        return (self.low < value if self.open_low else self.low <= value) and (
            value < self.high if self.open_high else value <= self.high
        )

    def first_wrong(self, array: Any) -> Any:
        """Return the first element of a numpy array that is outside the range, or None."""
        above = array > self.low if self.open_low else array >= self.low
        below = array < self.high if self.open_high else array <= self.high
        good = above & below
        return None if good.all() else array[~good][0].item()


Number = Range("a number")
Finite = Range("finite", open_low=True, open_high=True)
Positive = Range("finite, above 0", 0.0, open_low=True, open_high=True)
NonNegative = Range("finite, 0 or more", 0.0, open_high=True)
Share = Range("0 to 1", 0.0, 1.0)


def Above(low: float) -> Range:
    """Return the range of all numbers above ``low``, infinity included."""
    return Range(f"above {low:g}", low, open_low=True)


def Below(high: float) -> Range:
    """Return the range of all numbers below ``high``."""
    return Range(f"below {high:g}", high=high, open_high=True)


def AtLeast(low: float) -> Range:
    """Return the range from ``low`` on, infinity included."""
    return Range(f"at least {low:g}", low)


def AtMost(high: float) -> Range:
    """Return the range up to ``high``."""
    return Range(f"at most {high:g}", high=high)


def Between(low: float, high: float) -> Range:
    """Return the range from ``low`` to ``high``, both included."""
    return Range(f"{low:g} to {high:g}", low, high)


@dataclass(frozen=True)
class Where(Rule):
    """Any other condition: ``Where("odd", lambda n: n % 2 == 1)``."""

    words: str
    condition: Callable[[Any], bool]

    def describe(self) -> str:
        """Return the words."""
        return self.words

    def holds(self, value: Any) -> bool:
        """Tell whether the condition holds."""
        return bool(self.condition(value))


Whole = Where("a whole number", lambda x: isinstance(x, Integral) and not isinstance(x, bool))
"""Implied by the type ``int``."""
Flag = Where("True or False", lambda x: isinstance(x, bool) or (x.ndim == 0 and x.dtype == bool))
"""Implied by the type ``bool``."""
Ordered = Where("in ascending order", lambda xs: all(a <= b for a, b in pairwise(xs)))
"""Of a pair: the lower end first; equal neighbours are allowed."""


@dataclass(frozen=True)
class OneOf(Rule):
    """One of ``choices``; an unknown name raises `UnknownName` where ``kind`` says what they are names of."""

    choices: Iterable[Any]
    kind: str = ""

    def describe(self) -> str:
        """Return the choices, in words."""
        return f"one of {', '.join(map(str, self.choices))}"

    def holds(self, value: Any) -> bool:
        """Tell whether ``value`` is among the choices."""
        return value in self.choices

    def error(self, field: str, value: object, valid: str) -> OptscError:
        """Return an `UnknownName` for a name of a known kind, else an `InvalidValue`."""
        if self.kind and isinstance(value, str):
            return UnknownName(self.kind, value, self.choices)
        return super().error(field, value, valid)


_COUNTS = {1: "one value", 2: "two values", 3: "three values", 4: "four values"}


class Each(Rule):
    """A sequence whose elements all follow ``rules``; the tuple type of the field says how many there are."""

    def __init__(self, *rules: Rule, length: int | None = None, words: str = "") -> None:
        self.rules, self.length, self.words = rules, length, words

    def describe(self) -> str:
        """Return number and range of the elements."""
        count = "values" if self.length is None else _COUNTS.get(self.length, f"{self.length} values")
        return self.words or f"{count}, each {described(self.rules)}"

    def holds(self, value: Any) -> bool:
        """Tell whether ``value`` has the length, and valid elements."""
        if not isinstance(value, (tuple, list)) and getattr(value, "ndim", None) != 1:
            return False
        if self.length is not None and len(value) != self.length:
            return False
        return all(rule.holds(x) for x in value for rule in self.rules)


Pair = Each(Positive, length=2, words="two finite numbers above 0")


class ArrayOf(Rule):
    """A numpy array of a shape, kept as a read-only copy of type ``dtype``; ranges beside it hold for each element.

    Args:
        shape: size of each axis; None for any, a name for one that other fields of the same object share.
        dtype: to which the values are converted, without loss of kind (no floats to integers).
        least: the smallest number of rows.
    """

    def __init__(self, *shape: int | str | None, dtype: Any = float, least: int = 0) -> None:
        self.shape, self.dtype, self.least = shape, dtype, least

    def describe(self) -> str:
        """Return the shape, in words."""
        return self._shape_words({})

    def _shape_words(self, sizes: Mapping[str, int]) -> str:
        known = [str(sizes.get(n, n) if isinstance(n, str) else "any" if n is None else n) for n in self.shape]
        rows = f", at least {self.least} rows" if self.least else ""
        return f"shape ({', '.join(known)}{',' if len(known) == 1 else ''}){rows}"

    def read(self, field: str, value: Any, rules: Sequence[Rule], sizes: dict[str, int]) -> Any:
        """Return the read-only copy of ``value``; sizes of named axes are looked up in ``sizes`` or added."""
        import numpy as np

        try:
            array = np.array(value)
            array = array.astype(self.dtype, casting="same_kind" if array.size else "unsafe")
        except (TypeError, ValueError):
            raise InvalidValue(field, value, f"{np.dtype(self.dtype)}, {self._shape_words(sizes)}") from None
        fits = array.ndim == len(self.shape) and (not self.least or len(array) >= self.least)
        for wanted, size in zip(self.shape, array.shape, strict=False):
            expected = sizes.get(wanted, size) if isinstance(wanted, str) else wanted
            fits = fits and expected in (None, size)
        if not fits:
            raise InvalidValue(field, array.shape, self._shape_words(sizes))
        sizes.update((n, m) for n, m in zip(self.shape, array.shape, strict=True) if isinstance(n, str))
        for rule in rules:
            wrong = rule.first_wrong(array)
            if wrong is not None:
                raise rule.error(field, wrong, f"each {described(rules)}")
        array.flags.writeable = False
        return array


def described(rules: Iterable[Rule]) -> str:
    """Return what all ``rules`` ask for, in words."""
    return ", ".join(rule.describe() for rule in rules)


def require(field: str, value: object, *rules: Rule) -> None:
    """Raise `InvalidValue` unless ``value`` follows all ``rules``: ``require("rate", rate, Positive)``."""
    wrong = broken(rules, value)
    if wrong is not None:
        raise wrong.error(field, value, described(rules))


def broken(rules: Iterable[Rule], value: object) -> Rule | None:
    """Return the first of ``rules`` that ``value`` does not follow."""
    for rule in rules:
        try:
            if rule.holds(value):
                continue
        except (TypeError, ValueError, AttributeError, LookupError, ArithmeticError):
            pass  # a value of another type altogether
        return rule
    return None
