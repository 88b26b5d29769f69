"""Trying grasps in the simulator: good ones hold, bad ones fail for the reason that they were made bad for."""

from dataclasses import replace

import numpy as np
import pytest

from optsc.errors import InvalidValue, Mismatch
from optsc.geometry import Pose
from optsc.grasps import GraspSet
from optsc.robot import PANDA_HAND, urdf
from optsc.sampling.antipodal import sample_grasps
from optsc.sampling.settings import AntipodalSettings
from optsc.sim.grasp_trial import TrialSettings, hand_description
from optsc.sim.objects import OBJECT_NAMES, object_model
from optsc.sim.validation import TrialOutcome, try_grasps, validate

_QUARTER_TURN = Pose.from_rotation_vector([0.0, 0.0, 0.5 * np.pi], np.zeros(3))


def grasps_of(name: str, count: int = 2) -> GraspSet:
    settings = AntipodalSettings(count=count, pool=2, spacing=0.003)
    return sample_grasps(object_model(name).mesh, PANDA_HAND, name=name, seed=3, settings=settings)


def with_poses(grasps: GraspSet, X_OG: Pose) -> GraspSet:
    number = len(X_OG)
    return replace(grasps, X_OG=X_OG, opening=np.full(number, 0.06), quality=np.ones(number))


@pytest.fixture(scope="module")
def side_grasp() -> GraspSet:
    """The can's middle from the side, jaws horizontal."""
    R = np.column_stack([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])  # x up, y sideways, z forwards
    M = np.eye(4)
    M[:3, :3], M[:3, 3] = R, [0.0, 0.0, 0.06]
    return with_poses(grasps_of("can", 1), Pose.from_matrix(M[None]))


@pytest.mark.parametrize("name", OBJECT_NAMES)
def test_sampled_grasps_hold_without_bumping_the_object(name: str) -> None:
    outcome = try_grasps(object_model(name), grasps_of(name))
    assert outcome.lifted.tolist() == [True, True]
    assert outcome.moved_before_closing.max() < 0.002
    assert outcome.moved_by_closing.max() < 0.005
    assert outcome.slip.max() < TrialSettings().max_slip


def test_a_finger_in_the_way_bumps_the_object(side_grasp: GraspSet) -> None:
    aside = with_poses(side_grasp, side_grasp.X_OG @ Pose.from_translation([0.0, 0.03, 0.0]))
    outcome = try_grasps(object_model("can"), aside)
    assert outcome.moved_before_closing[0] > 0.02


def test_jaws_that_close_on_nothing_lift_nothing(side_grasp: GraspSet) -> None:
    above = with_poses(side_grasp, side_grasp.X_OG @ Pose.from_translation([0.1, 0.0, 0.0]))
    outcome = try_grasps(object_model("can"), above)
    assert not outcome.lifted[0]
    assert outcome.moved_before_closing[0] < 1e-3


@pytest.mark.parametrize(("jaw_force", "held"), [(0.5, False), (12.0, True)])
def test_a_can_is_held_when_friction_can_carry_its_weight(side_grasp: GraspSet, jaw_force: float, held: bool) -> None:
    can = object_model("can")
    carried = 2 * can.friction * jaw_force / (can.mass * 9.81)
    assert carried > 4.0 or carried < 0.25
    outcome = try_grasps(can, side_grasp, TrialSettings(jaw_force=jaw_force))
    assert outcome.lifted.tolist() == [held]


def test_a_slippery_can_falls(side_grasp: GraspSet) -> None:
    assert not try_grasps(replace(object_model("can"), friction=0.01), side_grasp).lifted[0]


def test_the_outcome_of_a_grasp_does_not_depend_on_the_grasps_before_it(side_grasp: GraspSet) -> None:
    bad = side_grasp.X_OG @ Pose.from_translation([0.0, 0.03, 0.0])
    alone = try_grasps(object_model("can"), side_grasp)
    after = try_grasps(object_model("can"), with_poses(side_grasp, Pose.concatenate([bad, side_grasp.X_OG])))
    assert [values[1:].tobytes() for values in after] == [values.tobytes() for values in alone]


def test_the_outcome_does_not_depend_on_the_number_of_workers(side_grasp: GraspSet) -> None:
    shifts = Pose.from_translation([[0.0, 0.0, 0.0], [0.0, 0.03, 0.0], [0.0, 0.002, 0.01]])
    grasps = with_poses(side_grasp, side_grasp.X_OG @ shifts)
    alone, shared = (validate(object_model("can"), grasps, workers=n) for n in (1, 2))
    assert alone.reliable.tolist() == shared.reliable.tolist()
    assert alone.provenance == shared.provenance
    assert alone.tried is not None
    assert alone.tried.all()
    assert alone.provenance["validation"]["tried"] == 3  # type: ignore[index]
    with pytest.raises(InvalidValue, match="workers"):
        validate(object_model("can"), grasps, workers=0)


def test_an_object_can_be_tried_as_it_lies(side_grasp: GraspSet) -> None:
    can = object_model("can")
    on_its_side = Pose.from_rotation_vector([0.5 * np.pi, 0.0, 0.0], [0.0, 0.0, 0.03])
    from_above = Pose.from_rotation_vector([np.pi, 0.0, 0.0], [0.0, -0.06, 0.035])
    grasps = with_poses(side_grasp, (on_its_side.inverse() @ from_above)[None])
    X_OG = grasps.X_OG
    assert try_grasps(can, with_poses(side_grasp, X_OG @ _QUARTER_TURN), X_WO=on_its_side).lifted.tolist() == [True]
    with pytest.raises(InvalidValue, match="rest of can"):
        try_grasps(can, grasps, X_WO=Pose.from_rotation_vector([0.7, 0.0, 0.0], [0.0, 0.0, 0.1]))


def test_reasons_tell_held_bumped_lost_and_slipped_apart() -> None:
    nan = float("nan")
    outcome = TrialOutcome(
        np.array([True, False, False, False, True]),
        np.array([0.0, 0.02, 0.0, 0.0, 0.02]),
        np.zeros(5),
        np.array([0.001, nan, nan, 0.03, 0.001]),
        np.zeros(5),
    )
    assert outcome.reasons(TrialSettings()) == ("held", "bumped", "lost", "slipped", "held")


def test_grasps_made_on_a_cloud_can_be_tried_on_the_object_it_shows(side_grasp: GraspSet) -> None:
    seen = replace(side_grasp, object_hash="cloud:0")
    assert try_grasps(object_model("can"), seen).lifted.tolist() == [True]


def test_progress_counts_the_trials(side_grasp: GraspSet) -> None:
    calls: list[tuple[str, int, int]] = []
    try_grasps(object_model("can"), side_grasp, progress=lambda *a: calls.append(a))
    assert calls == [("can", 1, 1)]


def test_grasps_for_another_object_or_another_gripper_are_refused(side_grasp: GraspSet) -> None:
    with pytest.raises(Mismatch, match="can"):
        try_grasps(object_model("mug"), side_grasp)
    with pytest.raises(Mismatch, match="two_fingers"):
        try_grasps(object_model("can"), replace(side_grasp, gripper="two_fingers"))


def test_the_hand_alone_has_the_two_jaws_and_its_tool_frame_between_the_pads() -> None:
    path, X_HT = hand_description()
    hand = urdf.read_urdf(path)
    assert [j.get("name") for j in hand.findall("joint")] == list(PANDA_HAND.finger_joints)
    assert X_HT.almost_equal(Pose.from_translation([0.0, 0.0, 0.1034]))


def test_impossible_settings_are_refused_by_name() -> None:
    with pytest.raises(InvalidValue, match="jaw_force"):
        TrialSettings(jaw_force=-1.0)
