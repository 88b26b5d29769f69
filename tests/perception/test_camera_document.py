"""What the first half of docs/perception.md says: its formulas, its numbers and its code."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from optsc.geometry import DepthImage, PinholeCamera, Pose
from optsc.perception import load_depth_image, occlusion, segments
from optsc.perception.depth_files import FARTHEST, NEAREST, write_png16
from optsc.perception.segmentation import SegmentationSettings
from optsc.perception.segments import normals_in_image
from optsc.perception.table import LARGEST_TILT
from optsc.robot import load_robot
from optsc.sim import Tabletop, object_model
from optsc.sim import camera as sim_camera
from optsc.sim.clutter import AREA_RADIUS
from optsc.sim.depth_noise import DepthNoise
from optsc.sim.follower import PyBulletFollower

PAGE = (Path(__file__).parents[2] / "docs" / "perception.md").read_text()
CAMERA = PinholeCamera(320, 240, 310.0, 330.0, 140.3, 128.9)


def test_a_point_is_seen_and_found_again_as_the_page_says():
    x, y, z = 0.2, -0.1, 0.8
    u, v, depth = CAMERA.project([x, y, z])
    assert (u, v, depth) == pytest.approx((140.3 + 310.0 * x / z, 128.9 + 330.0 * y / z, z))
    point = CAMERA.backproject(np.full((240, 320), z))[20, 30]
    assert point == pytest.approx(np.array([(30 - 140.3) / 310.0, (20 - 128.9) / 330.0, 1.0]) * z)
    assert PinholeCamera.from_field_of_view(640, 480, 0.8).cx == (640 - 1) / 2


def test_the_projection_has_the_rows_of_the_page():
    matrix = sim_camera._projection(CAMERA)
    c = CAMERA
    assert matrix[0] == pytest.approx([2 * c.fx / 320, 0, 1 - 2 * c.cx / 320, 0])
    assert matrix[1] == pytest.approx([0, 2 * c.fy / 240, 2 * (c.cy + 1) / 240 - 1, 0])
    n, f = sim_camera.NEAR, sim_camera.FAR
    assert (n, f) == (0.05, 10.0)
    for z in (0.1, 0.7, 3.0):  # OpenGL: the buffer holds half of 1 + z/w, and the camera looks along -z
        d = 0.5 + 0.5 * (matrix[2] @ [0, 0, -z, 1]) / (matrix[3] @ [0, 0, -z, 1])
        assert 2 * n * f / (f + n - (2 * d - 1) * (f - n)) == pytest.approx(z)


def test_noise_is_that_of_the_page():
    noise = DepthNoise()
    for z, theta in ((0.5, 0.0), (1.0, 0.7), (2.0, 1.2)):
        expected = 0.0012 + 0.0019 * (z - 0.4) ** 2 + 0.0001 / np.sqrt(z) * theta**2 / (np.pi / 2 - theta) ** 2
        assert noise.sigma(np.array(z), theta) == pytest.approx(expected)
    assert noise.sigma(np.array(0.6)) == pytest.approx(1.3e-3, abs=0.05e-3)
    assert noise.sigma(np.array(1.0)) == pytest.approx(1.9e-3, abs=0.05e-3)
    slanted = noise.sigma(np.array(1.0), np.pi / 4) - noise.sigma(np.array(1.0))
    assert slanted == pytest.approx(0.1e-3)
    assert np.degrees(noise.steepest) == pytest.approx(80.0, abs=0.5)
    assert (noise.edge_loss, noise.speckle, noise.quantum) == (0.8, 0.002, 1e-3)


def test_numbers_of_the_page_are_those_of_the_code():
    settings = SegmentationSettings()
    assert (settings.lowest, settings.gap, settings.pixels, settings.reach) == (0.008, 0.008, 4.0, 0.6)
    assert (settings.smallest, settings.largest, settings.normal_window) == (60, 0.5, 7)
    assert (LARGEST_TILT, FARTHEST, NEAREST, AREA_RADIUS) == (0.05, 50.0, 0.02, 0.16)
    assert (occlusion.MARGIN, occlusion.HALO, occlusion.BEHIND, occlusion.CELLS) == (0.01, 0.01, 0.01, 20_000)
    assert (segments.CREASE, segments.CREASE_WIDTH) == (0.5, 0.010)
    assert np.degrees(np.arcsin(segments.CREASE)) == pytest.approx(30.0)


def test_inverse_depth_of_a_plane_is_linear_and_gives_its_normal():
    normal, d = np.array([0.3, -0.5, -0.9]) / np.linalg.norm([0.3, -0.5, -0.9]), -0.7
    rays = CAMERA.rays()
    depth = d / (rays @ normal)
    points = CAMERA.backproject(depth)
    np.testing.assert_allclose(points @ normal, d)
    np.testing.assert_allclose(1.0 / depth, (rays @ normal) / d)
    part = (slice(100, 140), slice(50, 90))
    mask = np.ones((40, 40), dtype=bool)
    found = normals_in_image(depth[part], mask, CAMERA, (100, 50), 7)
    np.testing.assert_allclose(found, np.broadcast_to(normal, (1600, 3)), atol=1e-8)


def test_a_ray_meets_a_ball_where_the_page_says():
    c, r = np.array([0.05, -0.03, 0.9]), 0.1
    ray = np.array([0.08, -0.01, 1.0])
    entry, leaving = occlusion._inside(ray[:1], ray[1:2], c, c, r)
    root = np.sqrt((ray @ c) ** 2 - ray @ ray * (c @ c - r**2))
    assert entry[0, 0] == pytest.approx((ray @ c - root) / (ray @ ray))
    assert leaving[0, 0] == pytest.approx((ray @ c + root) / (ray @ ray))
    assert np.linalg.norm(entry[0, 0] * ray - c) == pytest.approx(r)


def test_a_capsule_is_met_where_its_surface_is():
    a, b, r = np.array([-0.1, 0.02, 0.7]), np.array([0.15, -0.05, 1.1]), 0.06
    right, down = np.linspace(-0.3, 0.3, 41), np.linspace(-0.2, 0.2, 31)
    entry, leaving = occlusion._inside(right, down, a, b, r)
    rays = np.stack([*np.meshgrid(right, down), np.ones((31, 41))], axis=-1)

    def distance(points):
        t = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        return np.linalg.norm(points - a - t[..., None] * (b - a), axis=-1)

    hit = np.isfinite(entry)
    assert 50 < hit.sum() < hit.size
    for depth in (entry, leaving):
        np.testing.assert_allclose(distance(rays[hit] * depth[hit][:, None]), r, atol=1e-9)
    along = np.linspace(0.3, 1.5, 400)
    closest = np.min([distance(rays * z) for z in along], axis=0)
    assert (closest[~hit] > r - 1e-9).all()


def test_no_pixel_of_a_cell_is_farther_from_its_middle_than_delta():
    for camera in (
        PinholeCamera.from_field_of_view(640, 480, 0.75),
        PinholeCamera(1280, 720, 900.0, 950.0, 640.0, 300.0),
    ):
        k, (rows, columns) = occlusion._grid(camera)
        assert rows * columns <= 1.02 * occlusion.CELLS
        delta = k / 2 * np.sqrt(1 / camera.fx**2 + 1 / camera.fy**2)
        offset = (np.arange(k) - (k - 1) / 2)[:, None]
        assert np.hypot(offset / camera.fx, offset.T / camera.fy).max() <= delta


def test_the_recorded_image_of_the_page_can_be_loaded(tmp_path):
    (text,) = re.findall(r"```json\n(.*?)```", PAGE, re.DOTALL)
    (tmp_path / "view.json").write_text(text)
    write_png16(tmp_path / "view.png", np.full((480, 640), 750, dtype=np.uint16))
    image = load_depth_image(tmp_path / "view.png")
    assert image.depth[7, 9] == pytest.approx(0.75)
    assert json.loads(text)["camera"]["fx"] == image.camera.fx
    assert image.X_WC.translation.tolist() == [0.0, 0.0, 1.0]


def test_the_code_of_the_page_runs():
    (code,) = (b for b in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL) if "DepthCamera(world)" in b)
    robot = load_robot("panda")
    world = Tabletop(robot, {"can": object_model("can")}, {"can": Pose.from_translation([0.5, 0.0, 0.0])})
    with PyBulletFollower(world) as follower:
        names = {"world": world, "q": robot.home, "follower": follower, "np": np}
        names |= {"DepthCamera": sim_camera.DepthCamera, "rng": np.random.default_rng(0)}
        exec(code, names)
    names["camera"].close()
    assert isinstance(names["view"].image, DepthImage)
