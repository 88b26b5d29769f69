"""The loop: tick by tick or at once, from the beginning or from a snapshot, it gives the same bytes."""

import copy

import numpy as np
import pytest

from optsc import session
from optsc.errors import InvalidValue
from optsc.followers import IdealFollower, RecordedFollower
from optsc.records import RunInputs, SceneUpdate
from optsc.robot import load_robot
from optsc.session import Session
from optsc.testing.loop import PLACES, StraightOperator, controller, scene

DURATION = 3.0


@pytest.fixture(scope="module")
def robot():
    return load_robot("panda")


def parts(robot):
    operator = StraightOperator(np.array(PLACES["middle"]) + [0, 0, 0.25], near=(0.03, 0.3))
    return {"operator": operator, "follower": IdealFollower(robot), "candidates": scene()}


def run(robot, **options):
    return session.run(controller(robot), duration=DURATION, **parts(robot), **options)


@pytest.fixture(scope="module")
def whole(robot):
    found = run(robot)
    assert {mode.automatic for mode in found.modes} == {True, False}
    return found


def commands_of(ticks):
    return [(t.mode, t.step.command.q.tobytes(), t.step.command.a.tobytes(), t.step.opening) for t in ticks]


def test_tick_by_tick_it_is_the_run(robot, whole):
    loop = Session.start(controller(robot), **parts(robot))
    ticks = [loop.tick() if k % 2 else loop.advance(loop.read()) for k in range(len(whole))]
    assert commands_of(ticks) == commands_of(whole)
    assert loop.ticks == len(whole)
    assert loop.step is ticks[-1].step
    np.testing.assert_array_equal(loop.measured.q, ticks[-1].step.command.q)


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_it_goes_on_from_a_snapshot_in_a_new_session(robot, whole, share):
    decides = controller(robot)
    loop = Session.start(decides, **parts(robot))
    count = int(share * len(whole))
    for _ in range(count):
        loop.tick()
    snapshot, measured, step = decides.snapshot(), loop.measured, loop.step
    operator = copy.deepcopy(loop.operator)
    for _ in range(20):
        loop.tick()
    decides.restore(snapshot)
    follower = IdealFollower(robot).at(measured)
    forked = Session(decides, operator=operator, follower=follower, step=step)
    ticks = [forked.tick() for _ in range(len(whole) - count)]
    assert commands_of(ticks) == commands_of(whole.ticks[count:])


def test_without_keeping_the_ticks_go_to_the_sink_alone(robot, whole):
    ticks = []
    assert len(run(robot, keep=False, on_tick=ticks.append)) == 0
    assert commands_of(ticks) == commands_of(whole)


def test_the_scene_is_observed_once_a_period_and_replayed_with_its_updates(robot):
    times = []

    def watch(time, measured):
        times.append(time)
        return SceneUpdate(scene(count=6)) if len(times) == 3 else None

    seen = run(robot, watch=watch, watch_period=0.25)
    np.testing.assert_allclose(times, 0.25 * np.arange(1, len(times) + 1), atol=1e-9)
    assert list(seen.updates) == [375]
    inputs = RunInputs(
        {"rate": seen.rate, **seen.about},
        tuple(tick.sample for tick in seen),
        tuple(tick.measured for tick in seen),
        seen.commands,
    )
    again = session.replay(controller(robot), inputs, scene(), updates=seen.updates)
    assert commands_of(again) == commands_of(seen)
    with pytest.raises(InvalidValue, match="watch"):
        run(robot, watch_period=0.0)


def test_a_recorded_follower_is_where_it_was_and_cannot_be_put_elsewhere(robot, whole):
    follower = RecordedFollower([tick.measured for tick in whole][:3])
    states = [follower.apply(robot.home, robot.home, 0.0, 0.002) for _ in range(4)]
    assert [state.time for state in states] == [whole[k].measured.time for k in (1, 2, 2, 2)]
    assert follower.reset(robot.home) is whole[0].measured
    with pytest.raises(InvalidValue):
        follower.at(whole[0].measured)
