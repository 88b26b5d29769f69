"""The loop of the control process, driven by a clock of the test: no process, no socket, no waiting."""

import pickle

import numpy as np
import pytest

from optsc.control.modes import Mode
from optsc.geometry import Pose
from optsc.live.hand_mailbox import TRIGGER, HandReading, HandWriter
from optsc.live.layout import SharedParts, text_of
from optsc.live.loop import ControlLoop
from optsc.live.observer import parts_of, solved
from optsc.live.recorder import RunWriter
from optsc.live.rerun import rerun
from optsc.live.run_folder import RunFolder
from optsc.live.scene import LiveScene, SceneChoice
from optsc.live.settings_block import LiveSettings
from optsc.live.state_rows import MODES

PERIOD = 0.002


class Clock:
    """A clock that goes on only by sleeping."""

    def __init__(self):
        self.time = 100.0

    def __call__(self):
        return self.time

    def sleep(self, duration):
        self.time += duration


@pytest.fixture(scope="module")
def scene():
    return LiveScene(SceneChoice(follower="ideal"))


class Answering:
    """An observer in this process, that answers at once."""

    def __init__(self, scene):
        self.scene, self.selector, self.answers = scene, scene.controller(LiveSettings()).selector, []

    def send(self, observation):
        self.answers.append(pickle.dumps(parts_of(solved(self.scene, self.selector, observation).table)))

    def poll(self, timeout):
        return bool(self.answers)

    def recv(self):
        return pickle.loads(self.answers.pop())


class Rig:
    """A loop, and a hand that writes into its mailbox every eight ticks as a page does."""

    def __init__(self, scene):
        self.clock = Clock()
        self.parts = SharedParts(scene.sizes)
        self.loop = ControlLoop(scene, self.parts, Answering(scene), self.clock, self.clock.sleep)
        self.writer = HandWriter(self.parts.hand)
        self.state = np.zeros(self.parts.state.size)
        self.p, self.q = np.zeros(3), (1.0, 0.0, 0.0, 0.0)
        self.engaged, self.ticks = False, 0
        self.tools, self.robot = [], scene.robot

    def post(self, *pressed):
        self.writer.post(HandReading(self.clock(), self.p, self.q, self.engaged, pressed))

    def go(self, duration, velocity=(0.0, 0.0, 0.0), silent=False):
        for _ in range(round(duration / PERIOD)):
            self.p = self.p + PERIOD * np.asarray(velocity)
            if self.ticks % 8 == 0 and not silent:
                self.post()
            self.loop.tick()
            self.ticks += 1
            self.tools.append(self.robot.forward(self.loop.controller.servo.guard.q).translation)

    def of(self, name):
        assert self.parts.state.read(self.state)
        return self.state[self.parts.state_columns[name]]

    @property
    def mode(self):
        return MODES[int(self.of("mode")[0])]

    @property
    def reason(self):
        return text_of(self.of("reason"))


def until(rig, *modes):
    for _ in range(600):
        rig.go(0.04)
        if rig.mode in modes:
            return
    raise AssertionError(f"never came to {modes}, but is in {rig.mode}: {rig.reason}")


@pytest.fixture
def rig(scene):
    made = Rig(scene)
    yield made
    made.parts.segment.close()


def test_a_hand_that_takes_hold_anywhere_leads_the_tool_from_where_it_is(rig):
    rig.p = np.array([3.0, -2.0, 1.0])
    rig.go(0.1)
    before = rig.of("target")[:3].copy()
    rig.engaged = True
    rig.go(1.0, velocity=(0.05, 0.0, -0.05))
    rig.go(0.5)
    assert rig.mode is Mode.MANUAL
    np.testing.assert_allclose(rig.of("target")[:3] - before, [0.05, 0.0, -0.05], atol=2e-3)


def test_letting_go_rests_and_taking_hold_elsewhere_does_not_jump(rig):
    rig.engaged = True
    rig.go(0.5, velocity=(0.1, 0.0, 0.0))
    rig.engaged = False
    rig.go(0.5, velocity=(0.3, 0.3, 0.0))
    at_rest = rig.of("target")[:3].copy()
    rig.engaged = True
    rig.go(0.5)
    np.testing.assert_allclose(rig.of("target")[:3], at_rest, atol=1e-6)


def test_the_trigger_leads_through_the_approach_to_a_lifted_object(rig):
    rig.engaged = True
    rig.go(0.6, velocity=(0.1, 0.0, -0.2))
    rig.post(TRIGGER)
    modes = []
    for _ in range(600):
        rig.go(0.04)
        modes.append(rig.mode)
        if rig.mode is Mode.CARRY:
            break
    assert list(dict.fromkeys(modes))[-5:] == [Mode.APPROACH, Mode.ADVANCE, Mode.CLOSE, Mode.LIFT, Mode.CARRY]


def test_grasps_follow_an_object_that_was_let_go_of_elsewhere_and_the_run_can_be_run_again(rig, scene, tmp_path):
    rig.engaged = True
    rig.go(0.6, velocity=(0.1, 0.0, -0.2))
    rig.post(TRIGGER)
    until(rig, Mode.CARRY)
    rig.engaged = False
    rig.go(0.02)
    rig.engaged = True
    rig.go(1.0, velocity=(0.0, 0.06, 0.0))
    assert rig.mode is Mode.MANUAL
    rig.post("RELEASE")
    rig.go(0.1)
    for _ in range(150):
        rig.go(0.04)
        if rig.of("held")[0] == -1.0 and rig.mode in (Mode.MANUAL, Mode.HOLD):
            break
    rig.go(0.5)
    away = np.linalg.norm(rig.of("objects").reshape(-1, 7)[:, :3] - scene.poses[:, :3], axis=1)
    k = int(np.argmax(away))
    name = scene.names[k]
    moved = rig.of("objects").reshape(-1, 7)[k].copy()
    assert np.linalg.norm(moved[:3] - scene.poses[k, :3]) > 0.04
    candidates = rig.loop.controller.state.choice.candidates
    i = int(np.flatnonzero(candidates.object_index == candidates.object_names.index(name))[0])
    X_OG = Pose(moved[3:], moved[:3]).inverse() @ candidates.X_WG[i]
    grasp = scene.library[name].X_OG[int(candidates.grasp_index[i])]
    np.testing.assert_allclose(X_OG.translation, grasp.translation, atol=5e-3)
    rows, _ = rig.parts.ticks.drain()
    assert rows[-1, rig.parts.tick_columns.at("observations")] >= 1.0
    writer = RunWriter(tmp_path, scene, rig.parts)
    writer.ticks(rows)
    writer.close()
    assert rerun(RunFolder(tmp_path)) == (len(rows), 0, 0)


def test_taking_hold_in_mid_approach_gives_control_back_and_leads_on_without_a_jump(rig):
    rig.engaged = True
    rig.go(0.6, velocity=(0.1, 0.0, -0.2))
    rig.post(TRIGGER)
    rig.engaged = False
    rig.go(0.8)
    assert rig.mode is Mode.APPROACH
    rig.engaged = True
    rig.p = np.array([-1.0, 2.0, 0.4])
    start = len(rig.tools)
    rig.go(0.5, velocity=(0.0, 0.1, 0.0))
    assert rig.mode is Mode.MANUAL
    tools = np.array(rig.tools[start - 100 :])
    acceleration = np.diff(tools, 2, axis=0) / PERIOD**2
    assert np.linalg.norm(acceleration, axis=1).max() < 5.0
    assert np.linalg.norm(np.diff(tools, axis=0), axis=1).max() < 0.2 * PERIOD
    assert tools[-1][1] > tools[100][1] + 0.02


def test_a_page_that_falls_silent_stops_the_approach_and_says_why(rig):
    rig.engaged = True
    rig.go(0.6, velocity=(0.1, 0.0, -0.2))
    rig.post(TRIGGER)
    rig.go(0.5)
    assert rig.mode is Mode.APPROACH
    rig.go(0.12, silent=True)
    assert rig.mode is Mode.HOLD
    rig.engaged = False
    rig.go(0.5)
    assert rig.mode is Mode.HOLD
    rig.engaged = True
    rig.go(0.1)
    assert rig.mode is Mode.MANUAL


def test_settings_change_the_ranking_and_the_scale_while_the_loop_runs(rig):
    chosen = set()
    for settings in (
        LiveSettings(),
        LiveSettings(rule="weighted sum", orientation=10.0, position=0.0, manipulability=0.0, travel=0.0),
        LiveSettings(rule="weighted sum", orientation=0.0, position=0.0, manipulability=10.0, travel=0.0),
        LiveSettings(rule="weighted sum", orientation=0.0, position=10.0, manipulability=0.0, travel=0.0),
    ):
        rig.parts.settings.write(settings.row())
        rig.go(0.3)
        chosen.add(tuple(rig.of("selected")))
    assert len(chosen) >= 3
    rig.parts.settings.write(LiveSettings(scale=0.5).row())
    rig.engaged = True
    rig.go(0.2)
    before = rig.of("target")[:3].copy()
    rig.go(0.5, velocity=(0.1, 0.0, 0.0))
    rig.go(0.5)
    assert rig.of("target")[0] - before[0] == pytest.approx(0.025, abs=2e-3)


def test_beginning_again_brings_the_arm_home_and_keeps_the_scale(rig, scene):
    rig.parts.settings.write(LiveSettings(scale=0.5).row())
    rig.engaged = True
    rig.go(0.5, velocity=(0.2, 0.0, 0.0))
    rig.parts.settings.write(LiveSettings(scale=0.5, restarts=1).row())
    rig.engaged = False
    rig.go(0.1)
    home = scene.robot.forward(scene.robot.home)
    np.testing.assert_allclose(rig.of("target")[:3], home.translation, atol=1e-6)
    assert rig.loop.controller.clutch.scale == 0.5
    before = tuple(rig.of("selected"))
    rule = LiveSettings(rule="weighted sum", orientation=0.0, position=0.0, travel=0.0, restarts=1)
    rig.parts.settings.write(rule.row())
    rig.go(0.3)
    assert tuple(rig.of("selected")) != before


def test_what_the_page_is_shown_is_what_the_controller_holds(rig, scene):
    rig.engaged = True
    rig.go(0.4, velocity=(0.1, 0.0, -0.2))
    controller, ranking = rig.loop.controller, rig.loop.controller.ranking
    best = scene.names[int(rig.of("intended")[0])]
    assert best == ranking.best
    ranks = rig.of("ranks")
    owner = ranking.decision.candidates.object_index
    for k, name in enumerate(scene.names):
        mine = np.flatnonzero(owner == controller.state.choice.candidates.object_names.index(name))
        assert mine[np.nanargmin(ranks[mine])] == rig.of("selected")[k]
        shown = rig.of("shown").reshape(-1, 7)[k]
        assert Pose(shown[3:], shown[:3]).almost_equal(ranking.target(name).X_WG, 1e-12)
    assert np.nanmax(ranks) <= 1.0


def test_every_tick_reaches_the_ring_once_and_in_order(rig):
    rig.go(1.0)
    rows, lost = rig.parts.ticks.drain()
    ticks = rows[:, rig.parts.tick_columns.at("tick")]
    assert lost == 0
    assert ticks.tolist() == list(range(1, 501))
