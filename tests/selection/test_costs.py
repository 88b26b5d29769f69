from __future__ import annotations

import numpy as np
import pytest
from selection_cases import JOINTS, random_candidates, random_hand, random_table

from optsc.errors import InvalidValue
from optsc.geometry import Pose, rotation
from optsc.selection import (
    JointTravel,
    ManipulabilityLoss,
    OrientationDistance,
    PoseDistance,
    PositionDistance,
    QualityLoss,
)
from optsc.selection.grid import Grid, situate

POSE = PoseDistance((1.0, 0.5, 0.2), (1.0, 2.0, 0.1), 0.12)


@pytest.fixture(params=[True, False], ids=["twins", "no twins"])
def seen(request):
    """A table, a hand, the situation, and per candidate the twin to use."""
    rng = np.random.default_rng(31)
    candidates = random_candidates(rng, (40, 25), jaw_symmetric=request.param)
    table, hand = random_table(rng, candidates, reachable=1.0), random_hand(rng)
    situation = situate(Grid(table), hand.quaternion, hand.translation, rng.normal(size=JOINTS))
    angles = rotation.angle(table.X_WG.quaternion, hand.quaternion)
    return table, hand, situation, angles.argmin(axis=1)


def of(cost, situation):
    return situation.grid.layout.gather(cost.values(situation))


def test_the_orientation_distance_is_the_papers_chord_of_the_nearer_twin(seen):
    table, hand, situation, _ = seen
    chord = rotation.chord(table.X_WG.quaternion, hand.quaternion).min(axis=1)
    assert np.allclose(of(OrientationDistance(), situation), chord, atol=1e-12)


def test_the_position_distance_is_the_distance_of_the_origins(seen):
    table, hand, situation, _ = seen
    d = np.linalg.norm(table.X_WG.translation[:, 0] - hand.translation, axis=1)
    assert np.allclose(of(PositionDistance(), situation), d, atol=1e-12)


def test_table_costs_are_read_at_the_twin_that_is_used(seen):
    table, _, situation, twin = seen
    rows = np.arange(len(twin)), twin
    assert np.array_equal(of(ManipulabilityLoss(), situation), -table.manipulability[rows])
    travel = np.abs(table.q_grasp[rows] - situation.q).max(axis=1)
    assert np.array_equal(of(JointTravel(), situation), travel)
    assert np.array_equal(of(QualityLoss(), situation), 1.0 - table.candidates.quality)


def test_the_pose_distance_is_the_weighted_norm_of_the_error_in_the_gripper_frame(seen):
    table, hand, situation, twin = seen
    for i, got in enumerate(of(POSE, situation)):
        error = table.X_WG[i, twin[i]].inverse() @ hand
        xi = np.concatenate([error.translation, rotation.log(error.quaternion)])
        weights = np.concatenate([POSE.position, POSE.length**2 * np.array(POSE.rotation)])
        assert got == pytest.approx(np.sqrt(np.sum(weights * xi**2)), abs=1e-12)


def test_the_pose_distance_vanishes_where_the_hand_already_is():
    rng = np.random.default_rng(32)
    table = random_table(rng, random_candidates(rng, (5,)), reachable=1.0)
    hand = table.X_WG[3, 1]
    situation = situate(Grid(table), hand.quaternion, hand.translation, np.zeros(JOINTS))
    assert of(POSE, situation)[3] == pytest.approx(0.0, abs=1e-9)
    assert of(OrientationDistance(), situation)[3] == pytest.approx(0.0, abs=1e-7)


def test_a_pose_weight_of_zero_makes_the_cost_blind_to_that_direction():
    rng = np.random.default_rng(33)
    table = random_table(rng, random_candidates(rng, (1,)), reachable=1.0)
    along = PoseDistance((1.0, 1.0, 0.0), (1.0, 1.0, 0.0))
    moved = Pose.from_rotation_vector([0.0, 0.0, 0.4], [0.0, 0.0, -0.3])
    hand = table.X_WG[0, 0] @ moved
    situation = situate(Grid(table), hand.quaternion, hand.translation, np.zeros(JOINTS))
    assert of(along, situation)[0] == pytest.approx(0.0, abs=1e-9)
    assert of(PoseDistance(), situation)[0] > 0.3


@pytest.mark.parametrize(
    "settings", [{"position": (1.0, -1.0, 1.0)}, {"rotation": (1.0, 1.0)}, {"length": float("nan")}]
)
def test_pose_weights_that_make_no_distance_are_refused(settings):
    with pytest.raises((InvalidValue, ValueError)):
        PoseDistance(**settings)
