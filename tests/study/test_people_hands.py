"""Whose hand it is in a trial, and what a live one needs: the clock's pace, and stamps on the run's clock."""

import numpy as np
import pytest

from optsc.errors import DamagedFile, InvalidValue, OptscError, UnknownName
from optsc.followers import IdealFollower
from optsc.geometry import Pose
from optsc.operators import Mailbox, OperatorSample, OperatorView, Recorded
from optsc.people.simulated import Simulated
from optsc.robot import load_robot
from optsc.study.participants.design import StudyDesign
from optsc.study.participants.hands import Situation, device, hand_of
from optsc.study.participants.live import LARGEST_LAG, LiveHand, PacedFollower
from optsc.study.scenes import random_scene

TRIAL = StudyDesign("x", ("manual",), practice=0, trials=1).blocks(1)[0].trials[0]
SITUATION = Situation(TRIAL, random_scene("panda", 1, objects=2), by_hand=True)
RECORDING = "t,x,y,z,qw,qx,qy,qz\n0,0,0,0,1,0,0,0\n0.02,0,0,{z},1,0,0,0\n"


def view(time):
    return OperatorView(time, Pose.identity(), False, False, {})


def test_a_kind_of_person_wants_the_scene_s_goal_and_is_the_same_under_every_condition():
    hand = hand_of("hasty")
    person = hand.operator(SITUATION)
    assert isinstance(person, Simulated)
    assert person.plan[0].object == SITUATION.scene.goal
    assert person.by_hand
    assert not hand.live


def test_a_recording_is_played_in_every_trial_or_one_for_each_from_a_folder(tmp_path):
    (tmp_path / "any.csv").write_text(RECORDING.format(z=1))
    (tmp_path / TRIAL.file_name("hand", "csv")).write_text(RECORDING.format(z=2))
    for text, z in ((tmp_path / "any.csv", 1.0), (tmp_path, 2.0)):
        operator = hand_of(str(text)).operator(SITUATION)
        assert isinstance(operator, Recorded)
        assert operator.recording.X_SH.translation[1, 2] == z
    with pytest.raises(DamagedFile, match="subject_01_cond_01_run_02_hand"):
        hand_of(str(tmp_path)).operator(SITUATION._replace(trial=TRIAL._replace(run=2)))


def test_a_function_in_a_file_makes_the_operator_of_a_trial(tmp_path):
    path = tmp_path / "my_device.py"
    path.write_text(
        "from optsc.operators import Mailbox\n"
        "def hand(situation):\n    return Mailbox() if situation.by_hand else None\n"
    )
    hand = hand_of(f"{path}:hand")
    assert hand.live
    assert isinstance(hand.operator(SITUATION), Mailbox)
    with pytest.raises(InvalidValue, match="operator"):
        hand.operator(SITUATION._replace(by_hand=False))


@pytest.mark.parametrize(
    ("text", "error", "answer"),
    [
        ("sleepy", UnknownName, "typical"),
        ("missing.csv", DamagedFile, "no recorded hand"),
        ("missing.py:hand", DamagedFile, "cannot be loaded"),
        ("no_such_module:hand", DamagedFile, "cannot be loaded"),
        ("json:hand", UnknownName, "loads"),
    ],
)
def test_a_word_that_names_no_hand_is_answered(text, error, answer, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=answer) as caught:
        hand_of(text)
    assert isinstance(caught.value, OptscError)


def test_a_device_counts_as_live():
    assert device(lambda situation: Mailbox()).live


class Clock:
    def __init__(self):
        self.now, self.slept = 5.0, []

    def __call__(self):
        return self.now

    def sleep(self, seconds):
        self.slept.append(seconds)
        self.now += seconds


def test_a_paced_arm_keeps_to_the_clock_and_does_not_race_after_a_stall():
    robot, clock = load_robot("panda"), Clock()
    with PacedFollower(IdealFollower(robot), clock, clock.sleep) as arm:
        arm.reset(robot.home)

        def step():
            return arm.apply(robot.home, np.zeros(robot.n), 0.0, 0.01)

        for _ in range(3):
            step()
            clock.now += 0.004
        assert clock.slept == pytest.approx([0.01, 0.006, 0.006])
        clock.now += 0.02  # late by a little: it catches up
        for _ in range(3):
            step()
        assert clock.slept[3:] == pytest.approx([0.006])
        assert arm.lost == 0.0
        clock.now += 10 * LARGEST_LAG
        step()
        assert arm.lost == pytest.approx(10 * LARGEST_LAG - 0.01)
        step()
        assert clock.slept[4:] == pytest.approx([0.01])
        assert arm.state().time == pytest.approx(0.08)


def test_live_samples_get_the_run_s_time_and_never_go_back():
    box, clock = Mailbox(), Clock()
    hand = LiveHand(box, clock)
    assert hand.read(view(0.0)) is None

    def read(stamp, time):
        box.post(OperatorSample(stamp, Pose.identity()))
        return hand.read(view(time)).stamp

    assert read(4.98, 0.5) == pytest.approx(0.48)
    assert read(4.99, 0.49) == pytest.approx(0.48)  # the run stood still
    assert read(6.0, 0.6) == pytest.approx(0.6)  # stamped in the future
    assert np.isnan(read(float("nan"), 0.7))  # to be refused by the controller
    assert read(6.1, 0.8) == pytest.approx(0.8)
