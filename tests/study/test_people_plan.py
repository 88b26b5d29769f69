"""The plan of a study with people: a file that says what everybody does, and that only grows."""

import json
from dataclasses import replace

import pytest

from optsc.errors import DamagedFile, InvalidValue, UnknownName
from optsc.study.participants.design import StudyDesign
from optsc.study.participants.plan import StudyPlan

DESIGN = StudyDesign("pilot", ("alternating", "manual", "automatic"), trials=2, practice=1, seed=4)
PLAN = StudyPlan(DESIGN, participants=2, objects=2, level="random")


def test_a_plan_is_read_back_and_lists_every_trial(tmp_path):
    path = PLAN.save(tmp_path)
    assert StudyPlan.load(tmp_path) == PLAN
    sittings = json.loads(path.read_text())["sittings"]
    listed = [
        (sitting["participant"], block["condition"], trial["run"], trial["practice"], trial["scene_seed"])
        for sitting in sittings
        for block in sitting["blocks"]
        for trial in block["trials"]
    ]
    assert listed == [
        (t.participant, t.condition, t.run, t.practice, t.scene_seed)
        for participant in (1, 2)
        for block in DESIGN.blocks(participant)
        for t in block.trials
    ]


def test_a_plan_may_gain_participants_and_nothing_else(tmp_path):
    PLAN.save(tmp_path)
    more = replace(PLAN, participants=6)
    more.save(tmp_path)
    more.save(tmp_path)
    assert StudyPlan.load(tmp_path) == more
    assert more.key == PLAN.key
    for other in (PLAN, replace(PLAN, level="hard"), replace(PLAN, design=replace(DESIGN, trials=3))):
        with pytest.raises(InvalidValue, match="another folder"):
            other.save(tmp_path)
    assert StudyPlan.load(tmp_path) == more


def test_the_key_of_a_plan_tells_apart_what_makes_trials_differ():
    others = [replace(PLAN, rate=500.0), replace(PLAN, robot="ur5"), replace(PLAN, follower="pybullet")]
    others.append(replace(PLAN, design=replace(DESIGN, time_limit=30.0)))
    assert len({PLAN.key, *(other.key for other in others)}) == 5


@pytest.mark.parametrize(
    ("old", "new", "answer"),
    [
        ('"trials": 2', '"trials": 3', "changed by hand"),
        ('"run": 1, "practice": true', '"run": 1, "practice": false', "changed by hand"),
        ('"format": 1', '"format": 9', "format 9"),
        ('"participants": 2', '"participants": "two"', "participants"),
        ('"robot"', '"robots"', "no plan"),
        ("{", "", "no plan"),
    ],
)
def test_a_plan_that_was_changed_by_hand_is_refused(tmp_path, old, new, answer):
    path = PLAN.save(tmp_path)
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises((DamagedFile, InvalidValue), match=answer):
        StudyPlan.load(tmp_path)


def test_a_folder_without_a_plan_says_how_to_make_one(tmp_path):
    with pytest.raises(DamagedFile, match="optsc study people plan"):
        StudyPlan.load(tmp_path)


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"participants": 0}, InvalidValue),
        ({"participants": 2.0}, InvalidValue),
        ({"objects": 99}, InvalidValue),
        ({"rate": 0.0}, InvalidValue),
        ({"robot": "pandora"}, UnknownName),
        ({"level": "cosy"}, UnknownName),
        ({"follower": "sheep"}, UnknownName),
        ({"design": StudyDesign("x", ("telepathy",))}, UnknownName),
    ],
)
def test_what_cannot_be_carried_out_is_not_planned(changes, error):
    with pytest.raises(error):
        replace(PLAN, **changes)


@pytest.mark.parametrize("changes", [{"conditions": "manual"}, {"trials": 2.5}, {"seed": "one"}])
def test_a_design_takes_whole_numbers_and_lists_of_names(changes):
    with pytest.raises(InvalidValue):
        replace(DESIGN, **changes)


def test_nobody_sits_who_is_not_planned(tmp_path):
    for participant in (0, 3):
        with pytest.raises(InvalidValue, match="1 to 2"):
            PLAN.session(participant, tmp_path)


def test_a_trial_has_the_same_scene_under_every_condition():
    first, second = ({t.scene_seed: t for t in DESIGN.blocks(1)[k].trials if not t.practice} for k in (0, 1))
    seed = min(first)
    assert PLAN.scene(first[seed]) == PLAN.scene(second[seed])
    assert len(PLAN.scene(first[seed]).objects) == 2
