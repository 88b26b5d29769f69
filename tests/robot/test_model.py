"""The catalogue, and arms from files."""

import numpy as np
import pinocchio
import pytest

from optsc.errors import DamagedFile, InvalidValue, UnknownName
from optsc.robot import PANDA_HAND, ROBOT_NAMES, gripper, load_robot


@pytest.fixture(params=ROBOT_NAMES)
def robot(request):
    return load_robot(request.param)


def test_every_arm_stands_at_home_with_its_tool_down_in_front_of_it(robot):
    X_WT = robot.forward(robot.home)
    np.testing.assert_allclose(X_WT.rotation_matrix()[:, 2], [0, 0, -1], atol=2e-3)
    assert 0.25 < X_WT.translation[0] < 0.5
    assert abs(X_WT.translation[1]) < 0.05
    assert 0.3 < X_WT.translation[2] < 0.55
    assert np.all((robot.home > robot.limits.lower) & (robot.home < robot.limits.upper))


def test_only_the_arm_moves(robot):
    assert robot.model.nq == robot.model.nv == len(robot.limits) == robot.n
    assert not set(robot.joint_names) & set(robot.gripper.finger_joints)


def test_the_jacobian_is_the_derivative_of_the_pose(robot):
    rng = np.random.default_rng(0)
    q = robot.random_configuration(rng)
    J = robot.jacobian(q)
    for i, step in enumerate(1e-6 * np.eye(robot.n)):
        X, Y = robot.forward(q - step), robot.forward(q + step)
        np.testing.assert_allclose((Y.translation - X.translation) / 2e-6, J[:3, i], atol=1e-7)
        turn = pinocchio.log3(Y.rotation_matrix() @ X.rotation_matrix().T) / 2e-6
        np.testing.assert_allclose(turn, J[3:, i], atol=1e-7)


def test_poses_of_many_configurations_equal_those_of_each(robot):
    q = robot.random_configuration(np.random.default_rng(1), (2, 3))
    X = robot.forward(q)
    assert X.shape == (2, 3)
    assert X[1, 2].almost_equal(robot.forward(q[1, 2]))


def test_the_panda_has_the_makers_limits():
    limits = load_robot("panda").limits
    np.testing.assert_array_equal(limits.velocity, [2.175] * 4 + [2.61] * 3)
    np.testing.assert_array_equal(limits.jerk, [7500, 3750, 5000, 6250, 7500, 10000, 10000])
    np.testing.assert_array_equal(limits.upper, [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973])


def test_the_description_has_no_soft_limits_and_no_package_names(robot):
    text = robot.urdf.read_text()
    assert "safety_controller" not in text
    assert "package://" not in text


def test_unknown_names_are_answered_with_those_there_are():
    with pytest.raises(UnknownName, match="panda"):
        load_robot("pandora")
    with pytest.raises(UnknownName, match="panda_hand_tcp"):
        load_robot(load_robot("panda").urdf, tip="no_such_frame")
    with pytest.raises(UnknownName, match="panda_hand"):
        gripper("two_sticks")


def test_a_file_without_a_tip_or_that_is_no_description_is_refused(tmp_path):
    with pytest.raises(InvalidValue, match="tip"):
        load_robot(load_robot("panda").urdf)
    with pytest.raises(DamagedFile, match="cannot be read"):
        load_robot(tmp_path / "none.urdf", tip="t")
    (tmp_path / "broken.urdf").write_text("<robot")
    with pytest.raises(DamagedFile, match="not XML"):
        load_robot(tmp_path / "broken.urdf", tip="t")
    (tmp_path / "other.urdf").write_text("<html/>")
    with pytest.raises(DamagedFile, match="html"):
        load_robot(tmp_path / "other.urdf", tip="t")


CONTINUOUS = """<robot name="stick"><link name="base"/><link name="arm"/><link name="tool"/>
<joint name="turn" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit effort="1" velocity="2"/></joint>
<joint name="slide" type="prismatic"><parent link="arm"/><child link="tool"/><axis xyz="1 0 0"/>
<limit effort="1" velocity="0.5" lower="0" upper="0.3"/></joint></robot>"""


def test_a_continuous_joint_has_one_number_and_no_end(tmp_path):
    path = tmp_path / "stick.urdf"
    path.write_text(CONTINUOUS)
    robot = load_robot(path, tip="tool")
    assert robot.n == 2
    assert np.isinf(robot.limits.upper[0])
    np.testing.assert_array_equal(robot.limits.bounded, [False, True])
    assert robot.forward([3.5, 0.2]).translation == pytest.approx([0.2 * np.cos(3.5), 0.2 * np.sin(3.5), 0])
    np.testing.assert_allclose(robot.limits.acceleration, robot.limits.velocity / 0.2)


def test_a_description_without_limits_needs_them_from_the_caller(tmp_path):
    path = tmp_path / "stick.urdf"
    path.write_text(CONTINUOUS.replace('<limit effort="1" velocity="2"/>', ""))
    with pytest.raises(InvalidValue, match="velocity"):
        load_robot(path, tip="tool")
    assert load_robot(path, tip="tool", limits={"velocity": [1.0, 0.5]}).n == 2
    path.write_text('<robot name="x"><joint name="j" type="revolute"/></robot>')
    with pytest.raises(DamagedFile):
        load_robot(path, tip="tool")


def test_impossible_limits_are_refused(robot):
    with pytest.raises(InvalidValue, match="velocity"):
        load_robot(robot.name, limits={"velocity": [-1.0] * robot.n})
    with pytest.raises(InvalidValue, match="shape"):
        load_robot(robot.name, limits={"jerk": [1.0]})
    with pytest.raises(InvalidValue, match="factor"):
        robot.limits.tightened(velocity=0.0)


def test_jaws_are_boxes_that_move_by_half_the_opening_each():
    closed, opened = PANDA_HAND.boxes(0.0), PANDA_HAND.boxes(0.08)
    shift = opened - closed
    np.testing.assert_allclose(shift[1:5, :, 1], 0.04)
    np.testing.assert_allclose(shift[5:, :, 1], -0.04)
    assert np.all(closed[:, 0] < closed[:, 1])
    with pytest.raises(InvalidValue, match="opening"):
        PANDA_HAND.boxes(0.2)
