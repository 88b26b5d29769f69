"""Arms of the fault test: those of the catalogue, and a foreign one with endless joints that carries the same hand."""

from __future__ import annotations

from functools import lru_cache
from math import pi

from optsc.errors import UnknownName
from optsc.robot import PANDA_HAND, ROBOT_NAMES, RobotModel, load_robot, urdf
from optsc.robot.description import read_description

FOREIGN = "j2s6s200"
"""Kinova's six-jointed Jaco of the example descriptions: three of its joints turn endlessly, all are slow."""
ARMS = (*ROBOT_NAMES, FOREIGN)
"""Names that `arm` knows."""
DEFAULT_ARMS = ("panda", "ur5", FOREIGN)
"""Seven joints, six joints, and six of which three are endless."""
_FOREIGN_HOME = (1.543, 3.03, 4.813, 3.142, 4.499, 1.543)


@lru_cache(maxsize=8)
def arm(name: str) -> RobotModel:
    """Return the arm of that ``name``; raise `UnknownName`."""
    if name not in ARMS:
        raise UnknownName("arm of the fault test", name, ARMS)
    return _jaco() if name == FOREIGN else load_robot(name)


def _jaco() -> RobotModel:
    folder = urdf.example_robot_data("example-robot-data", "robots")
    panda = read_description(folder / "panda_description" / "urdf" / "panda.urdf").root
    root = read_description(folder / "kinova_description" / "robots" / "kinova.urdf").root
    hand = urdf.subtree(panda, "panda_hand")
    root = urdf.attach(root, "j2s6s200_link_6", hand, xyz=(0.0, 0.0, -0.06), rpy=(pi, 0.0, 0.0))
    return load_robot(urdf.store(root, FOREIGN), "panda_hand_tcp", gripper=PANDA_HAND, home=_FOREIGN_HOME)
