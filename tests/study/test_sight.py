"""From a camera to the controller: what it hears, when, and that a watched run can be repeated."""

from types import SimpleNamespace

import numpy as np
import pytest

from optsc.control.modes import Event, Mode
from optsc.demo.episode import PAPER, Setting, build_controller
from optsc.demo.seen import seen_facts, true_names
from optsc.demo.sight import Sight
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
def sight(world):
    with Sight(world, templates=("can", "box"), settings=FEW, camera=SMALL) as sight:
        yield sight


@pytest.fixture
def controller(world, sight):
    return build_controller(Setting(world, sight.first.library, 0), PAPER)


def watched(controller, sight, follower, operator, duration, **options):
    looks, scene = sight.watch(follower), sight.update(sight.first)
    done = run(
        controller,
        operator=operator,
        follower=follower,
        candidates=scene.candidates,
        clear=scene.clear,
        watch=looks,
        watch_period=PERIOD,
        duration=duration,
        **options,
    )
    return done, looks


def reaching():
    return Simulated(seed=0, plan=(Intention("can"),), R_WS=R_WS_DEFAULT)


THERE = Pose.from_translation([0.42, 0.05, 0.0])


def test_the_controller_hears_of_a_motion_within_one_scene_tick(controller, sight, world):
    done, looks = watched(controller, sight, MovingObjects(world, MOVES_AT, THERE), Nobody(), 0.7)
    (index,) = done.updates
    assert MOVES_AT <= done[index].time <= MOVES_AT + PERIOD
    assert [(event.kind, event.name) for _, event in looks.events] == [(SceneEventKind.MOVED, "can")]
    heard = done.updates[index].candidates
    can = np.array(heard.object_names)[heard.object_index] == "can"
    middle = np.median(heard.X_WG[can].translation[:, :2], axis=0)
    assert np.linalg.norm(middle - THERE.translation[:2]) < 0.03


def test_a_scene_that_stands_still_is_never_told_again(controller, sight, world):
    done, looks = watched(controller, sight, IdealFollower(world.robot, world.X_WO), Nobody(), 0.7)
    assert len(looks.seconds) == 2
    assert (dict(done.updates), looks.events) == ({}, [])
    assert looks.memory.library is sight.first.library


def test_a_watched_run_replays_bit_for_bit(controller, sight, world):
    done, _ = watched(controller, sight, MovingObjects(world, MOVES_AT, THERE), reaching(), 2.0)
    assert len(done.updates) == 1
    inputs = RunInputs(
        {**done.about, "rate": done.rate},
        tuple(tick.sample for tick in done),
        tuple(tick.measured for tick in done),
        done.commands,
    )
    scene = sight.update(sight.first)
    fresh = build_controller(Setting(world, sight.first.library, 0), PAPER)
    again = replay(fresh, inputs, scene.candidates, scene.clear, done.updates)
    assert again.commands.tobytes() == done.commands.tobytes()
    deaf = replay(fresh, inputs, scene.candidates, scene.clear)
    assert (
        deaf[-1].ranking.target("can").X_WG.translation.tolist()
        != again[-1].ranking.target("can").X_WG.translation.tolist()
    )


def told_once(world, sight, mode, at):
    """Return a watch that says once, as soon as the robot is in a mode, that the can is somewhere else or nowhere."""

    def look(time, measured):
        if told or not modes or modes[-1] is not mode:
            return None
        told.append(time)
        memory = sight.first
        known = memory.objects["can"]
        moved = None if at is None else known.at(Pose.from_translation(at) @ known.X_WO)
        return sight.update(memory.without("can") if moved is None else memory.with_object(moved))

    told, modes = [], []
    return look, modes


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
def test_the_robot_does_not_drive_on_to_what_is_no_longer_there(controller, sight, world, mode, at, words):
    look, modes = told_once(world, sight, mode, at)
    scene = sight.update(sight.first)
    done = run(
        controller,
        operator=reaching(),
        follower=IdealFollower(world.robot, world.X_WO),
        candidates=scene.candidates,
        clear=scene.clear,
        watch=look,
        watch_period=0.05,
        duration=16.0,
        rate=250.0,
        on_tick=lambda tick: modes.append(tick.mode),
    )
    (index,) = done.updates
    step = done[index].step
    assert (step.event is Event.FAULT, step.reason) == ((True, words) if words else (False, step.reason))
    assert done[index + 1].mode is (Mode.HOLD if words else mode)


def test_what_was_seen_is_compared_with_the_truth(sight):
    assert true_names(sight) == {"can": "can", "box": "box"}
    looks = SimpleNamespace(seconds=[0.1, 0.3], events=[(1.0, sight.events[0])])
    facts = seen_facts(sight, [looks])
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
