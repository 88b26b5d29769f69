"""Descriptions of others: meshes found where they may be, and what an arm cannot have named in one sentence."""

import numpy as np
import pytest

from optsc.errors import DamagedFile, InvalidValue, UnknownName
from optsc.geometry import Pose, rotation
from optsc.robot import load_robot
from optsc.robot.description import read_description

TETRAHEDRON = (
    """solid t
"""
    + "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in corners)
        + "endloop\nendfacet\n"
        for corners in (
            ((0, 0, 0), (0, 1, 0), (1, 0, 0)),
            ((0, 0, 0), (1, 0, 0), (0, 0, 1)),
            ((0, 0, 0), (0, 0, 1), (0, 1, 0)),
            ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
        )
    )
    + "endsolid t\n"
)


def joint(i, kind="revolute", axis="0 0 1", extra="", limit='<limit lower="-2" upper="2" velocity="1" effort="1"/>'):
    return (
        f'<joint name="j{i}" type="{kind}"><parent link="l{i}"/><child link="l{i + 1}"/>'
        f'<origin xyz="0.1 0.02 0.3" rpy="0.3 -0.2 0.5"/><axis xyz="{axis}"/>{limit}{extra}</joint>'
    )


def arm(joints=None, mesh="", name="stranger", robot="robot"):
    joints = joints or [joint(i, axis=("0 0 1", "0 1 0", "1 0 0")[i % 3]) for i in range(6)]
    shape = f'<{{0}}><geometry><mesh filename="{mesh}"/></geometry></{{0}}>' if mesh else ""
    shapes = shape.format("visual") + shape.format("collision")
    links = "".join(f'<link name="l{i}">{shapes}</link>' for i in range(len(joints) + 1))
    return f'<{robot} name="{name}">{links}{"".join(joints)}</{robot}>'


def written(folder, text, name="arm.urdf"):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(text)
    return folder / name


def meshes_of(robot):
    import pinocchio

    geometry = pinocchio.buildGeomFromUrdf(
        pinocchio.buildModelFromUrdf(str(robot.urdf)), str(robot.urdf), pinocchio.GeometryType.COLLISION
    )
    return len(geometry.geometryObjects)


LAYOUTS = {
    "beside the file": ("mesh.stl", "urdf", "urdf/mesh.stl"),
    "relative, above": ("../meshes/mesh.stl", "urdf", "meshes/mesh.stl"),
    "relative to the package": ("meshes/mesh.stl", "urdf", "meshes/mesh.stl"),
    "package above": (
        "package://arm_description/meshes/mesh.stl",
        "arm_description/urdf",
        "arm_description/meshes/mesh.stl",
    ),
    "package elsewhere in the tree": ("package://arm_meshes/mesh.stl", "arm_description/urdf", "arm_meshes/mesh.stl"),
    "share folder": ("package://arm_meshes/mesh.stl", "share/arm/urdf", "share/arm_meshes/mesh.stl"),
    "model": ("model://arm_meshes/mesh.stl", "arm/urdf", "arm_meshes/mesh.stl"),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_meshes_are_found_in_every_usual_layout(tmp_path, layout):
    mesh, folder, place = LAYOUTS[layout]
    (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / place).write_text(TETRAHEDRON)
    robot = load_robot(written(tmp_path / folder, arm(mesh=mesh)), "l6")
    assert not robot.missing_meshes
    assert meshes_of(robot) == 7


def test_a_package_is_found_by_the_name_in_its_package_xml(tmp_path):
    root = tmp_path / "a-clone-of-it"
    written(root / "meshes", TETRAHEDRON, "mesh.stl")
    written(root, "<package><name>arm_description</name></package>", "package.xml")
    path = written(root / "robots" / "v2", arm(mesh="package://arm_description/meshes/mesh.stl"))
    assert not load_robot(path, "l6").missing_meshes


@pytest.mark.parametrize("given", ["roots", "names", "environment"])
def test_packages_may_be_said_or_come_from_the_environment(tmp_path, monkeypatch, given):
    written(tmp_path / "elsewhere" / "parts" / "meshes", TETRAHEDRON, "mesh.stl")
    path = written(tmp_path / "here", arm(mesh="package://parts/meshes/mesh.stl"))
    packages = ()
    if given == "roots":
        packages = (tmp_path / "elsewhere",)
    elif given == "names":
        packages = {"parts": tmp_path / "elsewhere" / "parts"}
    else:
        monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "elsewhere"))
    assert not load_robot(path, "l6", packages=packages).missing_meshes


def test_a_missing_mesh_is_named_with_where_it_was_looked_for_and_kinematics_work(tmp_path):
    robot = load_robot(written(tmp_path, arm(mesh="package://lost/mesh.stl")), "l6")
    assert {m.kind for m in robot.missing_meshes} == {"visual", "collision"}
    assert "package://lost/mesh.stl of link l0 was not found; looked at" in str(robot.missing_meshes[0])
    assert robot.forward(robot.home).shape == ()
    # Nothing but pictures needs what is to be seen.
    assert not read_description(robot.urdf).root.findall("link/visual")


def test_a_folder_of_packages_that_does_not_exist_is_refused(tmp_path):
    with pytest.raises(InvalidValue, match="packages"):
        load_robot(written(tmp_path, arm()), "l6", packages=("nowhere",))


@pytest.mark.parametrize("name", ["a/b", "../up", "with space", "täuschend"])
def test_any_name_of_a_robot_can_be_stored(tmp_path, name):
    robot = load_robot(written(tmp_path, arm(name=name)), "l6", locked={"j0": 0.1})
    assert robot.urdf.is_file()
    assert robot.name == name


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arm/></robot>', "xacro"),
        ('<mujoco model="a"><worldbody/></mujoco>', "MuJoCo"),
        ('<sdf version="1.7"><model name="a"/></sdf>', "SDF"),
        ("no xml", "XML"),
        ("<html></html>", "robot"),
    ],
)
def test_another_format_is_named(tmp_path, text, says):
    with pytest.raises(DamagedFile, match=says):
        load_robot(written(tmp_path, text), "l6")


def test_an_expanded_template_is_no_template(tmp_path):
    text = arm().replace("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ')
    load_robot(written(tmp_path, "<!-- made from <xacro:arm/> -->" + text), "l6")


@pytest.mark.parametrize(
    ("bad", "says"),
    [
        ({"axis": "0 0 0"}, "axis of joint j2"),
        ({"axis": "0 0"}, "axis of joint j2"),
        ({"extra": '<mimic joint="j1"/>'}, "mimic.*locked"),
        ({"limit": ""}, "velocity limit of joint j2 is 'none'.*limits="),
        ({"limit": '<limit lower="-1" upper="1" velocity="0" effort="1"/>'}, "velocity limit of joint j2"),
        ({"limit": '<limit lower="-1" upper="1" effort="1"/>'}, "velocity limit of joint j2"),
        ({"limit": '<limit lower="one" upper="1" velocity="1" effort="1"/>'}, "lower limit of joint j2"),
        ({"kind": "floating"}, "type of joint j2"),
    ],
)
def test_a_joint_that_no_arm_can_have_is_named(tmp_path, bad, says):
    joints = [joint(i, **(bad if i == 2 else {})) for i in range(6)]
    with pytest.raises(InvalidValue, match=says):
        load_robot(written(tmp_path, arm(joints)), "l6")


def test_a_missing_velocity_may_be_given(tmp_path):
    joints = [joint(i, kind="continuous", limit="") for i in range(6)]
    robot = load_robot(written(tmp_path, arm(joints)), "l6", limits={"velocity": [1.0] * 6})
    assert not robot.limits.bounded.any()


def test_a_mimicking_joint_beside_the_arm_does_not_matter(tmp_path):
    text = arm([*(joint(i) for i in range(7))]).replace('<joint name="j6"', '<joint name="finger"')
    text = (
        text.replace("</robot>", "").replace('<child link="l7"/>', '<child link="l7"/><mimic joint="j1"/>') + "</robot>"
    )
    assert load_robot(written(tmp_path, text), "l6").n == 6


@pytest.mark.parametrize(
    ("limits", "error", "says"),
    [
        ({"velocty": [1.0] * 6}, UnknownName, "did you mean 'velocity'"),
        ({"upper": [180.0] * 6}, InvalidValue, "degrees"),
        ({"velocity": [180.0] * 6}, InvalidValue, "degrees"),
        ({"velocity": [1.0] * 5}, InvalidValue, "shape"),
        ({"velocity": [-1.0] * 6}, InvalidValue, "velocity"),
        ({"velocity": [np.nan] * 6}, InvalidValue, "velocity"),
    ],
)
def test_limits_that_cannot_be_are_refused(tmp_path, limits, error, says):
    with pytest.raises(error, match=says):
        load_robot(written(tmp_path, arm()), "l6", limits=limits)


def test_locked_joints_base_and_tool_give_the_pose_that_the_whole_arm_has(tmp_path):
    rng = np.random.default_rng(4)
    path = written(tmp_path, arm())
    whole = load_robot(path, "l6")
    base, tool = (Pose(rotation.random(rng), rng.normal(size=3)) for _ in range(2))
    part = load_robot(path, "l6", locked={"j1": 0.4, "j4": -0.7}, base=base, tool=tool)
    assert part.joint_names == ("j0", "j2", "j3", "j5")
    for _ in range(20):
        q = part.random_configuration(rng)
        full = np.array([q[0], 0.4, q[1], q[2], -0.7, q[3]])
        assert part.forward(q).almost_equal(base @ whole.forward(full) @ tool, 1e-12)


def test_what_is_locked_or_fixed_must_exist(tmp_path):
    path = written(tmp_path, arm())
    with pytest.raises(UnknownName, match="joint to lock"):
        load_robot(path, "l6", locked={"j9": 0.0})
    with pytest.raises(InvalidValue, match="locked"):
        load_robot(path, "l6", locked={"j1": np.nan})
    with pytest.raises(UnknownName, match="link"):
        load_robot(path, "l9", tool=Pose.identity())


def test_a_link_and_a_joint_may_have_one_name(tmp_path):
    text = arm().replace('"j5"', '"l6"')
    robot, plain = load_robot(written(tmp_path, text), "l6"), load_robot(written(tmp_path, arm(), "plain.urdf"), "l6")
    q = plain.random_configuration(np.random.default_rng(0))
    assert robot.forward(q).almost_equal(plain.forward(q), 1e-12)


def test_a_catalogue_arm_has_its_hand_only_at_its_own_tip():
    assert load_robot("panda").gripper is not None
    assert load_robot("panda", "panda_link8").gripper is None
    shifted = load_robot("panda", tool=Pose.from_quaternion([1, 0, 0, 0], [0, 0, 0.1]))
    assert shifted.gripper is None
    home = shifted.home
    X = load_robot("panda").forward(home)
    np.testing.assert_allclose(shifted.forward(home).translation, X.translation + 0.1 * X.rotation_matrix()[:, 2])


def test_who_needs_a_missing_mesh_says_which_it_is(tmp_path):
    from optsc.collision.link_shapes import LinkShapes

    robot = load_robot(written(tmp_path, arm(mesh="package://lost/mesh.stl")), "l6")
    with pytest.raises(DamagedFile, match=r"package://lost/mesh.stl of link l0.*and 6 more.*packages="):
        LinkShapes(robot)
