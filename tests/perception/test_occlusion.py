import numpy as np
import pytest

from optsc.errors import InvalidValue
from optsc.geometry import DepthImage, PinholeCamera, Pose, look_at
from optsc.perception import robot_depth, robot_mask, view_is_clear
from optsc.perception.occlusion import capsules_at
from optsc.robot import load_robot
from optsc.sim import Tabletop
from optsc.sim.camera import DepthCamera

SMALL = PinholeCamera.from_field_of_view(160, 120, 0.9)
LARGE = PinholeCamera.from_field_of_view(640, 480, 0.9)
X_WC = look_at([1.4, 0.5, 0.7], [0.25, 0.0, 0.4])


@pytest.fixture(scope="module")
def robot():
    return load_robot("panda")


def configurations(robot, count):
    return robot.limits.clip(robot.home + np.random.default_rng(0).normal(0.0, 0.6, (count, robot.n)))


def a_ball_hides(camera, centre, radius):
    """Return the depth of a ball (H, W) by its own formula; infinite beside it."""
    rays = camera.rays()
    square, along = (rays**2).sum(axis=-1), rays @ np.asarray(centre)
    root = along**2 - square * (np.dot(centre, centre) - radius**2)
    return np.where(root >= 0.0, (along - np.sqrt(np.maximum(root, 0.0))) / square, np.inf)


def known(rows, columns, depth):
    """Return a silhouette and the image in which it was seen at ``depth``, all else 2 m away."""
    silhouette = np.zeros((120, 160), dtype=bool)
    silhouette[rows, columns] = True
    return silhouette, DepthImage(np.where(silhouette, depth, 2.0), SMALL, Pose.identity())


OBJECT, SEEN = known(slice(50, 70), slice(70, 90), 1.0)


def verdict(rows, columns, depth, **settings):
    arm = np.full((120, 160), np.inf)
    arm[rows, columns] = depth
    return view_is_clear(OBJECT, arm, SEEN, **settings)


def test_the_capsules_end_where_the_arm_s_joints_put_them(robot):
    from optsc.collision.capsules import link_capsules

    capsules = link_capsules(robot)
    for q in configurations(robot, 5):
        ends, radius = capsules_at(robot, q)
        np.testing.assert_array_equal(radius, capsules.radius)
        # The hand is fixed to the last joint: its capsules move with the tip.
        X_WT, X_WT0 = robot.forward(q), robot.forward(robot.home)
        home, _ = capsules_at(robot, robot.home)
        hand = capsules.joint == robot.n - 1
        np.testing.assert_allclose(X_WT.inverse().apply(ends[hand]), X_WT0.inverse().apply(home[hand]), atol=1e-9)
        still = capsules.joint < 0
        np.testing.assert_allclose(ends[still], capsules.ends[still])


@pytest.mark.parametrize("name", ["panda", "ur5", "iiwa", "xarm7"])
def test_no_pixel_of_the_arm_is_missed_and_none_is_nearer_than_said(name):
    robot = load_robot(name)
    for camera in (SMALL, LARGE):
        with DepthCamera(Tabletop(robot, {}, {}), X_WC, camera) as looking:
            for q in configurations(robot, 2):
                view = looking.capture(q)
                arm, depth = view.pixels_of("arm"), robot_depth(robot, q, camera, X_WC)
                assert arm.sum() > 500
                assert (depth[arm] <= view.true_depth[arm]).all()
                assert robot_mask(robot, q, view.image)[arm].all()


def test_the_predicted_arm_is_not_much_larger_than_the_arm(robot):
    with DepthCamera(Tabletop(robot, {}, {}), X_WC, LARGE) as looking:
        view = looking.capture(robot.home)
    arm = view.pixels_of("arm").sum()
    assert np.isfinite(robot_depth(robot, robot.home, LARGE, X_WC)).sum() < 2.0 * arm
    assert robot_mask(robot, robot.home, view.image).sum() < 1.5 * arm


def test_a_coarse_grid_never_promises_more_than_a_fine_one(robot):
    fine = PinholeCamera(160, 120, LARGE.fx / 4, LARGE.fy / 4, (LARGE.cx - 1.5) / 4, (LARGE.cy - 1.5) / 4)
    exact = robot_depth(robot, robot.home, fine, X_WC)  # its rays are those of the large image's cells
    for row in range(4):
        for column in range(4):
            coarse = robot_depth(robot, robot.home, LARGE, X_WC)[row::4, column::4]
            assert (coarse <= exact + 1e-9).all()


def test_a_thicker_arm_hides_more_and_an_arm_behind_the_camera_nothing(robot):
    thin, thick = (robot_depth(robot, robot.home, SMALL, X_WC, margin=m) for m in (0.0, 0.05))
    assert (thick <= thin).all()
    assert np.isfinite(thick).sum() > np.isfinite(thin).sum() > 0
    away = look_at([1.4, 0.5, 0.7], [2.4, 1.0, 0.7])
    assert np.isinf(robot_depth(robot, robot.home, SMALL, away)).all()


def test_a_camera_inside_the_arm_sees_nothing_else(robot):
    inside = capsules_at(robot, robot.home)[0][3].mean(axis=0)
    depth = robot_depth(robot, robot.home, SMALL, look_at(inside, inside + [1.0, 0.0, 0.0]))
    np.testing.assert_array_equal(depth, 0.0)


def test_a_capsule_without_length_is_a_ball():
    from optsc.perception.occlusion import _inside

    centre, rays = np.array([0.05, -0.03, 0.9]), SMALL.rays()
    entry, leaving = _inside(rays[0, :, 0], rays[:, 0, 1], centre, centre, 0.1)
    expected = a_ball_hides(SMALL, centre, 0.1)
    np.testing.assert_allclose(entry, expected)
    # The middle of a chord is where the ray is nearest to the centre.
    hit = np.isfinite(entry)
    assert hit.sum() > 100
    nearest = (rays @ centre / (rays**2).sum(axis=-1))[hit]
    np.testing.assert_allclose(0.5 * (entry + np.where(hit, leaving, 0.0))[hit], nearest)


def test_what_was_measured_beside_and_behind_the_arm_is_not_the_arm(robot):
    depth = robot_depth(robot, robot.home, SMALL, X_WC)
    for offset in (-0.3, 0.6):
        somewhere = DepthImage(np.where(np.isfinite(depth), depth + offset, 2.0), SMALL, X_WC)
        assert not robot_mask(robot, robot.home, somewhere).any()
    nothing = DepthImage(np.full((120, 160), np.nan), SMALL, X_WC)
    assert not robot_mask(robot, robot.home, nothing).any()


def test_an_arm_in_front_of_an_object_hides_it():
    assert verdict(slice(0, 60), slice(0, 160), 0.6) == (False, 0.5)
    assert verdict(slice(0, 120), slice(0, 160), 0.6) == (False, 1.0)
    assert verdict(slice(50, 51), slice(70, 71), 0.6) == (False, 1.0 / 400.0)


def test_an_arm_far_behind_an_object_leaves_it_clear():
    assert verdict(slice(0, 120), slice(0, 160), 1.2) == (True, 0.0)


def test_an_arm_that_touches_an_object_from_behind_is_not_trusted_to_be_behind():
    assert not verdict(slice(0, 120), slice(0, 160), 1.005).clear


def test_an_arm_beside_an_object_leaves_it_clear_from_the_halo_on():
    pixels = int(np.ceil(0.01 * SMALL.fx / 1.0))  # 1 cm at 1 m
    right = 89  # the object's last column
    assert verdict(slice(0, 120), slice(right + pixels + 1, 160), 0.6) == (True, 0.0)
    assert verdict(slice(0, 120), slice(right + pixels, 160), 0.6) == (False, 0.0)
    assert verdict(slice(0, 120), slice(right + 1, 160), 0.6, halo=0.0) == (True, 0.0)


def test_of_an_object_without_measured_depth_the_arm_is_never_behind():
    unknown = DepthImage(np.where(OBJECT, np.nan, 2.0), SMALL, Pose.identity())
    assert view_is_clear(OBJECT, np.full((120, 160), 5.0), unknown) == (False, 1.0)
    assert view_is_clear(OBJECT, np.full((120, 160), np.inf), unknown) == (True, 0.0)


def test_an_object_that_was_nowhere_is_not_clear():
    assert view_is_clear(np.zeros_like(OBJECT), np.full((120, 160), np.inf), SEEN) == (False, 1.0)


def test_an_object_at_the_edge_of_the_image_and_of_one_pixel_is_judged_alike():
    corner, image = known(slice(0, 1), slice(0, 1), 1.0)
    arm = np.full((120, 160), np.inf)
    assert view_is_clear(corner, arm, image) == (True, 0.0)
    arm[0, 1] = 0.5
    assert view_is_clear(corner, arm, image) == (False, 0.0)


def test_the_real_arm_in_front_hides_beside_does_not(robot):
    with DepthCamera(Tabletop(robot, {}, {}), X_WC, SMALL) as looking:
        view = looking.capture(robot.home)
    depth = robot_depth(robot, robot.home, SMALL, X_WC)
    rows, columns = np.nonzero(view.pixels_of("arm"))
    at = np.zeros((120, 160), dtype=bool)
    at[rows[len(rows) // 2], columns[len(rows) // 2]] = True
    behind = DepthImage(np.where(at, 3.0, view.image.depth), SMALL, X_WC)
    assert not view_is_clear(at, depth, behind).clear
    before = DepthImage(np.where(at, 0.4, view.image.depth), SMALL, X_WC)
    assert view_is_clear(at, depth, before).clear


def test_what_cannot_be_judged_is_refused_by_name(robot):
    arm = np.full((120, 160), np.inf)
    for field, arguments in (
        ("silhouette", (OBJECT[:5], arm, SEEN)),
        ("robot_depth", (OBJECT, arm[:5], SEEN)),
    ):
        with pytest.raises(InvalidValue, match=field):
            view_is_clear(*arguments)
    with pytest.raises(InvalidValue, match="halo"):
        view_is_clear(OBJECT, arm, SEEN, halo=-1.0)
    with pytest.raises(InvalidValue, match="margin"):
        robot_depth(robot, robot.home, SMALL, X_WC, margin=np.nan)
    with pytest.raises(InvalidValue, match="q"):
        robot_depth(robot, robot.home[:-1], SMALL, X_WC)
    with pytest.raises(InvalidValue, match="X_WC"):
        robot_depth(robot, robot.home, SMALL, Pose.identity((3,)))
