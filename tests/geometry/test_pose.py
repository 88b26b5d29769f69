"""Laws of poses and rotations, over single poses and batches, with rotations near none and near half a turn."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from optsc.errors import InvalidValue
from optsc.geometry import Pose, rotation, scalar


def poses(shape, seed):
    rng = np.random.default_rng(seed)
    vector = rng.normal(size=(*shape, 3))
    vector *= rng.choice([1e-9, 1e-4, 0.5, 3.1], size=(*shape, 1)) / np.linalg.norm(vector, axis=-1, keepdims=True)
    return Pose.from_rotation_vector(vector, rng.normal(size=(*shape, 3)))


shapes = st.sampled_from([(), (1,), (5,), (2, 3)])
seeds = st.integers(0, 2**32 - 1)


@given(shapes, seeds)
def test_a_pose_times_its_inverse_is_the_identity(shape, seed):
    X = poses(shape, seed)
    assert (X @ X.inverse()).almost_equal(Pose.identity(shape), 1e-12)


@given(shapes, seeds)
def test_composition_agrees_with_matrices(shape, seed):
    A, B = poses(shape, seed), poses(shape, seed + 1)
    np.testing.assert_allclose((A @ B).matrix(), A.matrix() @ B.matrix(), atol=1e-12)


@given(shapes, seeds)
def test_a_pose_survives_the_way_through_its_matrix(shape, seed):
    X = poses(shape, seed)
    assert Pose.from_matrix(X.matrix()).almost_equal(X, 1e-9)


@given(shapes, seeds)
def test_log_undoes_exp(shape, seed):
    vector = rotation.log(poses(shape, seed).quaternion)
    np.testing.assert_allclose(rotation.log(rotation.exp(vector)), vector, atol=1e-9)


@given(seeds)
def test_points_move_as_the_matrix_says(seed):
    X, point = poses((4,), seed), np.random.default_rng(seed).normal(size=3)
    expected = (X.matrix() @ np.append(point, 1.0))[..., :3]
    np.testing.assert_allclose(X.apply(point), expected, atol=1e-12)


@given(seeds)
def test_metrics_do_not_depend_on_the_sign_of_a_quaternion(seed):
    a, b = rotation.random(np.random.default_rng(seed), (2,))
    for metric in (rotation.chord, rotation.angle):
        assert metric(a, b) == pytest.approx(metric(-a, b), abs=1e-15)
    np.testing.assert_allclose(rotation.log(a), rotation.log(-a), atol=1e-12)


@given(seeds)
def test_the_chord_is_twice_the_sine_of_a_quarter_of_the_angle(seed):
    a, b = rotation.random(np.random.default_rng(seed), (2,))
    assert rotation.chord(a, b) == pytest.approx(2 * np.sin(rotation.angle(a, b) / 4), abs=1e-12)


def test_the_angle_keeps_its_digits_near_zero():
    q = rotation.exp([1e-10, 0, 0])
    assert rotation.angle([1, 0, 0, 0], q) == pytest.approx(1e-10, rel=1e-5)


def test_slerp_goes_the_short_way_at_constant_speed():
    a, b = rotation.exp([0, 0, 0.2]), -rotation.exp([0, 0, 1.0])
    middle = rotation.slerp(a, b, np.array([0.0, 0.25, 1.0]))
    np.testing.assert_allclose(rotation.angle(middle, rotation.exp([0, 0, 0.2])), [0, 0.2, 0.8], atol=1e-12)


@given(seeds)
def test_scalar_rotations_equal_those_on_arrays(seed):
    rng = np.random.default_rng(seed)
    a, b = rotation.random(rng, (2,))
    v = rng.normal(size=3)
    ta, tb, tv = tuple(a), tuple(b), tuple(v)
    np.testing.assert_allclose(scalar.multiply(ta, tb), rotation.multiply(a, b), atol=1e-14)
    np.testing.assert_allclose(scalar.rotate(ta, tv), rotation.rotate(a, v), atol=1e-14)
    np.testing.assert_allclose(scalar.exp(tv), rotation.exp(v), atol=1e-14)
    np.testing.assert_allclose(scalar.log(ta), rotation.log(a), atol=1e-12)
    assert scalar.angle(ta) == pytest.approx(float(rotation.angle([1, 0, 0, 0], a)), abs=1e-12)


def test_a_pose_is_read_only_and_keeps_no_reference():
    p = np.zeros(3)
    X = Pose.from_quaternion([1, 0, 0, 0], p)
    p[0] = 1.0
    assert X.translation[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        X.translation[0] = 2.0


@pytest.mark.parametrize("q", [[0, 0, 0, 0], [1, 1, 0, 0], [np.nan, 0, 0, 1], [1, 0, 0]])
def test_a_quaternion_that_is_none_is_refused(q):
    with pytest.raises(InvalidValue, match="quaternion"):
        Pose.from_quaternion(q, [0, 0, 0])


def test_a_matrix_that_is_no_pose_is_refused():
    for wrong in (np.eye(3), np.diag([1, 1, -1, 1]), 2 * np.eye(4), np.full((4, 4), np.nan)):
        with pytest.raises(InvalidValue):
            Pose.from_matrix(wrong)


def test_indexing_stacking_and_joining_keep_poses():
    X = poses((3,), 1)
    assert Pose.stack([X[0], X[1], X[2]]).almost_equal(X)
    assert Pose.concatenate([X[:1], X[1:]]).almost_equal(X)
    assert len(X) == 3
    with pytest.raises(TypeError, match="single"):
        len(X[0])
