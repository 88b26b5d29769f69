"""Columns: names for the parts of a row of numbers that processes share."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import accumulate

from optsc.errors import InvalidValue, UnknownName

CHARACTERS_PER_NUMBER = 8
"""A double carries eight bytes, and so eight characters of a text in UTF-8."""


@dataclass(frozen=True)
class Columns:
    """Names and widths of the parts of a row of doubles, in their order.

    Attributes:
        widths: how many doubles each part has, by name.
    """

    widths: Mapping[str, int]

    def __post_init__(self) -> None:
        for name, width in self.widths.items():
            if width < 0:
                raise InvalidValue(f"width of column {name}", width, "0 or more")
        ends = list(accumulate(self.widths.values()))
        starts = [end - width for end, width in zip(ends, self.widths.values(), strict=True)]
        parts = {n: slice(a, b) for n, a, b in zip(self.widths, starts, ends, strict=True)}
        object.__setattr__(self, "_parts", parts)

    @property
    def size(self) -> int:
        """How many doubles a row has."""
        return sum(self.widths.values())

    def __iter__(self) -> Iterator[str]:
        return iter(self.widths)

    def __getitem__(self, name: str) -> slice:
        """Return where the part of that name is in a row; raise `UnknownName`."""
        parts: dict[str, slice] = self._parts  # type: ignore[attr-defined]
        if name not in parts:
            raise UnknownName("column", name, parts)
        return parts[name]

    def at(self, name: str) -> int:
        """Return the place of a part that is a single number; raise `UnknownName` or `InvalidValue`."""
        part = self[name]
        if part.stop - part.start != 1:
            raise InvalidValue(f"width of column {name}", part.stop - part.start, "1")
        return part.start

    @property
    def labels(self) -> tuple[str, ...]:
        """A name for every double of a row: that of its part, numbered where the part has more than one."""
        return tuple(
            name if width == 1 else f"{name}_{index}" for name, width in self.widths.items() for index in range(width)
        )
