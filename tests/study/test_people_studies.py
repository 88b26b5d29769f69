"""Studies with people: balanced orders, paired scenes, answers that are kept, sessions that go on where they were."""

import json
from collections import Counter
from itertools import pairwise

import numpy as np
import pytest

import optsc
from optsc.errors import DamagedFile, InvalidValue
from optsc.geometry import Pose
from optsc.operators import OperatorSample
from optsc.robot import load_robot
from optsc.study.participants.design import StudyDesign, williams_design
from optsc.study.participants.participant_session import ParticipantSession, TrialResult, collect
from optsc.study.participants.workload import SCALES, Workload, ask_workload

DESIGN = StudyDesign("pilot", ("paper", "manual", "linear blending"), trials=3, practice=1, time_limit=0.05, seed=4)
CALM = Workload.of(mental=10, physical=20, temporal=30, performance=40, effort=50, frustration=60)


@pytest.mark.parametrize("count", range(1, 9))
def test_every_condition_stands_everywhere_and_follows_every_other_equally_often(count):
    rows = williams_design(count)
    assert len(rows) == (count if count % 2 == 0 or count == 1 else 2 * count)
    for place in range(count):
        assert set(Counter(row[place] for row in rows).values()) == {len(rows) // count}
    followed = Counter(pair for row in rows for pair in pairwise(row))
    if count > 1:
        assert len(followed) == count * (count - 1)
        assert len(set(followed.values())) == 1


def test_the_square_for_four_is_the_one_in_the_books():
    # 0 1 n-1 2 and its shifts.
    assert williams_design(4) == ((0, 1, 3, 2), (1, 2, 0, 3), (2, 3, 1, 0), (3, 0, 2, 1))


def test_participants_take_turns_through_the_orders():
    orders = [DESIGN.order(participant) for participant in range(1, 13)]
    assert DESIGN.group == 6
    assert orders[:6] == orders[6:]
    assert len(set(orders)) == 6


def test_the_scenes_that_count_are_the_same_under_every_condition_and_differ_between_people():
    for participant in (1, 2):
        blocks = DESIGN.blocks(participant)
        scenes = [[trial.scene_seed for trial in block.trials if not trial.practice] for block in blocks]
        assert {tuple(sorted(row)) for row in scenes} == {tuple(sorted(scenes[0]))}
        assert len({tuple(row) for row in scenes}) > 1
        practised = [trial.scene_seed for block in blocks for trial in block.trials if trial.practice]
        assert len(set(practised)) == 3
        assert not set(practised) & set(scenes[0])
    first, second = (DESIGN.blocks(p)[0].trials[1].scene_seed for p in (1, 2))
    assert first != second
    assert DESIGN.blocks(1) == DESIGN.blocks(1)


def test_practice_comes_first_and_files_are_named_by_the_pattern():
    trials = DESIGN.blocks(7)[1].trials
    assert [trial.practice for trial in trials] == [True, False, False, False]
    number = DESIGN.conditions.index(DESIGN.order(7)[1]) + 1
    assert trials[2].file_name("run", "npz") == f"subject_07_cond_{number:02d}_run_03_run.npz"


class Still:
    def read(self, view):
        return OperatorSample(view.time, Pose.from_quaternion([0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0]))


def carried_out(trial, time_limit):
    robot = load_robot("panda")
    controller = optsc.SharedController(robot, optsc.GraspSelector(robot))
    run = optsc.run(controller, operator=Still(), follower=optsc.IdealFollower(robot), duration=time_limit)
    return TrialResult(run, success=trial.run % 2 == 0, measures={"time_s": len(run) / run.rate})


def test_a_sitting_that_is_interrupted_goes_on_with_the_trial_that_was_lost(tmp_path):
    done = []

    def breaks_down(trial, time_limit):
        if len(done) == 5:
            raise KeyboardInterrupt
        done.append(trial)
        return carried_out(trial, time_limit)

    with pytest.raises(KeyboardInterrupt):
        ParticipantSession(DESIGN, 2, tmp_path).run_remaining(breaks_down, lambda block: CALM, say=lambda text: None)
    again = ParticipantSession(StudyDesign.load(tmp_path / "design.json"), 2, tmp_path)
    assert len(again.remaining) == 7
    assert not again.finished
    lost = again.remaining[0]
    rest = []

    def recorded(trial, time_limit):
        rest.append(trial)
        return carried_out(trial, time_limit)

    again.run_remaining(recorded, lambda block: CALM, say=lambda text: None)
    assert rest[0] == lost
    assert done + rest == [trial for block in DESIGN.blocks(2) for trial in block.trials]
    assert again.finished
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    again.run_remaining(breaks_down, lambda block: CALM)
    assert before == {path: path.read_bytes() for path in tmp_path.iterdir()}


def test_everything_that_was_kept_is_collected_in_one_table(tmp_path):
    for participant in (1, 2):
        ParticipantSession(DESIGN, participant, tmp_path).run_remaining(
            carried_out, lambda block: CALM, say=lambda text: None
        )
    rows = collect(tmp_path)
    assert len(rows) == 2 * 3 * 4
    assert {row["condition"] for row in rows} == set(DESIGN.conditions)
    assert all(row["tlx_raw"] == CALM.raw and row["time_s"] == pytest.approx(0.05, abs=0.003) for row in rows)
    assert sum(row["practice"] for row in rows) == 6
    (tmp_path / "subject_01_cond_01_run_01_measures.json").write_text("{}")
    with pytest.raises(DamagedFile, match="measures"):
        collect(tmp_path)


def test_another_design_in_the_same_directory_is_refused(tmp_path):
    ParticipantSession(DESIGN, 1, tmp_path)
    with pytest.raises(InvalidValue, match="design"):
        ParticipantSession(StudyDesign("pilot", ("paper", "manual")), 1, tmp_path)


def test_the_raw_score_is_the_mean_of_six():
    assert CALM.raw == 35.0
    assert tuple(SCALES) == Workload._fields


def test_a_person_is_asked_again_until_the_answer_is_a_number_in_range():
    answers = iter(["ten", "101", "10", "nan", "20", "30", "40", "50", "60"])
    heard = []
    assert ask_workload(lambda question: next(answers), heard.append) == CALM
    assert len(heard) == 3


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: StudyDesign("x", ()),
        lambda: StudyDesign("x", ("a", "a")),
        lambda: StudyDesign("x", ("a",), trials=0),
        lambda: StudyDesign("x", ("a",), time_limit=np.nan),
        lambda: DESIGN.order(0),
        lambda: williams_design(0),
        lambda: Workload.of(mental=1.0),
        lambda: Workload.of(**{**CALM._asdict(), "effort": 101.0}),
    ],
)
def test_what_makes_no_sense_is_refused(wrong):
    with pytest.raises(InvalidValue):
        wrong()


@pytest.mark.parametrize("text", ["", "[]", json.dumps({"name": "x"}), json.dumps({"name": "x", "colour": 1})])
def test_a_file_that_is_no_design_is_refused(tmp_path, text):
    (tmp_path / "design.json").write_text(text)
    with pytest.raises(DamagedFile, match="design"):
        StudyDesign.load(tmp_path / "design.json")
