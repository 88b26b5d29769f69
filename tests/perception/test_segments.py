import numpy as np
import pytest

from optsc.errors import InvalidValue
from optsc.geometry import DepthImage, PinholeCamera, look_at
from optsc.perception import joined_segments, segment_from_pixels, split_at_creases

CAMERA = PinholeCamera.from_field_of_view(320, 240, 0.5)
X_WC = look_at([0.0, 0.0, 0.8], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0])


def seen(height_of):
    """Return the exact image, straight from above, of a surface z(x, y)."""
    rays, z = CAMERA.rays(), np.full((240, 320), 0.8)
    for _ in range(60):  # where the ray meets the surface
        z = 0.5 * z + 0.5 * (0.8 - height_of(rays[..., 0] * z, -rays[..., 1] * z))
    return DepthImage(z, CAMERA, X_WC)


def ball(x, y, centre):
    return np.sqrt(np.maximum(0.04**2 - (x - centre) ** 2 - y**2, 0.0))


def two_balls(x, y):
    return np.maximum(ball(x, y, -0.032), ball(x, y, 0.032))


def above_table(image):
    return image.points()[..., 2] > 0.008


def test_two_balls_that_touch_are_cut_where_they_meet():
    image = seen(two_balls)
    both = segment_from_pixels(image, above_table(image))
    parts = split_at_creases(image, both)
    assert len(parts) == 2
    for part in parts:
        side = np.sign(np.median(part.cloud.points[:, 0]))
        assert (side * part.cloud.points[:, 0] > -0.004).all()
    np.testing.assert_array_equal(parts[0].pixels | parts[1].pixels, both.pixels)
    assert not (parts[0].pixels & parts[1].pixels).any()


def test_a_ball_and_a_ridge_are_convex_and_stay_whole():
    for surface in (lambda x, y: ball(x, y, 0.0), lambda x, y: np.maximum(0.05 - np.abs(x), 0.0)):
        image = seen(surface)
        assert split_at_creases(image, segment_from_pixels(image, above_table(image))) == ()


def test_a_gentle_crease_is_cut_only_if_asked_for():
    image = seen(lambda x, y: 0.03 + 0.3 * np.abs(x))  # a valley whose sides rise by 17 degrees
    mask = np.zeros((240, 320), dtype=bool)
    mask[60:180, 100:220] = True
    valley = segment_from_pixels(image, mask)
    assert split_at_creases(image, valley) == ()
    assert len(split_at_creases(image, valley, crease=0.2)) == 2


def test_parts_joined_again_are_the_whole():
    image = seen(two_balls)
    both = segment_from_pixels(image, above_table(image))
    again = joined_segments(image, split_at_creases(image, both))
    np.testing.assert_array_equal(again.pixels, both.pixels)
    np.testing.assert_allclose(again.cloud.points, both.cloud.points)


def test_normals_of_a_ball_point_away_from_its_centre():
    image = seen(lambda x, y: ball(x, y, 0.0))
    cloud = segment_from_pixels(image, image.points()[..., 2] > 0.02).cloud
    away = cloud.points / np.linalg.norm(cloud.points, axis=1, keepdims=True)
    angle = np.arccos(np.clip(np.einsum("ij,ij->i", away, cloud.normals), -1.0, 1.0))
    assert np.median(angle) < 0.02


def test_pixels_without_depth_are_left_out_and_none_at_all_is_an_empty_segment():
    image = seen(two_balls)
    holed = DepthImage(np.where(np.arange(320) % 2, image.depth, np.nan), CAMERA, X_WC)
    part = segment_from_pixels(holed, above_table(image))
    assert len(part.cloud) == part.pixels.sum() == (above_table(image) & holed.measured).sum()
    empty = segment_from_pixels(image, np.zeros((240, 320), dtype=bool))
    assert len(empty.cloud) == len(joined_segments(image, ()).cloud) == 0
    assert split_at_creases(image, empty) == ()


def test_a_segment_of_one_pixel_has_a_normal_and_no_crease():
    image = seen(two_balls)
    mask = np.zeros((240, 320), dtype=bool)
    mask[120, 160] = True
    one = segment_from_pixels(image, mask)
    np.testing.assert_allclose(np.linalg.norm(one.cloud.normals, axis=1), [1.0])
    assert split_at_creases(image, one) == ()


def test_what_is_no_selection_is_refused_by_name():
    image = seen(two_balls)
    with pytest.raises(InvalidValue, match="pixels"):
        segment_from_pixels(image, np.zeros((2, 2), dtype=bool))
    with pytest.raises(InvalidValue, match="robot_mask"):
        segment_from_pixels(image, above_table(image), robot_mask=np.zeros((240, 320)))
    with pytest.raises(InvalidValue, match="crease"):
        split_at_creases(image, segment_from_pixels(image, above_table(image)), crease=0.0)
