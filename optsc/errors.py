"""What can go wrong at a border: each error says what is wrong, the value, and what would be right."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any


class OptscError(Exception):
    """Base of every error that this library raises on purpose. A copy from another process says and holds the same."""

    def __reduce__(self) -> tuple[Any, ...]:
        # By default the message would be passed to `__init__`, which wants what the message is made of.
        return _copied, (type(self), self.args, self.__dict__)


def _copied(kind: type[OptscError], args: tuple[Any, ...], fields: dict[str, Any]) -> OptscError:
    error = kind.__new__(kind)
    error.args = args
    error.__dict__.update(fields)
    return error


class InvalidValue(OptscError, ValueError):
    """A value from outside lies outside its valid range.

    Args:
        field: what the value is, as the caller knows it.
        value: the offending value.
        valid: the valid range, in words.
    """

    def __init__(self, field: str, value: object, valid: str) -> None:
        self.field, self.value, self.valid = field, value, valid
        super().__init__(f"{field} is {value!r}; valid: {valid}")


class UnknownName(OptscError, LookupError):
    """A name that nothing goes by, with the names that would have been valid and the closest of them."""

    def __init__(self, kind: str, name: str, choices: Iterable[str]) -> None:
        self.kind, self.name, self.choices = kind, name, tuple(sorted(choices))
        close = get_close_matches(str(name), self.choices, n=1)
        hint = f" (did you mean {close[0]!r}?)" if close else ""
        super().__init__(f"no {kind} named {name!r}; there are: {', '.join(self.choices) or 'none'}{hint}")


class DamagedFile(OptscError):
    """A file that cannot be read as what it claims to be."""

    def __init__(self, path: object, reason: str) -> None:
        self.path, self.reason = path, reason
        super().__init__(f"{path}: {reason}")


class Mismatch(OptscError):
    """Two things that were made for different partners, such as a grasp set and another gripper."""

    def __init__(self, what: str, made_for: object, used_with: object) -> None:
        self.what, self.made_for, self.used_with = what, made_for, used_with
        super().__init__(f"{what} was made for {made_for!r} and cannot be used with {used_with!r}")


class Closed(OptscError, RuntimeError):
    """Something was used after it had been closed."""

    def __init__(self, what: str) -> None:
        super().__init__(f"this {what} is closed; make a new one")


class SolverFailure(OptscError):
    """A one-off computation outside the control loop that has no answer (the loop itself never raises)."""
