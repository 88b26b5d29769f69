import numpy as np
import pytest

from optsc.errors import InvalidValue, Mismatch
from optsc.geometry import PointCloud, Pose

RNG = np.random.default_rng(0)
POINTS = RNG.normal(size=(20, 3))
NORMALS = POINTS / np.linalg.norm(POINTS, axis=1, keepdims=True)
SEEN = np.arange(20) % 3 > 0
CLOUD = PointCloud(POINTS, NORMALS, SEEN)
X = Pose.from_rotation_vector([0.3, -0.8, 0.5], [1.0, 2.0, 3.0])


def test_a_selection_keeps_points_normals_and_flags_together():
    for choice in (POINTS[:, 0] > 0.0, np.array([3, 1, 7]), np.array([-1])):
        part = CLOUD.select(choice)
        np.testing.assert_array_equal(part.points, POINTS[choice])
        np.testing.assert_array_equal(part.normals, NORMALS[choice])
        np.testing.assert_array_equal(part.seen, SEEN[choice])


def test_nothing_can_be_selected_also_from_an_empty_cloud():
    empty = CLOUD.select([])
    assert len(empty) == len(empty.select([])) == len(empty.select(np.zeros(0, dtype=bool))) == 0
    assert empty.visible_share == 0.0


def test_a_transform_and_its_inverse_cancel_and_leave_normals_unshifted():
    moved = CLOUD.transformed(X)
    np.testing.assert_allclose(moved.points, X.apply(POINTS))
    np.testing.assert_allclose(moved.normals @ X.rotation_matrix(), NORMALS, atol=1e-12)
    np.testing.assert_allclose(moved.transformed(X.inverse()).points, POINTS, atol=1e-12)


def test_joined_clouds_follow_one_another_and_unflagged_points_count_as_seen():
    both = PointCloud.joined(PointCloud(POINTS, NORMALS), CLOUD)
    np.testing.assert_array_equal(both.points, np.concatenate([POINTS, POINTS]))
    np.testing.assert_array_equal(both.seen, np.concatenate([np.ones(20, dtype=bool), SEEN]))
    assert both.visible_share == pytest.approx((20 + SEEN.sum()) / 40)


def test_an_empty_cloud_can_be_joined_to_any():
    empty = PointCloud(np.zeros((0, 3)))
    assert len(PointCloud.joined()) == 0
    assert PointCloud.joined(empty, CLOUD).normals is not None


def test_clouds_with_and_without_normals_are_not_joined():
    with pytest.raises(Mismatch):
        PointCloud.joined(CLOUD, PointCloud(POINTS))


def test_a_cloud_cannot_be_changed_from_outside():
    points = POINTS.copy()
    cloud = PointCloud(points)
    points[:] = 0.0
    np.testing.assert_array_equal(cloud.points, POINTS)
    with pytest.raises(ValueError, match="read-only"):
        cloud.points[0] = 0.0


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ((np.zeros((3, 2)),), "cloud points"),
        ((np.array([[0.0, np.nan, 0.0]]),), "cloud points"),
        ((POINTS, NORMALS[:5]), "cloud normals"),
        ((POINTS, 2.0 * NORMALS), "length of a cloud's normal"),
        ((POINTS, np.full((20, 3), np.nan)), "length of a cloud's normal"),
        ((POINTS, NORMALS, SEEN[:5]), "seen flags"),
        ((POINTS, NORMALS, SEEN.astype(float)), "seen flags"),
    ],
)
def test_what_is_no_cloud_is_refused_by_name(arguments, field):
    with pytest.raises(InvalidValue, match=field):
        PointCloud(*arguments)


@pytest.mark.parametrize("choice", [[20], [-21], np.ones(5, dtype=bool), [0.5], [[1]]])
def test_a_selection_of_points_that_are_not_there_is_refused(choice):
    with pytest.raises(InvalidValue):
        CLOUD.select(choice)
