"""Messages of the page: what may come in over a socket, checked before anything is done with it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from math import isfinite
from typing import Any, NamedTuple

from optsc.errors import InvalidValue, UnknownName
from optsc.live.hand_mailbox import PRESSABLE

LARGEST_MESSAGE = 2048
"""Bytes of a message at most; that of a hand has about 250."""
REACH = 10.0
"""How far a hand can be from the origin of its station [m]."""
MOST_PRESSES = 8
"""Presses in one message, at most."""
_UNIT = 1e-3


class HandMessage(NamedTuple):
    """Where the hand is, whether it is coupled, and what was pressed since the message before.

    Attributes:
        p, q: position [m] and unit quaternion (w, x, y, z).
        engaged: whether the hand is coupled to the arm.
        pressed: names of `PRESSABLE`.
        time: on the page's clock [s].
    """

    p: tuple[float, float, float]
    q: tuple[float, float, float, float]
    engaged: bool
    pressed: tuple[str, ...]
    time: float


class SettingsMessage(NamedTuple):
    """Settings that are to be changed, see `LiveSettings.changed`."""

    values: Mapping[str, Any]


class ClaimMessage(NamedTuple):
    """The page asks to be the operator's."""


class AwayMessage(NamedTuple):
    """The page is hidden or closed: nobody looks."""


Message = HandMessage | SettingsMessage | ClaimMessage | AwayMessage


def parsed(text: str | bytes) -> Message:
    """Return what a message says; raise `InvalidValue` or `UnknownName` for anything but a well-formed one."""
    if not isinstance(text, str):
        raise InvalidValue("message", f"{len(text)} bytes", "text")
    if len(text) > LARGEST_MESSAGE:
        raise InvalidValue("message", f"{len(text)} characters", f"up to {LARGEST_MESSAGE}")
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        raise InvalidValue("message", text[:40], "JSON") from None
    if not isinstance(content, dict):
        raise InvalidValue("message", text[:40], "an object")
    kind = content.pop("kind", None)
    if kind == "hand":
        return _hand(content)
    if kind == "settings":
        _only(content, ("values",))
        values = content["values"]
        if not isinstance(values, dict):
            raise InvalidValue("values", values, "an object")
        return SettingsMessage(values)
    _only(content, ())
    if kind == "claim":
        return ClaimMessage()
    if kind == "away":
        return AwayMessage()
    raise UnknownName("kind of message", str(kind)[:40], ("hand", "settings", "claim", "away"))


def _hand(content: dict[str, Any]) -> HandMessage:
    _only(content, ("p", "q", "engaged", "pressed", "time"))
    p, q = _numbers(content, "p", 3), _numbers(content, "q", 4)
    if max(map(abs, p)) > REACH:
        raise InvalidValue("p", p, f"within {REACH:g} m")
    if abs(sum(part * part for part in q) - 1.0) > 2.0 * _UNIT:
        raise InvalidValue("q", q, "a unit quaternion")
    engaged, pressed, time = content["engaged"], content["pressed"], content["time"]
    if not isinstance(engaged, bool):
        raise InvalidValue("engaged", engaged, "true or false")
    if not isinstance(pressed, list) or len(pressed) > MOST_PRESSES:
        raise InvalidValue("pressed", str(pressed)[:60], f"a list of up to {MOST_PRESSES} names")
    for name in pressed:
        if name not in PRESSABLE:
            raise UnknownName("button", str(name)[:40], PRESSABLE)
    if not _is_number(time):
        raise InvalidValue("time", time, "a number")
    return HandMessage((p[0], p[1], p[2]), (q[0], q[1], q[2], q[3]), engaged, tuple(pressed), float(time))


def _only(content: Mapping[str, Any], names: tuple[str, ...]) -> None:
    if set(content) != set(names):
        raise InvalidValue("fields of the message", sorted(map(str, content))[:8], f"kind and {sorted(names)}")


def _numbers(content: Mapping[str, Any], name: str, count: int) -> list[float]:
    values = content[name]
    if not isinstance(values, list) or len(values) != count or not all(map(_is_number, values)):
        raise InvalidValue(name, str(values)[:60], f"{count} finite numbers")
    return [float(value) for value in values]


def _is_number(value: object) -> bool:
    # A bool is an int, and a large int is no float.
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e15 and isfinite(value)
