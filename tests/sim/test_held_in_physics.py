"""What is called held is between the jaws of a simulated hand, and what is put down stands."""

from dataclasses import replace

import numpy as np
import pybullet
import pytest

from optsc.control.approach import Approach
from optsc.control.modes import Event, Mode
from optsc.geometry import Pose, rotation
from optsc.operators import OperatorSample
from optsc.people.simulated import R_WS_DEFAULT
from optsc.robot import load_robot
from optsc.selection import GraspSelector
from optsc.sim import Tabletop, object_model
from optsc.sim.follower import PyBulletFollower
from optsc.study.episode_setup import controller_with, true_scene
from optsc.study.libraries import library_of

PERIOD = 1 / 250.0
STOOD = Pose.from_translation([0.5, 0.05, 0.0])


@pytest.fixture(scope="module")
def robot():
    return load_robot("panda")


class Bench:
    """An arm in a simulated world that grasps one object, and a hand that leads it."""

    def __init__(self, robot, name, *, lift=0.15, narrower=0.0):
        self.name, self.robot = name, robot
        world = Tabletop(robot, {name: object_model(name)}, {name: STOOD})
        scene = true_scene(world, library_of(robot, tuple(world.objects.values()), None))
        candidates = replace(scene.candidates, opening=np.maximum(scene.candidates.opening - narrower, 2e-3))
        approach = Approach(speed=0.3, acceleration=2.0, jerk=20.0, lift=lift, carry_time=0.3)
        self.controller = controller_with(GraspSelector(robot), approach)
        self.controller.reset(robot.home, 1 / PERIOD)
        self.controller.observe(candidates, scene.clear)
        self.follower = PyBulletFollower(world)
        self.measured = self.follower.reset(robot.home)
        q = rotation.multiply(rotation.conjugate(R_WS_DEFAULT), robot.forward(robot.home).quaternion)
        self.hand, self.steps = Pose(q, np.zeros(3)), []
        self.go(0.2)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.follower.close()

    @property
    def body(self):
        return self.follower.physics._bodies[self.name]

    @property
    def height(self):
        return self.follower.height(self.name)

    def tick(self, **sample):
        step = self.controller.step(OperatorSample(self.controller.time, self.hand, **sample), self.measured)
        self.measured = self.follower.apply(step.command.q, step.command.v, step.opening, PERIOD)
        self.steps.append(step)
        return step

    def go(self, seconds, move=(0.0, 0.0, 0.0)):
        ticks = round(seconds / PERIOD)
        shift = rotation.rotate(rotation.conjugate(R_WS_DEFAULT), np.array(move)) / ticks
        for _ in range(ticks):
            self.hand = Pose(self.hand.quaternion, self.hand.translation + shift)
            step = self.tick()
        return step

    def press(self):
        self.tick(trigger=True)
        self.go(0.16)

    def until(self, mode, longest=9.0):
        end = self.controller.time + longest
        while self.controller.mode is not mode:
            assert self.controller.time < end, f"{mode} was not reached, {self.steps[-1].reason}"
            self.tick()
        self.tick()
        return self

    def take_away(self):
        client = self.follower.physics.client
        pybullet.resetBasePositionAndOrientation(self.body, [1.5, 1.5, 0.5], [0, 0, 0, 1], physicsClientId=client)


@pytest.mark.parametrize("when", [Mode.ADVANCE, Mode.LIFT, Mode.CARRY])
def test_an_object_that_is_taken_away_is_not_called_held(robot, when):
    with Bench(robot, "can") as bench:
        bench.press()
        bench.until(when)
        bench.take_away()
        bench.until(Mode.HOLD, 2.5)
        step = bench.go(0.6)
        assert ("closed on nothing" if when is Mode.ADVANCE else "no longer between the jaws") in step.reason
        assert step.held is None
        assert not bench.controller.finished
        assert bench.measured.opening < 2e-3


def test_a_box_that_is_wider_than_expected_stays_on_the_table(robot):
    with Bench(robot, "box", narrower=0.02) as bench:
        bench.press()
        bench.until(Mode.HOLD)
        assert "something wider" in bench.go(0.5).reason
        assert bench.height < 2e-3
        assert Mode.LIFT not in {step.mode for step in bench.steps}


def test_an_object_that_slides_out_of_the_jaws_is_lost(robot):
    with Bench(robot, "can", lift=0.2) as bench:
        bench.press()
        bench.until(Mode.LIFT)
        client = bench.follower.physics.client
        pybullet.changeDynamics(bench.body, -1, lateralFriction=0.05, physicsClientId=client)
        for _ in range(500):
            # Something has hold of it from below.
            at = bench.follower.objects()["can"].translation.tolist()
            pybullet.applyExternalForce(bench.body, -1, [0, 0, -300], at, pybullet.WORLD_FRAME, physicsClientId=client)
            bench.tick()
            if bench.controller.mode is Mode.HOLD:
                break
        bench.until(Mode.HOLD, 1.0)
        bench.go(1.0)
        assert {step.event for step in bench.steps} & {Event.LOST, Event.SLIPPED}
        assert bench.controller.state.held is None
        assert bench.controller.state.tasks == 0


@pytest.mark.parametrize("seed", range(2))
def test_an_object_is_put_down_standing_from_any_height(robot, seed):
    rng = np.random.default_rng(seed)
    with Bench(robot, "can", lift=float(rng.uniform(0.08, 0.25))) as bench:
        bench.press()
        bench.until(Mode.CARRY)
        held = bench.steps[-1].held
        assert held.opening == pytest.approx(held.target.opening, abs=1e-3)
        # The hand bounces on the trigger: one press, and the object stays where it is.
        height = bench.height
        bench.tick(trigger=True)
        bench.tick(trigger=False)
        bench.tick(trigger=True)
        bench.go(0.3)
        assert bench.controller.mode is Mode.MANUAL
        assert bench.height == pytest.approx(height, abs=5e-3)
        bench.go(0.8, move=(*rng.uniform(-0.06, 0.06, 2), float(rng.uniform(-0.02, 0.05))))
        bench.go(0.5)
        bench.press()
        bench.until(Mode.MANUAL)
        bench.go(0.5)
        X_WO = bench.follower.objects()["can"]
        assert X_WO.translation[2] < 3e-3
        assert rotation.rotate(X_WO.quaternion, [0.0, 0.0, 1.0])[2] > 0.999
        assert bench.controller.state.held is None
        assert bench.controller.state.tasks == 1
