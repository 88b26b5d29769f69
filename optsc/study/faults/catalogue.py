"""All faults by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from optsc.errors import UnknownName
from optsc.study.faults import (
    call_faults,
    clock_faults,
    operator_faults,
    part_faults,
    reading_faults,
    sample_faults,
    session_faults,
)
from optsc.study.faults.fault import KINDS, Fault


def _all() -> Mapping[str, Fault]:
    rooms = (clock_faults, sample_faults, reading_faults, operator_faults, part_faults, call_faults, session_faults)
    return MappingProxyType({fault.name: fault for room in rooms for fault in room.faults()})


FAULTS = _all()
"""All faults by name."""


def chosen(words: Sequence[str] | None) -> tuple[Fault, ...]:
    """Return the faults of these names, kinds, or with these words in their names; all where there are none.

    Raises `UnknownName` for a word that nothing goes by.
    """
    if not words:
        return tuple(FAULTS.values())
    found: dict[str, Fault] = {}
    for word in words:
        if word in FAULTS:
            some = {word: FAULTS[word]}
        elif word in KINDS:
            some = {name: fault for name, fault in FAULTS.items() if fault.kind == word}
        else:
            some = {name: fault for name, fault in FAULTS.items() if word in name}
        if not some:
            raise UnknownName("fault or kind of fault", word, (*KINDS, *FAULTS))
        found.update(some)
    return tuple(found.values())
