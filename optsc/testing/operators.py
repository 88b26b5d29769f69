"""Contract tests of an operator: a device, a recording or a simulated person that hands in samples of a hand."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import cos, sin
from typing import ClassVar

import numpy as np

from optsc.geometry import Pose
from optsc.operators import Button, Operator, OperatorSample, OperatorView, fault_of
from optsc.testing.contract import Contract

DOWN = (0.0, 1.0, 0.0, 0.0)
"""A tool that points straight down (w, x, y, z)."""
_CLOCK = 1e-6  # how far a stamp may be ahead of the view [s]: the rounding of clocks


class OperatorContract(Contract):
    """What `optsc.operators.Operator` promises: `read` never raises, and what it hands in passes the border check.

    An operator may refuse its first view, of a scene that lacks what it wants, and no other.

    ::

        class TestMyDevice(OperatorContract):
            repeats = False

            def make_operator(self):
                return MyDevice("/dev/hidraw0")

    Attributes:
        objects: where the objects of the scene stand; for an operator that wants certain ones.
        repeats: whether operators that are made alike read alike from the same views, bit for bit; not so for a
            device.
    """

    objects: ClassVar[Mapping[str, Pose]] = {
        "box": Pose.from_translation([0.4, -0.3, 0.0]),
        "can": Pose.from_translation([0.5, 0.25, 0.0]),
        "mug": Pose.from_translation([0.55, -0.1, 0.0]),
    }
    repeats: ClassVar[bool] = True

    def make_operator(self) -> Operator:
        """Return a new operator, always with the same seed; to be overridden."""
        raise NotImplementedError

    def views(self, rate: float = 250.0, start: float = 0.0) -> list[OperatorView]:
        """Return 8 s in which the tool moves, objects are hidden for a while, and the robot works, twice."""
        grasps = {name: Pose.from_quaternion(DOWN, X.translation + [0, 0, 0.05]) for name, X in self.objects.items()}
        views = []
        for tick in range(round(8.0 * rate)):
            t = tick / rate
            X_WT = Pose.from_quaternion(DOWN, [0.35 + 0.1 * sin(t), 0.1 * (1.0 - cos(t)), 0.45])
            hidden, automatic = 2.0 <= t < 3.0, 4.0 <= t < 5.0 or 6.0 <= t < 7.0
            target = next(iter(self.objects), None) if 6.0 <= t < 7.0 else None
            seen, shown = ({}, {}) if hidden else (self.objects, grasps if t >= 1.0 else {})
            views.append(OperatorView(start + t, X_WT, automatic, t >= 7.5, seen, shown, target))
        return views

    def hostile_views(self) -> list[OperatorView]:
        """Return views that nobody plans for, after an ordinary one."""
        usual = self.views()[0]
        far = Pose.from_quaternion(DOWN, [1e4, -1e4, 1e4])
        odd = [
            usual._replace(objects={}),
            usual._replace(objects={"another": Pose.identity()}, automatic=True, target="none of these"),
            usual._replace(automatic=True, finished=True),
            usual._replace(X_WT=far, grasps=dict.fromkeys(self.objects, far)),
            usual,
        ]
        # Time stands still, goes on, and makes long jumps; it never goes back.
        steps = [0.0, 0.0, 0.004, 1e-9, 0.5, 0.2, 60.0]
        times = np.cumsum(steps * len(odd)).tolist()
        return [usual, *(odd[k // len(steps)]._replace(time=time) for k, time in enumerate(times))]

    def test_every_sample_passes_the_border_check_at_any_rate(self) -> None:
        for rate, start in ((90.0, 0.0), (250.0, 1000.0), (1000.0, 7.0)):
            read_all(self.make_operator(), self.views(rate, start))

    def test_read_never_raises_whatever_is_shown(self) -> None:
        read_all(self.make_operator(), self.hostile_views())

    def test_operators_that_are_made_alike_read_alike(self) -> None:
        for views in (self.views(), self.hostile_views()) if self.repeats else ():
            first, second = (as_bytes(read_all(self.make_operator(), views)) for _ in range(2))
            assert first == second, "the same views give other samples"

    def test_reading_changes_neither_the_view_nor_earlier_samples(self) -> None:
        views = self.views()
        at_once: list[bytes] = []
        before = [(dict(view.objects), dict(view.grasps)) for view in views]
        samples = read_all(self.make_operator(), views, at_once)
        assert [(view.objects, view.grasps) for view in views] == before, "a view was changed"
        assert as_bytes(samples) == b"".join(at_once), "a sample was changed after it had been handed in"


def read_all(
    operator: Operator, views: Iterable[OperatorView], copies: list[bytes] | None = None
) -> list[OperatorSample]:
    """Return the samples that an operator hands in; raise `AssertionError` for one that cannot be used, or for none.

    ``copies`` gets what each sample held when it was handed in.
    """
    samples: list[OperatorSample] = []
    for view in views:
        sample = operator.read(view)
        if sample is None:
            continue
        fault = fault_of(sample, samples[-1].stamp if samples else None)
        assert fault is None, f"at {view.time} s: {fault}"
        assert sample.stamp <= view.time + _CLOCK, f"at {view.time} s: stamp {sample.stamp} s is yet to come"
        for name in ("clutch", "trigger"):
            assert isinstance(getattr(sample, name), bool), f"{name} is {getattr(sample, name)!r}, not a bool"
        assert all(isinstance(b, Button) for b in sample.buttons), f"buttons are {sample.buttons!r}"
        samples.append(sample)
        if copies is not None:
            copies.append(as_bytes([sample]))
    assert samples, "no sample was handed in"
    return samples


def as_bytes(samples: Iterable[OperatorSample]) -> bytes:
    """Return everything that samples hold."""
    return b"".join(
        np.concatenate([[s.stamp], s.X_SH.translation, s.X_SH.quaternion, s.nudge or ()]).tobytes()
        + repr((s.clutch, s.trigger, sorted(button.name for button in s.buttons))).encode()
        for s in samples
    )
