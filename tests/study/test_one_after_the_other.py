"""Sessions of several grasps: what was put down is observed again, and the next object is grasped."""

from itertools import pairwise

import numpy as np
import pytest

from optsc.control.approach import Approach
from optsc.control.modes import Mode
from optsc.followers import IdealFollower
from optsc.people import Intention, Simulated
from optsc.robot import load_robot
from optsc.selection import GraspSelector
from optsc.session import run
from optsc.sim import tabletop
from optsc.study.episode_setup import controller_with, true_scene
from optsc.study.libraries import library_of
from optsc.study.observed_objects import ObservedObjects
from optsc.testing.loop import assert_limits_hold

RATE = 100.0
NAMES = ("can", "box", "mug")


@pytest.fixture(scope="module")
def session():
    robot = load_robot("panda")
    world = tabletop(robot, objects=NAMES, seed=1)
    library = library_of(robot, tuple(world.objects.values()), None)
    scene = true_scene(world, library)
    controller = controller_with(GraspSelector(robot), Approach())
    x, y, _ = world.X_WO["can"].translation
    plan = [Intention("can", put_down=True, place=(x, y + 0.06)), Intention("box", put_down=True), Intention("mug")]
    follower = IdealFollower(robot, world.X_WO, scene.candidates)
    ticks = run(
        controller,
        operator=Simulated(1, plan),
        follower=follower,
        candidates=scene.candidates,
        clear=scene.clear,
        watch=ObservedObjects(world, library, follower),
        rate=RATE,
        duration=120.0,
        tasks=3,
    )
    return world, controller, follower, ticks


def test_three_objects_are_grasped_one_after_the_other(session):
    _, controller, _, ticks = session
    assert controller.state.tasks == 3
    names = [step.held.object_name for step in (tick.step for tick in ticks) if step.held is not None]
    assert [name for k, name in enumerate(names) if k == 0 or name != names[k - 1]] == list(NAMES)
    assert_limits_hold(controller.robot, [tick.step for tick in ticks], 1 / RATE)


def test_what_was_put_down_stands_at_the_height_where_it_stood_and_what_is_held_moves_with_the_tool(session):
    world, controller, follower, ticks = session
    objects = follower.objects()
    for name in NAMES[:2]:
        # The tool is as high as it was; a hand that has turned it by a degree or two has the object a little off.
        assert objects[name].translation[2] == pytest.approx(world.X_WO[name].translation[2], abs=8e-3)
    assert objects["mug"].translation[2] > 0.14
    assert controller.state.held.object_name == "mug"
    assert np.linalg.norm((objects["can"].translation - world.X_WO["can"].translation)[:2]) > 0.03
    # The jaws open only in a release, or where they hold nothing.
    steps = [tick.step for tick in ticks]
    for before, now in pairwise(steps):
        if now.opening > before.opening:
            assert before.held is None or now.mode in (Mode.PLACE, Mode.RELEASE)


def test_a_person_lets_go_and_takes_hold_again_where_the_arm_is_halted():
    robot = load_robot("panda")
    world = tabletop(robot, objects=("can",), seed=2)
    library = library_of(robot, tuple(world.objects.values()), None)
    scene = true_scene(world, library)
    controller = controller_with(GraspSelector(robot), Approach())
    halts = []

    def halt(tick):
        if not halts and tick.step.time > 0.8:
            halts.append(tick.step.time)
            controller.state = controller.state._replace(doubt="something was seen in the way")

    ticks = run(
        controller,
        operator=Simulated(3, [Intention("can")]),
        follower=IdealFollower(robot, world.X_WO, scene.candidates),
        candidates=scene.candidates,
        clear=scene.clear,
        rate=RATE,
        duration=40.0,
        on_tick=halt,
    )
    held = [tick for tick in ticks if tick.mode is Mode.HOLD and tick.step.time > 0.8]
    assert {tick.step.reason for tick in held} >= {"something was seen in the way"}
    assert len(held) / RATE < 2.0
    assert controller.finished
