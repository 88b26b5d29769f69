"""Faults of samples: of a wrong type or shape, not finite, with buttons that are none."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np

from optsc.geometry import Pose
from optsc.operators import OperatorSample
from optsc.study.faults.clock_faults import NOTHING_USABLE
from optsc.study.faults.fault import (
    FROM_THEN_ON,
    ONCE,
    Fault,
    Inject,
    Injection,
    everywhere,
    goes_on_everywhere,
    is_safe,
)

NAN, INF = float("nan"), float("inf")
Change = Callable[[OperatorSample], Any]


class Raises:
    """An object that raises at whatever is asked of it."""

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise ValueError("no array")

    def __getattr__(self, name: str) -> Any:
        raise RuntimeError(f"no {name}")

    def __bool__(self) -> bool:
        raise RuntimeError("neither true nor false")

    def __iter__(self) -> Any:
        raise RuntimeError("nothing to go through")

    def __float__(self) -> float:
        raise RuntimeError("no number")


def _becomes(value: Any) -> Change:
    return lambda _: value


def _field(**fields: Any) -> Change:
    # Values of wrong types are what this is for.
    return lambda sample: sample._replace(**fields)


def _at(p: Any = None, q: Any = None) -> Change:
    """Change position or orientation by a function."""

    def change(sample: OperatorSample) -> OperatorSample:
        X = sample.X_SH
        translation = X.translation.copy() if p is None else p(X.translation.copy())
        quaternion = X.quaternion.copy() if q is None else q(X.quaternion.copy())
        return sample._replace(X_SH=Pose(quaternion, translation))

    return change


def _placed(value: Any) -> Callable[[np.ndarray], np.ndarray]:
    def change(x: np.ndarray) -> np.ndarray:
        x[1] = value
        return x

    return change


def changed(change: Change) -> Inject:
    """Return a fault that changes samples."""
    return lambda _, __: Injection(sample=lambda ___, sample: change(sample))


NO_SAMPLES: dict[str, Change] = {
    "a word": _becomes("a sample"),
    "a matrix (4, 4)": _becomes(np.eye(4)),
    "a number": _becomes(3.0),
    "true": _becomes(True),
    "a list": _becomes([0.0] * 7),
    "a dictionary": _becomes({"stamp": 0.0}),
    "an object that raises": lambda _: Raises(),
    "a tuple of nothing": _becomes(OperatorSample(None, None, None, None, None, None)),  # type: ignore[arg-type]
    "a pose alone": lambda sample: sample.X_SH,
    "hand: nothing": _field(X_SH=None),
    "hand: a matrix (4, 4)": _field(X_SH=np.eye(4)),
    "hand: a word": _field(X_SH="there"),
    "hand: a vector (3,)": _field(X_SH=np.zeros(3)),
    "hand: raises": _field(X_SH=Raises()),
    "hand: a look-alike of lists": _field(X_SH=SimpleNamespace(translation=[0.0] * 3, quaternion=[1.0, 0, 0, 0])),
    "hand: a look-alike of wrong lengths": _field(
        X_SH=SimpleNamespace(translation=np.zeros(2), quaternion=np.zeros(3), shape=())
    ),
    "hand: a batch": _field(X_SH=Pose(np.tile([1.0, 0.0, 0.0, 0.0], (3, 1)), np.zeros((3, 3)))),
    "position: not a number": _at(p=_placed(NAN)),
    "position: infinite": _at(p=_placed(-INF)),
    "position: 1e300": _at(p=_placed(1e300)),
    "orientation: not a number": _at(q=_placed(NAN)),
    "orientation: zero": _at(q=lambda q: 0.0 * q),
    "orientation: denormal": _at(q=lambda q: 1e-310 * q),
    "orientation: twice a unit": _at(q=lambda q: 2.0 * q),
    "stamp: nothing": _field(stamp=None),
    "stamp: a word": _field(stamp="now"),
    "stamp: an array": _field(stamp=np.zeros(2)),
    "stamp: complex": _field(stamp=1j),
    "stamp: 10 to the 400": _field(stamp=10**400),
    "stamp: raises": _field(stamp=Raises()),
    "clutch: an array": _field(clutch=np.array([True, False])),
    "clutch: raises": _field(clutch=Raises()),
    "trigger: an array": _field(trigger=np.array([True, False])),
    "buttons: nothing": _field(buttons=None),
    "buttons: a number": _field(buttons=3),
    "buttons: raise": _field(buttons=Raises()),
    "buttons: of lists": _field(buttons=[[1], [2]]),
    "nudge: a number": _field(nudge=3.0),
    "nudge: words": _field(nudge=("a",) * 6),
    "nudge: too short": _field(nudge=(0.0, 0.0)),
    "nudge: not a number": _field(nudge=(NAN,) * 6),
    "nudge: 1e300": _field(nudge=(1e300,) * 6),
    "nudge: raises": _field(nudge=Raises()),
}
"""What is no sample: one of them is skipped."""
LASTING = (
    "a word",
    "a matrix (4, 4)",
    "an object that raises",
    "hand: a matrix (4, 4)",
    "hand: a batch",
    "position: not a number",
    "orientation: zero",
    "stamp: a word",
    "buttons: nothing",
    "nudge: not a number",
)
"""Of which nothing else comes any more, too."""
ODD: dict[str, Change] = {
    "denormal motion": _at(p=lambda p: p + 5e-324),
    "quaternion of the other sign": _at(q=lambda q: -q),
    "single precision": _at(q=lambda q: q.astype(np.float32), p=lambda p: p.astype(np.float32)),
    "numbers of numpy": lambda s: _field(stamp=np.float64(s.stamp), clutch=np.bool_(s.clutch))(s),
    "stamp in an array ()": lambda sample: _field(stamp=np.array(sample.stamp))(sample),
    "buttons as a list": _field(buttons=[]),
    "an unknown button": _field(buttons=frozenset({"fire", 7})),
}
"""Samples that are odd, and good."""


def faults() -> Iterator[Fault]:
    """Yield them all."""
    for name, change in NO_SAMPLES.items():
        yield Fault(f"one sample is none ({name})", "sample", ONCE, changed(change), goes_on_everywhere())
    for name in LASTING:
        yield Fault(f"no sample is one ({name})", "sample", FROM_THEN_ON, changed(NO_SAMPLES[name]), NOTHING_USABLE)
    for name, change in ODD.items():
        expected = everywhere(is_safe()) if name == "stamp in an array ()" else goes_on_everywhere()
        yield Fault(f"odd samples ({name})", "sample", FROM_THEN_ON, changed(change), expected)
