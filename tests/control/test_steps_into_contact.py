"""Hands that jump, are lost, or take over at a grasp: the tool of the shared controller turns only as the hand does."""

import numpy as np
import pytest

import optsc
from optsc.control.modes import Mode
from optsc.geometry import Pose, rotation
from optsc.operators import ClutchSettings, OperatorSample
from optsc.robot import load_robot
from optsc.testing.loop import PERIOD, R_WS, Loop, modes, scene

PLACE = {"thing": (0.45, 0.05, 0.15)}


@pytest.fixture(scope="module")
def robot():
    return load_robot("panda")


class Turned(Loop):
    """A loop whose hand may be turned against the tool, sampled at a rate."""

    def __init__(self, robot, every=5, **options):
        super().__init__(robot, **options)
        self.every = every

    def rest(self, seconds, hand=None, **sample):
        X = self.hand if hand is None else hand
        for k in range(round(seconds / PERIOD)):
            self.tick(OperatorSample(self.time, X, **sample) if k % self.every == 0 else None)
        return self.steps[-1]


def turned(loop, since):
    """How far the tool has turned [rad] and moved [m] at most since an index of its commands."""
    X = loop.robot.forward(np.array([step.command.q for step in loop.steps[since:]]))
    angles = rotation.angle(X.quaternion, X.quaternion[0])
    return float(np.max(angles)), float(np.linalg.norm(X.translation - X.translation[0], axis=1).max())


def engaged(robot, rng, every, **options):
    """A loop in manual mode whose tool has come to rest with any orientation of the hand."""
    loop = Turned(robot, every, **options)
    loop.hand = Pose(rotation.multiply(rotation.exp(rng.normal(0.0, 0.1, 3)), loop.hand.quaternion), np.zeros(3))
    loop.rest(1.0)
    assert loop.controller.mode is Mode.MANUAL
    return loop


@pytest.mark.parametrize("every", [1, 6, 10])
def test_neither_a_lost_tracker_nor_axes_that_jump_turn_the_tool(robot, every):
    rng = np.random.default_rng(every)
    loop = engaged(robot, rng, every)
    since = len(loop.steps)
    loop.rest(0.3, Pose.identity())
    loop.rest(0.3)
    for degrees in (10.0, 45.0, 90.0, 180.0):
        turn = rotation.exp(np.radians(degrees) * rotation.rotate(rotation.random(rng), [1.0, 0.0, 0.0]))
        loop.hand = Pose(rotation.multiply(turn, loop.hand.quaternion), loop.hand.translation)
        loop.rest(0.4)
    angle, distance = turned(loop, since)
    assert angle < 2e-3
    assert distance < 1e-3


@pytest.mark.parametrize("pause", [0.02, 0.2, 2.0])
def test_a_hand_that_comes_back_turned_does_not_turn_the_tool(robot, pause):
    rng = np.random.default_rng(3)
    loop = engaged(robot, rng, 5)
    since = len(loop.steps)
    for _ in range(2):
        for _ in range(round(pause / PERIOD)):
            loop.tick(None)
        loop.hand = Pose(rotation.random(rng), rng.uniform(-0.3, 0.3, 3))
        loop.rest(0.6)
    angle, distance = turned(loop, since)
    assert angle < 2e-3
    assert distance < 1e-3


def test_engaging_again_turns_the_tool_to_the_hand_as_the_paper_says(robot):
    loop = engaged(robot, np.random.default_rng(4), 5)
    loop.hand = Pose(rotation.multiply(rotation.exp([0.0, 0.0, 0.7]), loop.hand.quaternion), loop.hand.translation)
    loop.rest(0.5)
    expected = rotation.multiply(R_WS, loop.hand.quaternion)
    assert rotation.angle(loop.tool().quaternion, expected) > 0.6
    loop.rest(0.1, clutch=False)
    loop.rest(2.5)
    assert rotation.angle(loop.tool().quaternion, expected) < 0.01


def test_recentring_ends_an_offset_too(robot):
    loop = engaged(robot, np.random.default_rng(5), 5)
    turn = rotation.exp([0.0, 0.0, 0.7])
    loop.hand = Pose(rotation.multiply(turn, loop.hand.quaternion), loop.hand.translation)
    loop.rest(0.5)
    loop.controller.recentre()
    loop.rest(1.5)
    expected = rotation.multiply(loop.controller.clutch.R_WS, loop.hand.quaternion)
    assert rotation.angle(loop.tool().quaternion, expected) < 0.01


@pytest.mark.parametrize("mode", [Mode.ADVANCE, Mode.CLOSE, Mode.LIFT, Mode.CARRY])
@pytest.mark.parametrize("clutch", [True, False])
def test_stepping_in_at_the_object_with_a_still_hand_does_not_turn_the_tool(robot, mode, clutch):
    candidates = scene(PLACE)
    loop = Turned(robot, candidates=candidates)
    loop.hand = Pose(rotation.multiply(rotation.exp([0.3, 0.2, 0.6]), loop.hand.quaternion), loop.hand.translation)
    loop.rest(0.6)
    loop.press()
    for _ in range(round(20.0 / PERIOD / 25)):
        if loop.controller.mode is mode:
            break
        loop.rest(0.05, clutch=clutch)
    assert loop.controller.mode is mode, modes(loop.steps)
    loop.rest(0.1, clutch=clutch)
    since = len(loop.steps)
    start = loop.controller.servo.reference[1]
    step = loop.tick(OperatorSample(loop.time, loop.hand, clutch, trigger=True))
    if step.mode is not Mode.MANUAL:
        # A press in the air puts down what the jaws hold: only the button cancels.
        button = optsc.operators.Button.CANCEL
        loop.tick(OperatorSample(loop.time, loop.hand, clutch, buttons=frozenset({button})))
    loop.rest(0.3, clutch=clutch)
    loop.rest(2.0)
    assert loop.controller.mode is Mode.MANUAL
    assert rotation.angle(loop.tool().quaternion, start) < 0.02
    assert turned(loop, since)[0] < 0.02


def test_stepping_in_on_the_way_to_the_object_fades_as_the_paper_says(robot):
    loop = Turned(robot, candidates=scene(PLACE))
    loop.rest(0.6)
    loop.press()
    loop.rest(0.5)
    assert loop.controller.mode is Mode.APPROACH
    loop.press()
    loop.rest(3.0)
    expected = rotation.multiply(R_WS, loop.hand.quaternion)
    assert rotation.angle(loop.tool().quaternion, expected) < 0.01


def test_a_change_of_the_mapping_keeps_the_offset_of_a_jump(robot):
    loop = engaged(robot, np.random.default_rng(6), 5)
    loop.hand = Pose(rotation.multiply(rotation.exp([0.0, 0.9, 0.0]), loop.hand.quaternion), loop.hand.translation)
    loop.rest(0.4)
    since = len(loop.steps)
    loop.controller.couple_by(ClutchSettings(R_WS=R_WS, scale=0.5), None)
    loop.rest(1.0)
    assert turned(loop, since)[0] < 2e-3
