import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from optsc.errors import InvalidValue
from optsc.geometry import DepthImage, PinholeCamera, Pose, look_at

CAMERA = PinholeCamera(32, 24, 40.0, 42.0, 14.0, 12.5)
NAN = float("nan")


def image(depth, X_WC=None):
    return DepthImage(depth, CAMERA, Pose.identity() if X_WC is None else X_WC)


@given(st.integers(0, 2**32 - 1))
def test_projecting_what_was_backprojected_gives_the_pixel_and_its_depth(seed):
    depth = np.random.default_rng(seed).uniform(0.1, 5.0, (24, 32))
    u, v, z = CAMERA.project(CAMERA.backproject(depth))
    np.testing.assert_allclose(u, np.broadcast_to(np.arange(32.0), u.shape), atol=1e-9)
    np.testing.assert_allclose(v, np.broadcast_to(np.arange(24.0)[:, None], v.shape), atol=1e-9)
    np.testing.assert_array_equal(z, depth)


def test_the_optical_axis_meets_the_principal_point_and_x_is_right_and_y_is_down():
    assert CAMERA.project([0.0, 0.0, 2.0]) == (14.0, 12.5, 2.0)
    u, v, _ = CAMERA.project([[0.1, 0.0, 2.0], [0.0, 0.1, 2.0]])
    assert u[0] > 14.0 and v[0] == 12.5  # noqa: PT018
    assert u[1] == 14.0 and v[1] > 12.5  # noqa: PT018


def test_what_is_not_in_front_of_the_camera_has_no_pixel():
    u, v, z = CAMERA.project([[0.1, 0.2, -1.0], [0.0, 0.0, 0.0]])
    assert np.isnan(u).all()
    assert np.isnan(v).all()
    np.testing.assert_array_equal(z, [-1.0, 0.0])


def test_the_field_of_view_reaches_from_edge_to_edge():
    camera = PinholeCamera.from_field_of_view(640, 480, 0.8)
    _, v, _ = camera.project([[0.0, math.tan(0.4), 1.0], [0.0, -math.tan(0.4), 1.0]])
    np.testing.assert_allclose(v, [479.5, -0.5])


def test_a_camera_looks_at_its_target_with_up_upwards():
    X_WC = look_at([1.0, 0.5, 0.8], [0.4, 0.0, 0.1])
    u, v, z = CAMERA.project(X_WC.inverse().apply([[0.4, 0.0, 0.1], [0.4, 0.0, 0.2]]))
    np.testing.assert_allclose([u[0], v[0]], [CAMERA.cx, CAMERA.cy], atol=1e-9)
    assert z[0] == pytest.approx(np.linalg.norm([0.6, 0.5, 0.7]))
    assert v[1] < v[0]
    assert u[1] == pytest.approx(u[0])


def test_points_in_the_world_are_those_of_the_camera_moved_by_its_pose():
    depth = np.full((24, 32), 1.5)
    depth[3, 4] = NAN
    X_WC = look_at([1.0, 0.5, 0.8], [0.4, 0.0, 0.1])
    points = image(depth, X_WC).points()
    assert np.isnan(points[3, 4]).all()
    assert np.isnan(points).sum() == 3
    np.testing.assert_allclose(points[5, 6], X_WC.apply(CAMERA.backproject(depth)[5, 6]))


def test_an_image_without_a_single_depth_is_an_image():
    empty = image(np.full((24, 32), NAN))
    assert not empty.measured.any()
    assert np.isnan(empty.points()).all()


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"width": 0}, "width"),
        ({"height": 2.5}, "height"),
        ({"width": 100_000}, "width"),
        ({"fx": 0.0}, "fx"),
        ({"fy": NAN}, "fy"),
        ({"cx": NAN}, "cx"),
        ({"cy": 1e4}, "cy"),
    ],
)
def test_what_is_no_camera_is_refused_by_name(change, field):
    with pytest.raises(InvalidValue, match=f"^{field} is"):
        PinholeCamera(**{"width": 32, "height": 24, "fx": 40.0, "fy": 42.0, "cx": 14.0, "cy": 12.5, **change})


@pytest.mark.parametrize(
    "depth", [np.ones((32, 24)), np.zeros((24, 32)), np.full((24, 32), np.inf), -np.ones((24, 32))]
)
def test_depths_of_another_size_or_none_at_all_are_refused(depth):
    with pytest.raises(InvalidValue, match="depth"):
        image(depth)


def test_places_from_which_nothing_can_be_looked_at_are_refused():
    with pytest.raises(InvalidValue, match="target"):
        look_at([1.0, 0.0, 0.0], [1.0, 0.0, 0.0])
    with pytest.raises(InvalidValue, match="up"):
        look_at([0.0, 0.0, 1.0], [0.0, 0.0, 0.0])
    with pytest.raises(InvalidValue, match="eye"):
        look_at([0.0, NAN, 1.0], [0.0, 0.0, 0.0])
    with pytest.raises(InvalidValue, match="field of view"):
        PinholeCamera.from_field_of_view(640, 480, 180.0)
