"""Masses of links whose description states none."""

import logging
from xml.etree import ElementTree

import numpy as np
import pinocchio
import pytest

from optsc.robot import load_robot
from optsc.robot.urdf import read_urdf, without
from optsc.sim.follower import PyBulletFollower
from optsc.sim.link_inertia import LEAST_MASS, estimated_inertias, with_inertias
from optsc.sim.tabletop import Tabletop


def without_masses(tmp_path, name, keep=()):
    """The arm with the masses of all links but those in ``keep`` taken out of its description."""
    robot = load_robot(name)
    root = read_urdf(robot.urdf)
    bare = without(root, "inertial")
    for link, full in zip(bare.findall("link"), root.findall("link"), strict=True):
        if link.get("name") in keep:
            link.extend(full.findall("inertial"))
    path = tmp_path / f"{name}.urdf"
    path.write_bytes(ElementTree.tostring(bare))
    arguments = {"gripper": robot.gripper, "home": robot.home}
    for limit in ("velocity", "acceleration", "jerk"):
        arguments.setdefault("limits", {})[limit] = getattr(robot.limits, limit)
    return load_robot(path, robot.tip, **arguments)


def test_a_description_that_states_its_masses_is_left_alone():
    assert not estimated_inertias(load_robot("ur5"))


@pytest.mark.parametrize("name", ["panda", "ur5", "xarm7"])
def test_estimated_masses_are_of_the_size_that_the_maker_states(name, tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        estimated = estimated_inertias(without_masses(tmp_path, name))
    assert "states no mass for" in caplog.text
    stated = pinocchio.buildModelFromUrdf(str(load_robot(name).urdf))
    total = sum(body.mass for body in stated.inertias[1:])
    found = sum(value.mass for value in estimated.values())
    assert 0.6 * total < found < 1.6 * total


def test_estimated_inertias_are_those_of_a_body(tmp_path):
    robot = without_masses(tmp_path, "ur5")
    root = with_inertias(read_urdf(robot.urdf), estimated_inertias(robot))
    path = tmp_path / "whole.urdf"
    path.write_bytes(ElementTree.tostring(root))
    model = pinocchio.buildModelFromUrdf(str(path))
    for body in model.inertias[1:]:
        moments = np.linalg.eigvalsh(body.inertia)
        assert body.mass >= LEAST_MASS
        assert np.all(moments > 0)
        assert moments[2] <= moments[0] + moments[1]  # no body has moments that break the triangle inequality
    for q in (pinocchio.neutral(model), pinocchio.randomConfiguration(model)):
        assert np.all(np.linalg.eigvalsh(pinocchio.crba(model, model.createData(), q)) > 0)


def test_an_arm_without_masses_moves_as_it_is_commanded_and_one_with_some_keeps_them(tmp_path):
    robot = without_masses(tmp_path, "panda", keep=("panda_link1", "panda_link4"))
    assert "panda_link4" not in estimated_inertias(robot)
    world = Tabletop(robot, {}, {})
    with PyBulletFollower(world) as follower:
        q = robot.home.copy()
        for _ in range(250):
            v = np.full(robot.n, 0.2)
            q = q + 0.004 * v
            state = follower.apply(q, v, 0.08, 0.004)
        assert np.abs(state.q - q).max() < 2e-3
