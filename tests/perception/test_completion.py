"""The compensated cloud: seen points, and the template's where nothing was seen."""

import numpy as np
import pytest
from perception_cases import X_WC, drawn, segment_of, upright
from scipy.spatial import cKDTree

from optsc.errors import InvalidValue
from optsc.geometry import PointCloud, Pose
from optsc.perception import catalogue_template, completed

X_WO = upright(0.4, 0.02, 0.01)


@pytest.fixture(scope="module")
def box():
    return catalogue_template("box")


@pytest.fixture(scope="module")
def view(box):
    image, owner = drawn([(box.mesh, X_WO)])
    return image, segment_of(image, owner).cloud


def test_seen_points_come_first_and_unseen_ones_are_the_templates(box, view):
    _, cloud = view
    whole = completed(cloud, box, X_WO)
    seen = whole.seen
    np.testing.assert_allclose(whole.points[seen], X_WO.inverse().apply(cloud.points), atol=1e-12)
    added = {tuple(p) for p in whole.points[~seen]}
    assert added <= {tuple(p) for p in box.points}
    gaps, _ = cKDTree(whole.points[seen]).query(whole.points[~seen])
    assert gaps.min() > 0.006


def test_the_whole_surface_is_covered(box, view):
    _, cloud = view
    whole = completed(cloud, box, X_WO)
    gaps, _ = cKDTree(whole.points).query(box.points)
    assert gaps.max() <= 0.006


def test_the_sides_away_from_the_camera_are_filled_in(box, view):
    _, cloud = view
    whole = completed(cloud, box, X_WO)
    eye = X_WO.inverse().apply(X_WC.translation)
    facing = ((eye - whole.points) * whole.normals).sum(axis=1) > 0.0
    assert facing[whole.seen].mean() > 0.95
    low = whole.points[:, 2] < 0.012  # the strip that a segmentation cuts off above the table
    assert facing[~whole.seen & ~low].mean() < 0.15


def test_normals_point_outwards(box, view):
    _, cloud = view
    whole = completed(cloud, box, X_WO)
    outside = box.field.lookup(whole.points + 0.003 * whole.normals)[0]
    assert (outside > 0.0).mean() > 0.99


def test_points_that_were_seen_through_are_left_out(box, view):
    image, cloud = view
    beside = Pose.from_translation([0.0, 0.0, 0.0]) @ upright(0.4, 0.02, 0.12)
    free = completed(cloud, box, beside, image=image)
    blind = completed(cloud, box, beside)
    assert (~free.seen).sum() < 0.5 * (~blind.seen).sum()


def test_seen_points_of_something_else_are_left_out(box, view):
    _, cloud = view
    other = PointCloud.joined(cloud, PointCloud(cloud.points[:50] + [0.0, 0.0, 0.3]))
    assert completed(other, box, X_WO).seen.sum() == len(cloud)


def test_what_the_alternatives_do_not_agree_about_is_not_filled_in():
    mug = catalogue_template("mug")
    nothing = PointCloud(np.zeros((0, 3)))
    body = completed(nothing, mug, upright(0.0), alternatives=[upright(1.0)])
    assert np.hypot(*body.points[:, :2].T).max() < 0.041  # the handle reaches to 0.068
    assert len(body) > 0.8 * len(mug.points)
    assert len(completed(nothing, mug, upright(0.0), alternatives=[upright(0.0)])) == len(mug.points)


def test_an_empty_cloud_gives_the_template(box):
    whole = completed(PointCloud(np.zeros((0, 3))), box, X_WO)
    assert not whole.seen.any()
    np.testing.assert_array_equal(whole.points, box.points)


def test_a_distance_of_nothing_is_refused(box):
    with pytest.raises(InvalidValue, match="distance"):
        completed(PointCloud(np.zeros((0, 3))), box, X_WO, distance=0.0)
