import numpy as np
import pytest

from optsc.errors import InvalidValue
from optsc.geometry import PinholeCamera
from optsc.sim.depth_noise import DepthNoise, measured_depth

CAMERA = PinholeCamera.from_field_of_view(320, 240, 0.75)
WITHOUT_LOSS = {"edge_loss": 0.0, "speckle": 0.0}


def plane(depth, slant=0.0):
    """Return the depths of a plane whose normal is turned by ``slant`` against the optical axis."""
    right = (np.arange(320) - CAMERA.cx) / CAMERA.fx
    return np.broadcast_to(depth / (1.0 - np.tan(slant) * right), (240, 320)).copy()


def rng():
    return np.random.default_rng(0)


@pytest.mark.parametrize("depth", [0.5, 1.0, 2.0, 3.0])
def test_noise_on_a_wall_has_the_published_deviation(depth):
    noise = DepthNoise(**WITHOUT_LOSS, quantum=0.0)
    error = measured_depth(plane(depth), CAMERA, noise, rng()) - depth
    assert error.std() == pytest.approx(0.0012 + 0.0019 * (depth - 0.4) ** 2, rel=0.02)
    assert abs(error.mean()) < 4.0 * error.std() / np.sqrt(error.size)


def test_noise_grows_with_depth_and_with_slant():
    noise = DepthNoise()
    assert (np.diff(noise.sigma(np.linspace(0.4, 4.0, 20))) > 0.0).all()
    assert (np.diff(noise.sigma(np.full(20, 1.0), np.linspace(0.0, 1.5, 20))) > 0.0).all()
    assert noise.sigma(np.array(1.0), 1.2) == pytest.approx(
        0.0012 + 0.0019 * 0.6**2 + 0.0001 * 1.2**2 / (0.5 * np.pi - 1.2) ** 2
    )


def test_depths_are_whole_millimetres():
    depth = measured_depth(plane(1.0), CAMERA, DepthNoise(), rng())
    measured = depth[~np.isnan(depth)]
    np.testing.assert_allclose(1e3 * measured, np.round(1e3 * measured), atol=1e-9)


def test_pixels_are_lost_at_the_edges_of_objects_and_nowhere_else():
    depth = plane(1.0)
    depth[80:160, 100:200] = 0.7
    noise = DepthNoise(speckle=0.0)
    lost = np.isnan(measured_depth(depth, CAMERA, noise, rng()))
    beside = np.zeros(lost.shape, dtype=bool)
    beside[79:161, 99:201] = True
    beside[81:159, 101:199] = False
    corners = np.ix_([79, 160], [99, 200])
    beside[corners] = False  # a corner's neighbours are all outside
    assert not (lost & ~beside).any()
    assert lost[beside].mean() == pytest.approx(noise.edge_loss, abs=0.08)


def test_a_slanted_surface_is_measured_up_to_the_steepest_angle_and_not_beyond():
    noise = DepthNoise(**WITHOUT_LOSS, steepest=1.2)
    assert not np.isnan(measured_depth(plane(1.0, 1.0), CAMERA, noise, rng())[:, 150:170]).any()
    assert np.isnan(measured_depth(plane(1.0, 1.3), CAMERA, noise, rng())[:, 150:170]).all()


def test_nothing_is_measured_out_of_range_nor_where_there_is_nothing():
    for depth in (0.1, 6.0, np.nan):
        assert np.isnan(measured_depth(plane(1.0) * depth, CAMERA, DepthNoise(), rng())).all()


def test_without_errors_depths_are_exact_also_in_an_image_of_one_pixel():
    depth = plane(1.0)
    depth[80:160, 100:200] = 0.7
    np.testing.assert_array_equal(measured_depth(depth, CAMERA, DepthNoise.none(), rng()), depth)
    one = PinholeCamera(1, 1, 300.0, 300.0, 0.0, 0.0)
    assert measured_depth(np.array([[0.8]]), one, DepthNoise.none(), rng()) == 0.8


@pytest.mark.parametrize(
    "change",
    [
        {"floor": -1.0},
        {"growth": np.nan},
        {"edge_loss": 1.5},
        {"speckle": -0.1},
        {"steepest": 0.0},
        {"farthest": 0.1},
    ],
)
def test_what_is_no_noise_is_refused_by_name(change):
    with pytest.raises(InvalidValue, match=f"DepthNoise.{next(iter(change))}"):
        DepthNoise(**change)
