"""From a camera to the controller: what it is given, when, and that a watched run replays."""

from types import SimpleNamespace

import numpy as np
import pytest

from optsc.control.modes import Event, Mode
from optsc.demo.episode import DemoSetup
from optsc.demo.observation import SceneObservation, perception_summary, true_names
from optsc.followers import IdealFollower
from optsc.geometry import PinholeCamera, Pose
from optsc.people.parameters import Intention
from optsc.people.simulated import R_WS_DEFAULT, Simulated
from optsc.perception import ObserverSettings, SceneEventKind
from optsc.records import RunInputs
from optsc.robot import load_robot
from optsc.sampling.settings import AntipodalSettings
from optsc.session import replay, run
from optsc.sim import Tabletop, object_model
from optsc.study.conditions import PAPER

SMALL = PinholeCamera.from_field_of_view(320, 240, 0.75)
FEW = ObserverSettings(grasps=AntipodalSettings.for_clouds(count=20))
PERIOD = 0.3
MOVES_AT = 0.45


class MovingObjects(IdealFollower):
    """An ideal arm among objects of which the can is moved by somebody, or taken away."""

    def __init__(self, world, at, there):
        super().__init__(world.robot, world.X_WO)
        self.at, self.there = at, there

    def objects(self):
        moved = {"can": self.there} if self.state().time >= self.at - 1e-9 else {}
        return {**super().objects(), **moved}


class Nobody:
    """An operator who does nothing."""

    def read(self, view):
        return None


@pytest.fixture(scope="module")
def world():
    X_WO = {"can": Pose.from_translation([0.48, 0.16, 0.0]), "box": Pose.from_translation([0.50, -0.16, 0.0])}
    return Tabletop(load_robot("panda"), {name: object_model(name) for name in X_WO}, X_WO)


@pytest.fixture(scope="module")
def observation(world):
    with SceneObservation(world, templates=("can", "box"), settings=FEW, camera=SMALL) as observation:
        yield observation


@pytest.fixture
def controller(world, observation):
    return DemoSetup(world, observation.first.library, 0).controller(PAPER)


def watched(controller, observation, follower, operator, duration, **options):
    during, scene = observation.watch(follower), observation.update(observation.first)
    done = run(
        controller,
        operator=operator,
        follower=follower,
        candidates=scene.candidates,
        clear=scene.clear,
        watch=during,
        watch_period=PERIOD,
        duration=duration,
        **options,
    )
    return done, during


def reaching():
    return Simulated(seed=0, plan=(Intention("can"),), R_WS=R_WS_DEFAULT)


THERE = Pose.from_translation([0.42, 0.05, 0.0])


def test_the_controller_is_given_a_motion_within_one_scene_tick(controller, observation, world):
    done, during = watched(controller, observation, MovingObjects(world, MOVES_AT, THERE), Nobody(), 0.7)
    (index,) = done.updates
    assert MOVES_AT <= done[index].time <= MOVES_AT + PERIOD
    assert [(event.kind, event.name) for _, event in during.events] == [(SceneEventKind.MOVED, "can")]
    given = done.updates[index].candidates
    can = np.array(given.object_names)[given.object_index] == "can"
    middle = np.median(given.X_WG[can].translation[:, :2], axis=0)
    assert np.linalg.norm(middle - THERE.translation[:2]) < 0.03


def test_a_scene_that_stands_still_is_never_reported_again(controller, observation, world):
    done, during = watched(controller, observation, IdealFollower(world.robot, world.X_WO), Nobody(), 0.7)
    assert len(during.seconds) == 2
    assert (dict(done.updates), during.events) == ({}, [])
    assert during.state.library is observation.first.library


def test_a_watched_run_replays_bit_for_bit(controller, observation, world):
    done, _ = watched(controller, observation, MovingObjects(world, MOVES_AT, THERE), reaching(), 2.0)
    assert len(done.updates) == 1
    inputs = RunInputs(
        {**done.about, "rate": done.rate},
        tuple(tick.sample for tick in done),
        tuple(tick.measured for tick in done),
        done.commands,
    )
    scene = observation.update(observation.first)
    another = DemoSetup(world, observation.first.library, 0).controller(PAPER)
    again = replay(another, inputs, scene.candidates, scene.clear, done.updates)
    assert again.commands.tobytes() == done.commands.tobytes()
    deaf = replay(another, inputs, scene.candidates, scene.clear)
    assert (
        deaf[-1].ranking.target("can").X_WG.translation.tolist()
        != again[-1].ranking.target("can").X_WG.translation.tolist()
    )


def reported_once(world, observation, mode, at):
    """Return a watch that says once, as soon as the robot is in a mode, that the can is somewhere else or nowhere."""

    def watch(time, measured):
        if reported or not modes or modes[-1] is not mode:
            return None
        reported.append(time)
        state = observation.first
        known = state.objects["can"]
        moved = None if at is None else known.moved_to(Pose.from_translation(at) @ known.X_WO)
        return observation.update(state.without("can") if moved is None else state.with_object(moved))

    reported, modes = [], []
    return watch, modes


@pytest.mark.parametrize(
    ("mode", "at", "words"),
    [
        (Mode.APPROACH, [0.03, 0.0, 0.0], "the can has moved by 30 mm"),
        (Mode.APPROACH, None, "the can is gone"),
        (Mode.ADVANCE, None, "the can is gone"),
        (Mode.APPROACH, [0.005, 0.0, 0.0], ""),
        (Mode.LIFT, None, ""),
    ],
)
def test_the_robot_does_not_drive_on_to_what_is_no_longer_there(controller, observation, world, mode, at, words):
    watch, modes = reported_once(world, observation, mode, at)
    scene = observation.update(observation.first)
    done = run(
        controller,
        operator=reaching(),
        follower=IdealFollower(world.robot, world.X_WO, scene.candidates),
        candidates=scene.candidates,
        clear=scene.clear,
        watch=watch,
        watch_period=0.05,
        duration=16.0,
        rate=250.0,
        on_tick=lambda tick: modes.append(tick.mode),
    )
    (index,) = done.updates
    step = done[index].step
    assert (step.event is Event.FAULT, step.reason) == ((True, words) if words else (False, step.reason))
    assert done[index + 1].mode is (Mode.HOLD if words else mode)


def test_what_was_seen_is_compared_with_the_truth(observation):
    assert true_names(observation) == {"can": "can", "box": "box"}
    during = SimpleNamespace(seconds=[0.1, 0.3], events=[(1.0, observation.events[0])])
    facts = perception_summary(observation, [during])
    assert facts["not_objects"] == []
    assert facts["looks"] == 2
    assert facts["events"][0]["news"] == "STORED"
    for name in ("can", "box"):
        (row,) = facts["objects"][name]
        assert row["template"] == name
        assert row["add_s_m"] < 0.005
        assert row["candidates"] == 20
        assert row["explanations"] == 1
        assert 0.7 < row["visible_fraction"] <= 1.0
