"""Faults of the calls between ticks: scenes that are none, limits that change, recentring and resetting in motion."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from optsc.control.modes import Mode
from optsc.errors import OptscError
from optsc.geometry import Pose, rotation
from optsc.grasps import Candidates
from optsc.robot import JointLimits
from optsc.study.faults.fault import (
    FROM_THEN_ON,
    Expected,
    Fault,
    Inject,
    Injection,
    everywhere,
    goes_on,
    goes_on_everywhere,
    holds,
    is_safe,
)
from optsc.study.faults.part_faults import FailureError, fails
from optsc.study.faults.run import HalfDoneError
from optsc.study.faults.world import World, scene

REFUSALS = (OptscError, FailureError, ValueError, TypeError, AttributeError, IndexError)
"""What a call between ticks may raise, as long as it changes nothing."""


def calls(call: Callable[[World], Any]) -> Inject:
    """Return a fault that is one call, which may be refused, and then leaves all as it was."""

    def start(world: World) -> None:
        before = world.controller.snapshot()
        try:
            call(world)
        except REFUSALS as error:
            if world.controller.snapshot() != before:
                raise HalfDoneError(f"{type(error).__name__}: {error}") from error

    return lambda _, __: Injection(start=start)


def refused(call: Callable[[World], Any]) -> Inject:
    """Return a fault that is one call, which has to be refused."""

    def demanded(world: World) -> None:
        before = world.controller.snapshot()
        try:
            call(world)
        except REFUSALS as error:
            if world.controller.snapshot() != before:
                raise HalfDoneError(f"{type(error).__name__}: {error}") from error
            return
        raise HalfDoneError("what should be refused was taken")

    return lambda _, __: Injection(start=demanded)


def every_tick(call: Callable[[World], Any], every: int = 1) -> Inject:
    """Return a fault that is a call before every so many ticks."""

    def inject(_: World, __: np.random.Generator) -> Injection:
        count: list[None] = []

        def tick(world: World, _: float) -> None:
            count.append(None)
            if len(count) % every == 0:
                call(world)

        return Injection(tick=tick)

    return inject


def observing(change: Callable[[World, Candidates], Candidates], clear: bool = True) -> Callable[[World], None]:
    """Return a call that observes a changed scene."""
    return lambda world: world.controller.observe(change(world, world.candidates), world.clear if clear else None)


def _not_finite(_: World, candidates: Candidates) -> Candidates:
    p = candidates.X_WG.translation.copy()
    p[::2] = np.nan
    return replace(candidates, X_WG=Pose(candidates.X_WG.quaternion, p))


def _empty(_: World, candidates: Candidates) -> Candidates:
    return candidates.select(np.zeros(0, dtype=np.int64))


def _displaced(world: World, _: Candidates) -> Candidates:
    return scene(world.robot, shift=np.array([0.05, 0.03, 0.0]))


def _sampled_again(_: World, candidates: Candidates) -> Candidates:
    """The same grasps with other numbers."""
    rows = np.random.default_rng(1).permutation(len(candidates))
    rows = rows[np.argsort(candidates.object_index[rows], kind="stable")]
    again = candidates.select(rows)
    return replace(again, grasp_index=candidates.grasp_index)


def _other_names(_: World, candidates: Candidates) -> Candidates:
    return replace(candidates, object_names=("one", "two"))


def _tilted(_: World, candidates: Candidates) -> Candidates:
    """Grasps that no arm reaches: all far away."""
    X = candidates.X_WG
    return replace(candidates, X_WG=Pose(X.quaternion, X.translation + [5.0, 0.0, 0.0]))


def _limits(world: World, velocity: float = 1.0, acceleration: float = 1.0, jerk: float = 1.0) -> JointLimits:
    now = world.robot.limits
    return JointLimits(now.lower, now.upper, velocity * now.velocity, acceleration * now.acceleration, jerk * now.jerk)


def _slower(share: float) -> Inject:
    return calls(lambda world: world.controller.servo.set_limits(_limits(world, velocity=share)))


def _short_limits(world: World) -> JointLimits:
    return JointLimits(*(getattr(world.robot.limits, name)[:-1] for name in LIMITS))


LIMITS = ("lower", "upper", "velocity", "acceleration", "jerk")


def _reset_here(world: World) -> None:
    world.controller.reset(world.arm.measured().q, 1.0 / world.period)
    world.take_solver()
    world.controller.observe(world.candidates, world.clear)


def _restored(world: World) -> None:
    world.controller.restore(world.controller.snapshot())


def _other_snapshot(world: World) -> None:
    snapshot = world.controller.snapshot()
    world.controller.restore(replace(snapshot, servo=replace(snapshot.servo, period=0.5 * world.period)))


def _mapping(world: World) -> None:
    turn = rotation.exp([0.0, 0.0, 0.3])
    clutch = world.controller.clutch
    again = getattr(world.controller, "set_clutch", None)
    if again is not None:
        again(replace(clutch, R_WS=tuple(rotation.multiply(turn, clutch.R_WS).tolist())))


def faults() -> Iterator[Fault]:
    """Yield them all."""
    before_contact = {
        mode: holds("moved", "gone", "other", "no grasps any more")
        for mode in (Mode.APPROACH, Mode.ADJUST, Mode.ADVANCE)
    }
    changed = Expected(goes_on(), goes_on(), goes_on(), before_contact)
    kind = "calls"

    def one(name: str, inject: Inject, expected: Expected, **more: Any) -> Fault:
        return Fault(name, kind, FROM_THEN_ON, inject, expected, **more)

    yield one("a scene with poses that are no numbers", calls(observing(_not_finite)), everywhere(is_safe()))
    yield one("an empty scene", calls(observing(_empty)), changed)
    yield one("no scene", refused(lambda world: world.controller.observe(None)), goes_on_everywhere())  # type: ignore[arg-type]
    yield one("a word for a scene", refused(lambda world: world.controller.observe("scene")), goes_on_everywhere())  # type: ignore[arg-type]
    yield one("the scene again", calls(observing(lambda _, c: c)), goes_on_everywhere())
    yield one("the scene again at every tenth tick", every_tick(observing(lambda _, c: c), 10), goes_on_everywhere())
    yield one("the objects have moved", calls(observing(_displaced)), changed)
    yield one("other objects", calls(observing(_other_names)), changed)
    yield one("all objects are out of reach", calls(observing(_tilted)), changed)
    yield one("grasps sampled again", calls(observing(_sampled_again)), goes_on_everywhere())
    yield one("a scene without a collision check", calls(observing(lambda _, c: c, False)), goes_on_everywhere())
    failing = refused(lambda world: world.controller.observe(scene(world.robot, 3), fails))
    yield one("a scene whose collision check raises", failing, goes_on_everywhere())
    yield one("recentring once", calls(lambda w: w.controller.recentre()), everywhere(is_safe()), recouples=True)
    yield one(
        "recentring at every tick", every_tick(lambda w: w.controller.recentre()), everywhere(is_safe()), recouples=True
    )
    yield one("another mapping of the hand", calls(_mapping), everywhere(is_safe()), recouples=True, far=True)
    for name, share in (("half", 0.5), ("a tenth of", 0.1)):
        slower = _slower(share)
        yield one(f"{name} the velocity limits from now on", slower, everywhere(is_safe()), far=True)
    softer = calls(lambda w: w.controller.servo.set_limits(_limits(w, 0.8, 1.0, 0.5)))
    yield one("softer limits from now on", softer, everywhere(is_safe()), far=True)
    short = refused(lambda w: w.controller.servo.set_limits(_short_limits(w)))
    yield one("limits of a joint too few", short, goes_on_everywhere())
    nowhere = refused(lambda w: w.controller.servo.prefer(np.full(w.robot.n, np.nan)))
    yield one("a preferred configuration that is none", nowhere, goes_on_everywhere())
    yield one("resetting where the arm is", calls(_reset_here), everywhere(is_safe()), restarts=True, recouples=True)
    no_reset = refused(lambda w: w.controller.reset(np.zeros(w.robot.n - 1)))
    yield one("resetting to a joint too few", no_reset, goes_on_everywhere())
    yield one("back to the same snapshot at every tick", every_tick(_restored), goes_on_everywhere())
    yield one("a snapshot of another rate", refused(_other_snapshot), goes_on_everywhere())
