"""A person who sees the tool and leads it somewhere, and a scene to do that in; for the tests of arbitration."""

import numpy as np

import optsc
from optsc.geometry import Pose, rotation
from optsc.grasps import Candidates
from optsc.operators import OperatorSample

PERIOD = 1 / 500.0
SAMPLE = 5
R_WS = tuple(rotation.exp([0.0, 0.0, 0.7]))
DOWN = np.array([0.0, 1.0, 0.0, 0.0])
PLACES = {"left": (0.45, 0.2, 0.15), "middle": (0.6, 0.0, 0.12), "right": (0.5, -0.2, 0.12)}


def scene(places=PLACES, count=12, seed=0):
    """Grasps from above, tilted by up to half a radian, of things at places in the world."""
    rng = np.random.default_rng(seed)
    total = count * len(places)
    q = rotation.multiply(rotation.exp(rng.uniform(-0.3, 0.3, (total, 3))), DOWN)
    p = np.repeat(np.array(list(places.values())), count, axis=0) + rng.uniform(-0.01, 0.01, (total, 3))
    return Candidates(
        object_names=tuple(places),
        object_index=np.repeat(np.arange(len(places)), count),
        grasp_index=np.tile(np.arange(count), len(places)),
        X_WG=Pose(q, p),
        opening=np.full(total, 0.04),
        quality=np.ones(total),
        jaw_symmetric=True,
    )


def controller(robot, arbitration=None, **settings):
    """A shared controller with the default selector and the station's rotation."""
    return optsc.SharedController(
        robot,
        optsc.GraspSelector(robot),
        arbitration=arbitration,
        clutch=optsc.ClutchSettings(R_WS=R_WS),
        **settings,
    )


class Person:
    """Leads the tool straight to a pose at 0.12 m/s, seeing where it is, and presses the trigger there."""

    def __init__(self, p, near=(0.012, 0.15)):
        self.goal, self.near = Pose(DOWN, np.array(p, dtype=float)), near
        self.hand, self.pressed, self.seen = None, -9.0, 0.0

    def read(self, view):
        if round(view.time / PERIOD) % SAMPLE:
            return None
        to_station = rotation.conjugate(R_WS)
        if self.hand is None:
            self.hand = Pose(rotation.multiply(to_station, view.X_WT.quaternion), np.zeros(3))
        if not view.automatic and view.time > 0.2:
            way = self.goal.translation - view.X_WT.translation
            turn = rotation.log(
                rotation.multiply(self.goal.quaternion, rotation.conjugate(view.X_WT.quaternion))
            )
            distance, angle = np.linalg.norm(way), np.linalg.norm(turn)
            step = min(view.time - self.seen, 0.05)
            v, w = way * min(0.12 / (distance + 1e-9), 2.0), turn * min(0.4 / (angle + 1e-9), 2.0)
            self.hand = Pose(
                rotation.multiply(rotation.exp(rotation.rotate(to_station, w * step)), self.hand.quaternion),
                self.hand.translation + rotation.rotate(to_station, v * step),
            )
            if distance < self.near[0] and angle < self.near[1] and view.time > self.pressed + 1.0:
                self.pressed = view.time
        self.seen = view.time
        return OperatorSample(view.time, self.hand, True, 0 <= view.time - self.pressed < 0.1)


class Loop:
    """A controller with an ideal arm, fed by hand."""

    def __init__(self, robot, candidates=None, clear=None, arbitration=None, **settings):
        self.robot, self.controller = robot, controller(robot, arbitration, **settings)
        self.controller.reset(robot.home)
        self.follower = optsc.IdealFollower(robot)
        self.measured = self.follower.reset(robot.home)
        q = rotation.multiply(rotation.conjugate(R_WS), robot.forward(robot.home).quaternion)
        self.hand = Pose(q, np.zeros(3))
        self.steps, self.reference = [], []
        if candidates is not None:
            self.controller.observe(candidates, clear)

    @property
    def time(self):
        return self.controller.time

    def tick(self, sample=None):
        """One tick; what was decided, and where the tool is led, are kept."""
        step = self.controller.step(sample, self.measured)
        self.measured = self.follower.apply(step.command.q, step.command.v, step.opening, PERIOD)
        self.steps.append(step)
        self.reference.append(np.concatenate(self.controller.servo.reference))
        return step

    def go(self, seconds, move=(0.0, 0.0, 0.0), **sample):
        """Move the hand steadily by a displacement in the world's axes; the rest goes into every sample."""
        ticks = max(1, round(seconds / PERIOD))
        way = rotation.rotate(rotation.conjugate(R_WS), np.asarray(move, dtype=float)) / ticks
        for k in range(ticks):
            self.hand = Pose(self.hand.quaternion, self.hand.translation + way)
            self.tick(OperatorSample(self.time, self.hand, **sample) if k % SAMPLE == 0 else None)
        return self.steps[-1]

    def press(self, **sample):
        """Press the trigger, and let go of it."""
        first = self.tick(OperatorSample(self.time, self.hand, trigger=True, **sample))
        self.go(0.06)
        return first

    def tool(self):
        return self.robot.forward(self.controller.servo.guard.q)


def modes(steps):
    """The modes in their order."""
    return [step.mode.value for i, step in enumerate(steps) if i == 0 or step.mode is not steps[i - 1].mode]


def assert_limits_hold(robot, steps, period=PERIOD):
    """Velocity, acceleration and jerk are finite and within limits at every tick, so that nothing jumps."""
    commands = [step.command for step in steps]
    q, v, a = (np.array([getattr(command, name) for command in commands]) for name in ("q", "v", "a"))
    assert np.all(np.isfinite(q))
    assert np.all(np.abs(v) <= robot.limits.velocity)
    assert np.all(np.abs(a) <= robot.limits.acceleration)
    assert np.all(np.abs(np.diff(a, axis=0)) <= robot.limits.jerk * period * (1 + 1e-9))
    assert np.all((q >= robot.limits.lower) & (q <= robot.limits.upper))
    np.testing.assert_allclose(np.diff(q, axis=0), 0.5 * (v[1:] + v[:-1]) * period, atol=1e-9)
