"""Whether a known object is still where it was, from depths that are written by hand."""

from dataclasses import replace

import numpy as np
import pytest

from optsc.errors import InvalidValue
from optsc.geometry import DepthImage, PinholeCamera, PointCloud, Pose
from optsc.perception import ExpectedVisibility, Explanation, KnownObject, Segment, catalogue_template
from optsc.perception.segments import segment_from_pixels
from optsc.perception.tracking import explained_share, visibility_at, visibility_in_place

CAMERA = PinholeCamera.from_field_of_view(80, 60, 0.8)
NOWHERE = np.full((60, 80), np.inf)
PIXELS = np.zeros((60, 80), dtype=bool)
PIXELS[20:40, 30:50] = True


def image(depth_there, depth_around=1.5, pixels=PIXELS):
    return DepthImage(np.where(pixels, depth_there, depth_around), CAMERA, Pose.identity())


def known(seen=None):
    seen = image(1.0) if seen is None else seen
    points = segment_from_pixels(seen, PIXELS).cloud.points
    X_WO = Pose.from_translation([0.0, 0.0, 1.0])
    cloud = PointCloud(X_WO.inverse().apply(points))
    return KnownObject("thing", None, X_WO, (), cloud, np.zeros((0, 3)), seen, PIXELS, (), 0.0)


def test_what_is_measured_where_it_was_is_visible():
    assert visibility_in_place(known(), image(1.0), NOWHERE) is ExpectedVisibility.VISIBLE
    assert visibility_in_place(known(), image(1.0 + 0.004), NOWHERE) is ExpectedVisibility.VISIBLE


def test_what_is_seen_through_is_not_there():
    assert visibility_in_place(known(), image(1.5), NOWHERE) is ExpectedVisibility.SEEN_THROUGH
    assert visibility_in_place(known(), image(1.01), NOWHERE) is ExpectedVisibility.SEEN_THROUGH


def test_what_has_shifted_by_more_than_a_sixth_of_its_width_is_not_there():
    for columns, expected in ((2, ExpectedVisibility.VISIBLE), (4, ExpectedVisibility.SEEN_THROUGH)):
        shifted = image(1.0, pixels=np.roll(PIXELS, columns, axis=1))
        assert visibility_in_place(known(), shifted, NOWHERE) is expected


def test_something_in_front_hides_it():
    assert visibility_in_place(known(), image(0.7), NOWHERE) is ExpectedVisibility.HIDDEN


def test_the_arm_hides_it_whatever_is_measured():
    beside = NOWHERE.copy()
    beside[:, 50] = 0.8
    assert visibility_in_place(known(), image(1.5), beside) is ExpectedVisibility.HIDDEN
    behind = np.full((60, 80), 2.0)
    assert visibility_in_place(known(), image(1.5), behind) is ExpectedVisibility.SEEN_THROUGH


def test_where_nothing_is_measured_it_is_hidden():
    assert visibility_in_place(known(), image(np.nan), NOWHERE) is ExpectedVisibility.HIDDEN
    assert visibility_at(known(), Pose.from_translation([9.0, 0.0, 1.0]), image(1.0)) is ExpectedVisibility.HIDDEN


def test_it_may_be_in_another_place_unless_the_camera_sees_through_it_there():
    there = Pose.from_translation([0.0, 0.1, 1.2])
    assert visibility_at(known(), there, image(1.0, 1.0)) is ExpectedVisibility.VISIBLE
    assert visibility_at(known(), there, image(1.2, 1.2)) is ExpectedVisibility.VISIBLE
    assert visibility_at(known(), there, image(1.5)) is ExpectedVisibility.SEEN_THROUGH


def test_images_of_different_sizes_are_refused():
    with pytest.raises(InvalidValue):
        visibility_in_place(known(), image(1.0), NOWHERE[:30])


def test_a_segment_shows_what_was_at_its_depth_not_what_is_behind_it():
    def share(depth, moved=False):
        now = image(depth)
        return explained_share(segment_from_pixels(now, PIXELS), now, known(), None, moved=moved)

    assert share(1.0) == 1.0
    assert share(0.8) == 0.0
    assert share(1.0, moved=True) == 1.0  # by its surface
    assert explained_share(segment_from_pixels(image(1.0), ~PIXELS), image(1.0), known(), None, moved=False) < 0.05


def test_more_of_an_object_that_comes_into_view_belongs_to_it():
    template = catalogue_template("box")
    X_WO = Pose.from_translation([0.0, 0.0, 0.8])
    below = PointCloud(X_WO.apply(template.points[template.points[:, 2] < 0.03]), None)
    one = known()
    placed = replace(one, template="box", X_WO=X_WO, explanations=(Explanation("box", X_WO),))
    elsewhere = np.zeros_like(PIXELS)
    elsewhere[5:8, 5:8] = True
    assert explained_share(Segment(below, elsewhere, False), image(1.0), placed, template, moved=False) == 1.0


def test_a_shape_that_looks_the_same_is_taken_to_have_moved_least():
    rng = np.random.default_rng(0)
    for name, count in (("can", 8), ("box", 4), ("mug", 1)):
        template = catalogue_template(name)
        same = template.symmetries
        assert len(same) == count
        np.testing.assert_allclose(same[0].matrix(), np.eye(4), atol=1e-9)
        before = Pose.from_rotation_vector(rng.normal(size=3), rng.normal(size=3))
        found = before @ same[-1]
        found = template.nearest_equivalent(found, before)
        np.testing.assert_allclose(found.matrix(), before.matrix(), atol=1e-6)
