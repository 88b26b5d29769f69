import numpy as np
import pytest

from optsc.errors import Closed, InvalidValue, UnknownName
from optsc.geometry import PinholeCamera, Pose, look_at
from optsc.robot import load_robot
from optsc.sim import Tabletop, object_model
from optsc.sim.bullet_bodies import FLOOR_HEIGHT
from optsc.sim.camera import DepthCamera, view_of_table
from optsc.sim.physics import Physics

SMALL = PinholeCamera.from_field_of_view(320, 240, 0.75)
SKEWED = PinholeCamera(320, 240, 310.0, 330.0, 140.3, 128.9)
X_WO = {
    "box": Pose.from_rotation_vector([0.0, 0.0, 0.5], [0.50, 0.10, 0.0]),
    "mug": Pose.from_rotation_vector([0.5 * np.pi, 0.0, 0.0], [0.45, -0.15, 0.034]),  # lying
}


@pytest.fixture(scope="module")
def world():
    return Tabletop(load_robot("panda"), {name: object_model(name) for name in X_WO}, X_WO)


@pytest.fixture(scope="module")
def camera(world):
    with DepthCamera(world, camera=SMALL) as camera:
        yield camera


def hits(name, origin, rays):
    """Return how many times ``rays`` (N, 3) fit between ``origin`` and the first surface: Moeller-Trumbore."""
    mesh, X_OW = object_model(name).mesh, X_WO[name].inverse()
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    start, rays = X_OW.apply(origin), rays @ X_OW.rotation_matrix().T
    p = np.cross(rays[:, None], c - a)
    determinant = np.einsum("nfi,fi->nf", p, b - a)
    q = np.cross(start - a, b - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("nfi,fi->nf", p, start - a) / determinant
        v = np.einsum("ni,fi->nf", rays, q) / determinant
        t = np.einsum("fi,fi->f", q, c - a) / determinant
    return np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf).min(axis=1)


@pytest.mark.parametrize("intrinsics", [SMALL, SKEWED], ids=["symmetric", "skewed"])
@pytest.mark.parametrize("eye", [(1.1, 0.3, 0.6), (0.5, -0.6, 0.9), (0.2, 0.4, 1.3)])
def test_every_pixel_lies_on_the_surface_that_it_shows(world, intrinsics, eye):
    with DepthCamera(world, look_at(eye, [0.5, 0.0, 0.05]), intrinsics) as camera:
        view = camera.capture(world.robot.home)
    points = view.image.points()
    # The usual half pixel would be off by 1 to 2 mm here.
    assert np.abs(points[view.pixels_of("table")][:, 2]).max() < 1e-5
    assert np.abs(points[view.pixels_of("floor")][:, 2] - FLOOR_HEIGHT).max(initial=0.0) < 1e-4
    for name in X_WO:
        shown = view.pixels_of(name)
        assert shown.sum() > 200
        rays = intrinsics.rays()[shown][::7] @ view.image.X_WC.rotation_matrix().T
        off = np.abs(hits(name, view.image.X_WC.translation, rays) - view.image.depth[shown][::7])
        assert np.quantile(off, 0.98) < 1e-5  # a ray may pass just beside an edge that the renderer hits


def test_the_sides_of_a_box_are_where_they_are(camera, world):
    view = camera.capture(world.robot.home)
    shown = X_WO["box"].inverse().apply(view.image.points()[view.pixels_of("box")])
    low, high = object_model("box").mesh.vertices.min(axis=0), object_model("box").mesh.vertices.max(axis=0)
    off = np.abs(np.concatenate([shown - low, high - shown], axis=1)).min(axis=1)
    assert np.median(off) < 1e-6
    assert off.max() < 0.6e-3  # its chamfered edges cut the corners


def test_labels_tell_the_table_the_arm_and_the_objects_apart(camera, world):
    view = camera.capture(world.robot.home)
    assert view.names == ("table", "floor", "arm", "box", "mug")
    assert all(view.pixels_of(name).sum() > 200 for name in ("table", "arm", "box", "mug"))
    np.testing.assert_array_equal(np.isnan(view.true_depth), view.labels < 0)
    with pytest.raises(UnknownName, match="teapot"):
        view.pixels_of("teapot")


def test_an_object_is_seen_where_it_is_put_and_the_arm_where_its_posture_puts_it(camera, world):
    home = camera.capture(world.robot.home)
    moved = camera.capture(world.robot.home, X_WO={"box": Pose.from_translation([0.4, 0.2, 0.0])})
    assert (home.pixels_of("box") != moved.pixels_of("box")).sum() > 200
    np.testing.assert_array_equal(home.pixels_of("mug"), moved.pixels_of("mug"))
    bent = camera.capture(world.robot.home + [0.0, 0.6, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert (home.pixels_of("arm") != bent.pixels_of("arm")).sum() > 100


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(camera, world):
    first, again, other = (
        camera.capture(world.robot.home, rng=np.random.default_rng(seed)).image.depth for seed in (1, 1, 2)
    )
    assert first.tobytes() == again.tobytes() != other.tobytes()


def test_a_running_simulation_is_seen_as_it_is_and_is_not_disturbed(camera, world):
    with Physics(world) as physics:
        for _ in range(20):
            physics.step(world.robot.home.tolist(), [0.0] * world.robot.n, 0.04)
        q, _ = physics.joints()
        poses = physics.poses()
        seen = camera.capture_running(physics)
        assert seen.image.stamp == physics.time == pytest.approx(0.02)
        expected = camera.capture(q, physics.opening(), poses)
        np.testing.assert_array_equal(seen.image.depth, expected.image.depth)
        assert physics.poses()["box"].translation.tobytes() == poses["box"].translation.tobytes()


def test_the_unhidden_share_of_an_object_is_one_in_the_open_and_falls_behind_another(camera, world):
    view = camera.capture(world.robot.home)
    assert camera.unhidden_shares(view) == pytest.approx({"box": 1.0, "mug": 1.0}, abs=0.01)
    behind = X_WO["box"].translation + 0.09 * (X_WO["box"].translation - camera.X_WC.translation) * [1, 1, 0]
    moved = {"mug": Pose.from_translation([*behind[:2], 0.0])}
    hidden = camera.capture(world.robot.home, X_WO=moved)
    shares = camera.unhidden_shares(hidden, moved)
    assert shares["box"] == pytest.approx(1.0, abs=0.01)
    assert 0.0 < shares["mug"] < 0.6
    outside = {"mug": Pose.from_translation([-5.0, 0.0, 0.0])}
    assert camera.unhidden_shares(camera.capture(world.robot.home, X_WO=outside), outside)["mug"] == 0.0


def test_the_view_of_the_table_has_the_workspace_in_the_middle(world):
    X_WC = view_of_table(world.robot)
    assert X_WC.translation[2] > 0.3
    u, v, _ = SMALL.project(X_WC.inverse().apply([[0.4, 0.0, 0.05], [0.6, 0.2, 0.05], [0.6, -0.2, 0.05]]))
    assert ((u > 0) & (u < 319) & (v > 0) & (v < 239)).all()


def test_what_cannot_be_looked_at_is_refused(camera, world):
    with pytest.raises(InvalidValue, match="q"):
        camera.capture(world.robot.home[:-1])
    with pytest.raises(InvalidValue, match="single configuration"):
        camera.capture(world.robot.home[None])
    with pytest.raises(UnknownName, match="teapot"):
        camera.capture(world.robot.home, X_WO={"teapot": Pose.identity()})
    with pytest.raises(InvalidValue, match="distance"):
        view_of_table(world.robot, distance=0.0)


def test_a_closed_camera_says_so(world):
    camera = DepthCamera(world, camera=SMALL)
    camera.close()
    camera.close()
    with pytest.raises(Closed):
        camera.capture(world.robot.home)
