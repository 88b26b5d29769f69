"""The compensated cloud: seen points, and the template's where nothing was seen."""

import numpy as np
import pytest
from perception_cases import X_WC, drawn, segment_of, upright
from scipy.spatial import cKDTree

from optsc.errors import InvalidValue
from optsc.geometry import PointCloud, Pose
from optsc.perception import catalogue_template, complete_cloud, template_from_mesh
from optsc.perception.completion import even_points
from optsc.sim.objects.solids import cuboid

X_WO = upright(0.4, 0.02, 0.01)


@pytest.fixture(scope="module")
def box():
    return catalogue_template("box")


@pytest.fixture(scope="module")
def view(box):
    image, owner = drawn([(box.mesh, X_WO)])
    return image, segment_of(image, owner).cloud


def test_seen_points_come_first_and_unseen_ones_are_on_the_template(box, view):
    _, cloud = view
    whole = complete_cloud(cloud, box, X_WO)
    seen = whole.seen
    np.testing.assert_allclose(whole.points[seen], X_WO.inverse().apply(cloud.points), atol=1e-12)
    off = np.abs(box.field.lookup(whole.points[~seen])[0])
    assert np.percentile(off, 95) < 5e-4
    assert off.max() < box.field.step
    gaps, _ = cKDTree(whole.points[seen]).query(whole.points[~seen])
    assert gaps.min() > 0.004


@pytest.mark.parametrize("spacing", [0.0025, 0.005])
def test_the_whole_surface_is_covered_as_densely_as_asked_for(box, view, spacing):
    _, cloud = view
    whole = complete_cloud(cloud, box, X_WO, spacing=spacing)
    gaps, _ = cKDTree(whole.points).query(even_points(box.mesh, 0.001)[0])
    assert gaps.max() <= 0.004 + spacing
    apart = cKDTree(whole.points[~whole.seen]).query(whole.points[~whole.seen], k=2)[0][:, 1]
    assert 0.6 * spacing < np.median(apart) < 1.2 * spacing


def test_of_a_thin_wall_the_side_that_was_not_seen_is_filled_in():
    wall = template_from_mesh("wall", cuboid([-0.05, -0.001, 0.0], [0.05, 0.001, 0.06]), count=400)
    points, normals = even_points(wall.mesh, 0.002)
    front = normals[:, 1] > 0.9
    cloud = PointCloud(points[front], normals[front])
    whole = complete_cloud(cloud, wall, Pose.identity())
    back = (~whole.seen) & (whole.normals[:, 1] < -0.9)
    gaps, _ = cKDTree(whole.points[back]).query(points[normals[:, 1] < -0.9])
    assert gaps.max() < 0.004
    assert not (~whole.seen & (whole.normals[:, 1] > 0.9)).any()


def test_the_sides_away_from_the_camera_are_filled_in(box, view):
    _, cloud = view
    whole = complete_cloud(cloud, box, X_WO)
    eye = X_WO.inverse().apply(X_WC.translation)
    facing = ((eye - whole.points) * whole.normals).sum(axis=1) > 0.0
    assert facing[whole.seen].mean() > 0.95
    low = whole.points[:, 2] < 0.012  # the strip that a segmentation cuts off above the table
    assert facing[~whole.seen & ~low].mean() < 0.2


def test_normals_point_outwards(box, view):
    _, cloud = view
    whole = complete_cloud(cloud, box, X_WO)
    outside = box.field.lookup(whole.points + 0.003 * whole.normals)[0]
    assert (outside > 0.0).mean() > 0.99


def test_points_that_were_seen_through_are_left_out(box, view):
    image, cloud = view
    beside = Pose.from_translation([0.0, 0.0, 0.0]) @ upright(0.4, 0.02, 0.12)
    free = complete_cloud(cloud, box, beside, image=image)
    blind = complete_cloud(cloud, box, beside)
    assert (~free.seen).sum() < 0.5 * (~blind.seen).sum()


def test_seen_points_of_something_else_are_left_out(box, view):
    _, cloud = view
    other = PointCloud.joined(cloud, PointCloud(cloud.points[:50] + [0.0, 0.0, 0.3]))
    assert complete_cloud(other, box, X_WO).seen.sum() == len(cloud)


def test_what_the_alternatives_do_not_agree_about_is_not_filled_in():
    mug = catalogue_template("mug")
    nothing = PointCloud(np.zeros((0, 3)))
    body = complete_cloud(nothing, mug, upright(0.0), alternatives=[upright(1.0)])
    assert np.hypot(*body.points[:, :2].T).max() < 0.041  # the handle reaches to 0.068
    everything = complete_cloud(nothing, mug, upright(0.0), alternatives=[upright(0.0)])
    assert len(everything) == len(even_points(mug.mesh, 0.0025)[0])
    assert len(body) > 0.8 * len(everything)


def test_an_empty_cloud_gives_the_template(box):
    whole = complete_cloud(PointCloud(np.zeros((0, 3))), box, X_WO)
    assert not whole.seen.any()
    np.testing.assert_array_equal(whole.points, even_points(box.mesh, 0.0025)[0])


@pytest.mark.parametrize("field", ["spacing", "distance", "outlier"])
def test_a_length_of_nothing_is_refused(box, field):
    with pytest.raises(InvalidValue, match=field):
        complete_cloud(PointCloud(np.zeros((0, 3))), box, X_WO, **{field: 0.0})


def test_a_spacing_that_cannot_have_been_meant_is_refused(box):
    with pytest.raises(InvalidValue, match="spacing"):
        complete_cloud(PointCloud(np.zeros((0, 3))), box, X_WO, spacing=1e-5)
