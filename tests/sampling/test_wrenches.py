"""Wrenches that two soft fingers resist, against values that can be worked out by hand."""

import numpy as np
import pytest

from optsc.geometry import rotation
from optsc.sampling.quality import EDGES, best_resistance, contact_wrenches, largest_ball, resistance

FRICTION, TORSION, LENGTH = 0.5, 0.005, 0.05
POINTS = np.array([[[0.0, -0.03, 0.0], [0.0, 0.03, 0.0]]])
INWARD = np.array([[[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]])


def test_the_largest_ball_in_a_cross_polytope_is_known() -> None:
    corners = np.concatenate([np.eye(6), -np.eye(6)])
    assert largest_ball(corners) == pytest.approx(1 / np.sqrt(6))
    assert largest_ball(3.0 * corners) == pytest.approx(3 / np.sqrt(6))


def test_no_ball_fits_where_a_wrench_cannot_be_resisted_or_the_wrenches_are_flat() -> None:
    corners = np.concatenate([np.eye(6), -np.eye(6)])
    assert largest_ball(corners + 2.0) == 0.0
    assert largest_ball(corners * [1, 1, 1, 1, 1, 0]) == 0.0


def test_every_wrench_lies_in_the_cone_and_has_the_torque_of_its_force() -> None:
    wrenches = contact_wrenches(POINTS, INWARD, FRICTION, TORSION, LENGTH)
    assert wrenches.shape == (1, 2, EDGES + 2, 6)
    force, torque = wrenches[..., :3], wrenches[..., 3:] * LENGTH
    along = np.einsum("gcei,gci->gce", force, INWARD)
    assert np.allclose(along, 1.0)
    aside = np.linalg.norm(force - INWARD[:, :, None], axis=-1)
    assert np.allclose(aside[..., :EDGES], FRICTION)
    assert np.allclose(aside[..., EDGES:], 0.0)
    about_itself = torque - np.cross(POINTS[:, :, None], force)
    assert np.allclose(about_itself[..., :EDGES, :], 0.0)
    assert np.allclose(np.linalg.norm(about_itself[..., EDGES:, :], axis=-1), FRICTION * TORSION)


def test_fingers_without_torsion_resist_no_turn_about_the_line_between_them() -> None:
    assert resistance(POINTS, INWARD, FRICTION, 1e-12, LENGTH)[0] < 1e-9
    assert resistance(POINTS, INWARD, FRICTION, TORSION, LENGTH)[0] > 0.01


def test_a_normal_outside_the_cone_of_the_other_finger_resists_nothing() -> None:
    tilt = np.radians(60.0)
    inward = np.array([[[0.0, np.cos(tilt), np.sin(tilt)], [0.0, -np.cos(tilt), np.sin(tilt)]]])
    assert resistance(POINTS, inward, FRICTION, TORSION, LENGTH)[0] == 0.0


def test_resistance_does_not_depend_on_how_the_grasp_is_turned() -> None:
    q = rotation.random(np.random.default_rng(0))
    turned = (rotation.rotate(q, POINTS), rotation.rotate(q, INWARD))
    straight = resistance(POINTS, INWARD, FRICTION, TORSION, LENGTH)[0]
    # The pyramids' edges point elsewhere, so the numbers differ by a little.
    assert resistance(*turned, FRICTION, TORSION, LENGTH)[0] == pytest.approx(straight, rel=0.02)
    assert best_resistance(0.06, FRICTION, TORSION, LENGTH) == pytest.approx(straight)


def test_torsion_bounds_what_is_resisted_about_the_line_between_the_fingers() -> None:
    ball = resistance(POINTS, INWARD, FRICTION, TORSION, LENGTH)[0]
    assert 0.9 * FRICTION * TORSION / LENGTH < ball <= FRICTION * TORSION / LENGTH + 1e-9
