"""Visible surfaces of arms: they sit where the links are, and are coarse."""

import numpy as np
import pytest

import optsc
from optsc.collision.link_visuals import LinkVisuals
from optsc.geometry import Pose
from optsc.robot import ROBOT_NAMES, model_from_urdf

URDF = """<robot name="two">
<link name="base"><visual><geometry><box size="0.2 0.2 0.1"/></geometry></visual></link>
<link name="upper"><visual><origin xyz="0 0 0.2"/><geometry><cylinder radius="0.05" length="0.4"/></geometry>
<material name="red"><color rgba="1 0 0 1"/></material></visual></link>
<link name="tip"><visual><geometry><sphere radius="0.04"/></geometry></visual></link>
<joint name="turn" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit effort="1" velocity="1"/></joint>
<joint name="slide" type="prismatic"><parent link="upper"/><child link="tip"/><origin xyz="0 0 0.4"/>
<axis xyz="0 0 1"/><limit lower="0" upper="0.2" effort="1" velocity="1"/></joint></robot>"""


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_surfaces_of_every_arm_are_coarse_and_the_hand_hangs_at_the_tool(name):
    robot = optsc.load_robot(name)
    visuals = LinkVisuals(robot, cell=0.02)
    assert len(visuals.visuals) >= robot.n
    assert sum(len(visual.mesh.faces) for visual in visuals.visuals) < 12_000
    assert visuals.hand
    # The surfaces of the hand reach the pads and stay near the tool, in any configuration.
    q = robot.random_configuration(np.random.default_rng(1))
    rows = visuals.placements(q, 0.04)
    X_TW = robot.forward(q).inverse()
    in_hand = visuals.in_hand(0.04)
    corners = []
    for k, row in zip(visuals.hand, in_hand, strict=True):
        X_TV = X_TW @ Pose(rows[k, 3:], rows[k, :3])
        np.testing.assert_allclose(X_TV.translation, row[:3], atol=1e-9)
        corners.append(X_TV.rotation_matrix() @ visuals.visuals[k].mesh.vertices.T + X_TV.translation[:, None])
    points = np.hstack(corners)
    assert -0.03 < points[2].max() < 0.03
    assert np.abs(points).max() < 0.25


def test_jaws_move_apart_by_the_opening():
    visuals = LinkVisuals(optsc.load_robot("panda"))
    shift = visuals.in_hand(0.06)[:, :3] - visuals.in_hand(0.02)[:, :3]
    assert sorted(np.round(shift[:, 1], 9).tolist()) == [-0.02, 0.0, 0.02]


def test_plain_shapes_of_an_own_description_are_drawn_where_they_are(tmp_path):
    path = tmp_path / "two.urdf"
    path.write_text(URDF)
    robot = model_from_urdf(path, "tip")
    visuals = LinkVisuals(robot)
    assert [visual.link for visual in visuals.visuals] == ["base", "upper", "tip"]
    assert visuals.visuals[1].colour == (1.0, 0.0, 0.0, 1.0)
    assert visuals.visuals[1].given
    rows = visuals.placements([np.pi / 2, 0.1], 0.0)
    np.testing.assert_allclose(rows[:, :3], [[0, 0, 0], [0.2, 0, 0], [0.5, 0, 0]], atol=1e-9)
    np.testing.assert_allclose(visuals.visuals[1].mesh.extents, [0.1, 0.1, 0.4], atol=2e-3)


def test_clustering_keeps_a_shape_within_its_cell_and_is_coarser():
    mesh = optsc.sim.objects.object_model("mug").mesh
    coarse = mesh.clustered(0.01)
    assert len(coarse.faces) < len(mesh.faces) or len(mesh.faces) < 400
    np.testing.assert_allclose(coarse.extents, mesh.extents, atol=0.01)
    assert len(mesh.clustered(10.0).faces) == len(mesh.faces)
