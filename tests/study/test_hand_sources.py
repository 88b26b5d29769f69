"""Whose hand it is in a trial, and what a live one needs: the clock's pace, and stamps on the run's clock."""

import pytest

from optsc.errors import DamagedFile, InvalidValue, OptscError, UnknownName
from optsc.operators import Mailbox, Recorded
from optsc.people.simulated import Simulated
from optsc.study.participants.design import StudyDesign
from optsc.study.participants.hand_sources import TrialContext, device, hand_source
from optsc.study.scenes import random_scene

TRIAL = StudyDesign("x", ("manual",), practice=0, trials=1).blocks(1)[0].trials[0]
CONTEXT = TrialContext(TRIAL, random_scene("panda", 1, objects=2), by_hand=True)
RECORDING = "t,x,y,z,qw,qx,qy,qz\n0,0,0,0,1,0,0,0\n0.02,0,0,{z},1,0,0,0\n"


def test_a_kind_of_person_wants_the_scene_s_goal_and_is_the_same_under_every_condition():
    hand = hand_source("hasty")
    person = hand.operator(CONTEXT)
    assert isinstance(person, Simulated)
    assert person.plan[0].object == CONTEXT.scene.goal
    assert person.by_hand
    assert not hand.live


def test_a_recording_is_played_in_every_trial_or_one_for_each_from_a_folder(tmp_path):
    (tmp_path / "any.csv").write_text(RECORDING.format(z=1))
    (tmp_path / TRIAL.file_name("hand", "csv")).write_text(RECORDING.format(z=2))
    for text, z in ((tmp_path / "any.csv", 1.0), (tmp_path, 2.0)):
        operator = hand_source(str(text)).operator(CONTEXT)
        assert isinstance(operator, Recorded)
        assert operator.recording.X_SH.translation[1, 2] == z
    with pytest.raises(DamagedFile, match="subject_01_cond_01_run_02_hand"):
        hand_source(str(tmp_path)).operator(CONTEXT._replace(trial=TRIAL._replace(run=2)))


def test_a_function_in_a_file_makes_the_operator_of_a_trial(tmp_path):
    path = tmp_path / "my_device.py"
    path.write_text(
        "from optsc.operators import Mailbox\ndef hand(context):\n    return Mailbox() if context.by_hand else None\n"
    )
    hand = hand_source(f"{path}:hand")
    assert hand.live
    assert isinstance(hand.operator(CONTEXT), Mailbox)
    with pytest.raises(InvalidValue, match="operator"):
        hand.operator(CONTEXT._replace(by_hand=False))


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
        hand_source(text)
    assert isinstance(caught.value, OptscError)


def test_a_device_counts_as_live():
    assert device(lambda context: Mailbox()).live
