"""Differences within participants: a person counts once, and is compared with himself in the same scenes."""

import math

import numpy as np
import pytest

from optsc.errors import InvalidValue, Mismatch, UnknownName
from optsc.study.participants.analysis import MEASURES, WORKLOAD, differences, participant_means, tidy
from optsc.study.participants.design import StudyDesign
from optsc.study.participants.plan import StudyPlan

PLAN = StudyPlan(StudyDesign("x", ("alternating", "manual"), trials=2, practice=1), participants=4)


def row(participant, condition, scene, time, *, success=True, practice=False, tlx=None):
    number = PLAN.design.conditions.index(condition) + 1
    answers = {} if tlx is None else {"tlx_raw": tlx, **dict.fromkeys(WORKLOAD, tlx)}
    trial = {"participant": participant, "condition": condition, "condition_number": number, "run": scene}
    measures = {**dict.fromkeys(MEASURES, 1.0), "grasp_s": time if success else None}
    measures.pop("tlx_raw")
    head = {**trial, "practice": practice, "scene_seed": scene, "study": "x", "plan": PLAN.key}
    return {**head, **measures, "success": success, **answers}


ROWS = [
    *(row(1, "alternating", scene, 5.0, tlx=20.0) for scene in (1, 2)),
    *(row(1, "manual", scene, 8.0, tlx=50.0) for scene in (1, 2)),
    row(2, "alternating", 3, 4.0),
    row(2, "alternating", 4, 0.0, success=False),
    row(2, "manual", 3, 5.0),
    row(2, "manual", 4, 100.0),
    row(2, "manual", 9, 1000.0, practice=True),
    row(3, "alternating", 5, 4.0),
]


def found(measure, rows=ROWS):
    return next(one.found for one in differences(tidy(PLAN, rows), "alternating") if one.measure == measure)


def test_the_participant_is_the_unit_and_scenes_are_compared_in_which_both_succeeded():
    time = found("grasp_s")
    assert time.pairs == 2
    assert time.mean.value == pytest.approx((3.0 + 1.0) / 2.0)
    assert (time.mean.low, time.mean.high) == pytest.approx((1.0, 3.0))
    assert time.more == 1.0


def test_success_and_workload_count_in_every_trial():
    assert found("success").mean.value == pytest.approx((0.0 + 0.5) / 2.0)
    workload = found("tlx_raw")
    assert workload.pairs == 1
    assert workload.mean.value == 30.0


def test_more_trials_of_a_person_do_not_make_more_of_him():
    more = [*ROWS, *(row(1, name, 10, t) for name, t in (("alternating", 5.0), ("manual", 8.0)))]
    assert found("grasp_s", more).mean == found("grasp_s").mean


def test_means_have_a_row_for_each_participant_and_condition_without_practice():
    means = participant_means(tidy(PLAN, ROWS))
    assert list(means[["participant", "condition", "trials"]].itertuples(index=False, name=None)) == [
        (1, "alternating", 2),
        (1, "manual", 2),
        (2, "alternating", 2),
        (2, "manual", 2),
        (3, "alternating", 1),
    ]
    by = means.set_index(["participant", "condition"])
    assert by["success"][2, "alternating"] == 0.5
    assert by["grasp_s"][2, "alternating"] == 4.0
    assert by["grasp_s"][2, "manual"] == pytest.approx(52.5)
    assert math.isnan(by["tlx_raw"][2, "manual"])


def test_the_place_is_that_in_the_participant_s_own_order():
    for line in tidy(PLAN, ROWS):
        assert PLAN.design.order(line["participant"])[line["place"] - 1] == line["condition"]


def test_what_is_not_of_the_plan_is_refused():
    with pytest.raises(InvalidValue, match="optsc study people run"):
        tidy(PLAN, [])
    with pytest.raises(Mismatch, match="subject 1"):
        tidy(PLAN, [{**ROWS[0], "plan": "another"}])
    with pytest.raises(InvalidValue, match="1 to 4"):
        tidy(PLAN, [row(5, "manual", 1, 1.0)])
    with pytest.raises(UnknownName, match="alternating"):
        differences(tidy(PLAN, ROWS), "automatic")


def test_the_same_seed_gives_the_same_intervals():
    one, other = (differences(tidy(PLAN, ROWS), "manual", seed=3) for _ in range(2))
    assert repr(one) == repr(other)
    assert np.isfinite(one[0].row()["mean"])
