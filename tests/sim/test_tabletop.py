import subprocess
import sys

import numpy as np
import pytest

from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import Pose
from optsc.robot import ROBOT_NAMES, load_robot
from optsc.sim import OBJECT_NAMES, Tabletop, object_model, tabletop
from optsc.sim.workspace import HALF_ANGLE, comfortable_band


@pytest.fixture(scope="module")
def panda():
    return load_robot("panda")


def poses(world):
    return {name: np.append(X.translation, X.quaternion).tobytes() for name, X in world.X_WO.items()}


def test_the_same_seed_gives_the_same_poses_and_another_seed_others(panda):
    assert poses(tabletop(panda, seed=3)) == poses(tabletop(panda, seed=3))
    assert poses(tabletop(panda, seed=3)) != poses(tabletop(panda, seed=4))


def test_objects_stand_upright_on_the_table_in_the_order_asked_for(panda):
    world = tabletop(panda, ("box", "mug"), seed=1)
    assert list(world.objects) == list(world.X_WO) == ["box", "mug"]
    for X_WO in world.X_WO.values():
        assert X_WO.translation[2] == 0.0
        np.testing.assert_allclose(X_WO.rotation_matrix()[:, 2], [0.0, 0.0, 1.0], atol=1e-15)


def test_a_hand_fits_between_any_two_objects_and_all_are_in_the_region(panda):
    band = comfortable_band(panda)
    for seed in range(20):
        world = tabletop(panda, OBJECT_NAMES, seed=seed)
        outlines = {n: X.apply(world.objects[n].mesh.vertices)[:, :2] for n, X in world.X_WO.items()}
        for i, first in enumerate(OBJECT_NAMES):
            p = world.X_WO[first].translation[:2]
            assert band.inner <= np.linalg.norm(p) <= band.outer
            assert abs(np.arctan2(p[1], p[0])) <= HALF_ANGLE
            for second in OBJECT_NAMES[:i]:
                assert np.linalg.norm(p - world.X_WO[second].translation[:2]) >= 0.17
                gaps = np.linalg.norm(outlines[first][:, None] - outlines[second], axis=-1)
                assert gaps.min() >= 0.07


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_an_arm_reaches_its_region_from_above_at_its_middle(name):
    robot = load_robot(name)
    band = comfortable_band(robot)
    assert 0.3 <= band.inner < band.outer <= 0.8
    assert band.outer - band.inner >= 0.15
    target = np.array([0.5 * (band.inner + band.outer), 0.0, 0.10])
    q, down = robot.home, np.array([0.0, 0.0, -1.0])
    for _ in range(300):  # position and approach axis by gradient steps, not as the region was found
        X_WT, J = robot.forward(q), robot.jacobian(q)
        turn = np.cross(X_WT.rotation_matrix()[:, 2], down)
        error = np.concatenate([target - X_WT.translation, turn])
        q = robot.limits.clip(q + 0.5 * J.T @ np.linalg.solve(J @ J.T + 1e-3 * np.eye(6), error))
    np.testing.assert_allclose(error, 0.0, atol=1e-3)


def test_an_arm_with_hardly_any_motion_has_no_region():
    home = load_robot("panda").home
    stiff = load_robot("panda", limits={"lower": home - 0.01, "upper": home + 0.01})
    with pytest.raises(InvalidValue, match="reaches the table"):
        tabletop(stiff)


def test_an_unknown_object_is_refused_with_the_names_there_are(panda):
    with pytest.raises(UnknownName, match="banana"):
        tabletop(panda, ("mug", "teapot"))


def test_a_name_twice_or_more_objects_than_fit_are_refused(panda):
    with pytest.raises(InvalidValue, match="each name once"):
        tabletop(panda, ("mug", "mug"))
    with pytest.raises(InvalidValue, match="apart, they do not fit"):
        tabletop(panda, spacing=0.40, objects=OBJECT_NAMES)
    with pytest.raises(InvalidValue, match="spacing"):
        tabletop(panda, spacing=float("nan"))


def test_no_objects_and_objects_of_ones_own_are_allowed(panda):
    assert dict(tabletop(panda, ()).objects) == {}
    assert tabletop(panda, (object_model("can"),)).objects["can"] is object_model("can")


def test_a_tabletop_refuses_objects_without_a_pose_and_cannot_be_changed(panda):
    can = object_model("can")
    with pytest.raises(InvalidValue, match="objects with a pose"):
        Tabletop(panda, {"can": can}, {"mug": Pose.identity()})
    world = Tabletop(panda, {"can": can}, {"can": Pose.identity()})
    with pytest.raises(TypeError):
        world.objects["mug"] = can


@pytest.mark.parametrize("room", ["optsc.sim", "optsc.followers"])
def test_importing_the_room_starts_nothing_heavy(room):
    heavy = ("pybullet", "trimesh", "scipy", "manifold3d", "matplotlib")
    code = f"import sys, {room}; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
