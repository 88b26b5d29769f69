"""Kinds of people differ as they are said to, and whoever grasps by hand brings the tool to the grasp that is shown."""

import numpy as np
import pytest

from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import Pose, rotation
from optsc.operators.sample import OperatorView
from optsc.people.parameters import TYPES, HumanParameters, Intention, operator_type
from optsc.people.simulated import R_WS_DEFAULT, Simulated

START = Pose.from_quaternion([0.0, 1.0, 0.0, 0.0], [0.35, 0.0, 0.45])
OBJECTS = {
    "box": Pose.from_translation([0.4, -0.3, 0.0]),
    "can": Pose.from_translation([0.5, 0.25, 0.0]),
    "mug": Pose.from_translation([0.55, -0.1, 0.0]),
}
GRASPS = {name: Pose.from_quaternion([0.0, 1.0, 0.0, 0.0], X.translation + [0, 0, 0.05]) for name, X in OBJECTS.items()}


class Scene:
    """A tool that follows the hand at once in the paper's mapping, and a robot that goes where it is sent."""

    def __init__(self, operator, *, robot_goes_for=None, begins_at=np.inf, assistance=(0.0, 0.0, 0.0)):
        self.operator, self.goes_for, self.begins_at = operator, robot_goes_for, begins_at
        self.assistance = np.asarray(assistance)
        self.presses, self.tools, self.targets = [], [], []

    def play(self, duration, rate=90.0):
        X, automatic, before, origin = START, False, False, None
        samples = []
        for tick in range(round(duration * rate)):
            time = tick / rate
            if time >= self.begins_at and not self.presses:
                automatic = True
            target = self.goes_for if automatic else None
            view = OperatorView(time, X, automatic, False, OBJECTS, GRASPS, target)
            sample = self.operator.read(view)
            samples.append(sample)
            if sample.trigger and not before:
                self.presses.append(time)
                self.tools.append(X)
                automatic = not automatic
                origin = None
            before = sample.trigger
            if automatic or origin is None:
                origin = (X.translation, sample.X_SH.translation)
            if not automatic:
                moved = rotation.rotate(R_WS_DEFAULT, sample.X_SH.translation - origin[1])
                self.drift = getattr(self, "drift", np.zeros(3)) + self.assistance / rate
                X = Pose(rotation.multiply(R_WS_DEFAULT, sample.X_SH.quaternion), origin[0] + moved + self.drift)
        self.X_SH = Pose.stack([sample.X_SH for sample in samples])
        return self


def test_who_grasps_by_hand_closes_the_jaws_at_the_grasp_that_is_shown():
    for seed in range(4):
        scene = Scene(Simulated(seed, [Intention("can")], by_hand=True)).play(14.0)
        human = HumanParameters()
        assert scene.presses
        off = scene.tools[0].translation - GRASPS["can"].translation
        # What trembles and drifts after the last observation comes on top of the tolerance.
        assert np.linalg.norm(off) <= human.grasp_tolerance[0] + 0.008
        assert rotation.angle(scene.tools[0].quaternion, GRASPS["can"].quaternion) <= human.grasp_tolerance[1] + 0.05


def test_who_grasps_by_hand_goes_by_way_of_the_pregrasp():
    quiet = HumanParameters(motor_noise=0.0, drift=0.0, tremor=0.0, tracker_noise=0.0)
    operator = Simulated(1, [Intention("can")], human=quiet, by_hand=True)
    scene = Scene(operator)
    seen = []
    read = operator.read

    def watched(view):
        seen.append(view.X_WT.translation)
        return read(view)

    operator.read = watched
    scene.play(14.0)
    pregrasp = GRASPS["can"].translation + [0.0, 0.0, quiet.standoff]
    assert np.linalg.norm(np.array(seen) - pregrasp, axis=1).min() <= quiet.position_tolerance


def test_a_tool_that_is_helped_along_is_led_to_the_grasp_all_the_same():
    scene = Scene(Simulated(2, [Intention("can")], by_hand=True), assistance=[0.0, 0.002, -0.002]).play(16.0)
    assert np.linalg.norm(scene.tools[0].translation - GRASPS["can"].translation) < 0.02


def test_the_robot_is_left_alone_when_it_begins_by_itself_for_the_right_object():
    scene = Scene(Simulated(0, [Intention("can")]), robot_goes_for="can", begins_at=0.5).play(4.0)
    assert scene.presses == []


@pytest.mark.parametrize("begins_at", [0.5, np.inf])
def test_a_robot_that_goes_for_another_object_is_stopped_and_shown_the_right_one(begins_at):
    scene = Scene(Simulated(0, [Intention("can")]), robot_goes_for="mug", begins_at=begins_at)
    scene.play(12.0)
    first = begins_at if begins_at < np.inf else scene.presses[0]
    taken_over = scene.presses[0] if begins_at < np.inf else scene.presses[1]
    assert 0.0 < taken_over - first <= HumanParameters().reaction + HumanParameters().press + 0.05
    scene.goes_for = "can"
    # It is again the can that is shown, not the next thing on a plan.
    last = scene.tools[-1]
    assert np.linalg.norm(last.translation[:2] - OBJECTS["can"].translation[:2]) < 0.25


def test_the_hand_trembles_alike_whatever_the_person_decides():
    rest = HumanParameters(initial_rest=100.0)
    a = Scene(Simulated(5, [Intention("can")], human=rest)).play(1.0).X_SH.translation
    b = Scene(Simulated(5, [Intention("mug"), Intention("can")], human=rest, by_hand=True)).play(1.0).X_SH.translation
    np.testing.assert_allclose(a - a[0], b - b[0], atol=1e-12)


def test_every_type_brings_its_tool_to_the_wanted_object():
    for kind in TYPES.values():
        scene = Scene(Simulated.of_type(kind, "can", OBJECTS, seed=3)).play(8.0)
        assert scene.presses, kind.name
        near = [np.linalg.norm(tool.translation - OBJECTS["can"].translation) < 0.35 for tool in scene.tools]
        assert any(near), kind.name


def mean_time(kind, seeds=range(8)):
    return np.mean([Scene(Simulated.of_type(kind, "can", OBJECTS, seed=s)).play(8.0).presses[0] for s in seeds])


def test_the_hasty_hand_over_sooner_than_the_typical_and_the_patient_later():
    assert mean_time("hasty") < mean_time("typical") < mean_time("patient")


def test_the_biased_leave_the_tool_off_by_what_they_misjudge():
    def offset(kind, seed):
        operator = Simulated.of_type(kind, "can", OBJECTS, seed=seed, by_hand=True)
        return Scene(operator).play(14.0).tools[0].translation - GRASPS["can"].translation

    biased = np.linalg.norm([offset("biased", s) for s in range(4)], axis=1)
    assert np.all(np.abs(biased - 0.03) < 0.015)


def test_the_mind_changing_go_for_another_object_first_the_same_one_for_the_same_seed():
    kind = operator_type("mind-changing")
    plans = [kind.plan("can", OBJECTS, seed) for seed in range(10)]
    assert all(len(plan) == 2 and plan[0].object != "can" and plan[1] == Intention("can") for plan in plans)
    assert plans == [kind.plan("can", OBJECTS, seed) for seed in range(10)]
    assert len({plan[0].object for plan in plans}) == 2
    assert kind.plan("can", {"can": OBJECTS["can"]}, 0) == (Intention("can"),)


def test_what_is_not_there_is_refused():
    with pytest.raises(UnknownName, match="patient"):
        operator_type("impatient")
    with pytest.raises(UnknownName, match="can"):
        operator_type("typical").plan("drill", OBJECTS, 0)
    for wrong in (
        {"grasp_tolerance": (0.0, 0.1)},
        {"misjudged": (-1.0, 0.0)},
        {"misjudged": (0.0, float("inf"))},
    ):
        with pytest.raises(InvalidValue):
            HumanParameters(**wrong)


def test_who_was_helped_to_the_grasp_closes_the_jaws_there_without_insisting_on_the_way():
    """A tool that glides to the grasp by itself, as under strong assistance, whatever the hand does."""
    operator = Simulated(1, [Intention("can")], by_hand=True)
    pressed = None
    for tick in range(round(12.0 * 90)):
        time = tick / 90
        X = START.interpolate(GRASPS["can"], min(1.0, time / 4.0))
        sample = operator.read(OperatorView(time, X, False, False, OBJECTS, GRASPS))
        if sample.trigger:
            pressed = time
            break
    assert pressed is not None
    assert 4.0 <= pressed < 9.0


def test_after_the_robot_was_halted_the_person_lets_go_and_takes_hold_again():
    operator = Simulated(0, [Intention("can")], human=HumanParameters(corrections=0, attempts=0))
    clutches, automatic, began = [], False, None
    for tick in range(round(8.0 * 90)):
        time = tick / 90
        if began is not None and time - began > 0.8:
            automatic = False
        sample = operator.read(OperatorView(time, START, automatic, False, OBJECTS, GRASPS))
        if sample.trigger and began is None:
            automatic, began = True, time
        clutches.append(sample.clutch)
    open_at = [k / 90 for k, clutch in enumerate(clutches) if not clutch]
    assert began is not None
    assert open_at
    assert 0.8 < open_at[0] - began < 1.0
    assert clutches[-1]
