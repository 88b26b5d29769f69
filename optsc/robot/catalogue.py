"""The arms that come with the library: an arm's description, a hand composed onto it, and sourced limits.

Nothing is downloaded: descriptions come from the wheels of example-robot-data and pybullet.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import pi, radians
from pathlib import Path

from numpy.typing import ArrayLike

from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import Pose
from optsc.robot import urdf
from optsc.robot.description import Packages, read_description
from optsc.robot.gripper import PANDA_HAND, Gripper
from optsc.robot.model import RobotModel, model_from_urdf

_ROBOTS = ("example-robot-data", "robots")
_TOOL_FRAME = "panda_hand_tcp"
"""Frame between the pads of the hand that the catalogue's arms carry."""


@dataclass(frozen=True, eq=False)
class _CatalogueEntry:
    description: Callable[[], Path]
    flange: str | None  # link that carries the hand; None where the description has one already
    flange_xyz: tuple[float, float, float]
    flange_rpy: tuple[float, float, float]
    home: tuple[float, ...]
    limits: dict[str, ArrayLike]
    sources: dict[str, str]


_PANDA = _CatalogueEntry(
    description=lambda: urdf.example_robot_data(*_ROBOTS, "panda_description", "urdf", "panda.urdf"),
    flange=None,
    flange_xyz=(0.0, 0.0, 0.0),
    flange_rpy=(0.0, 0.0, 0.0),
    home=(0.0, -pi / 4, 0.0, -3 * pi / 4, 0.0, pi / 2, pi / 4),
    limits={
        "lower": (-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973),
        "upper": (2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973),
        "velocity": (2.1750,) * 4 + (2.6100,) * 3,
        "acceleration": (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0),
        "jerk": (7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0),
    },
    sources={"all": "Franka Control Interface documentation, limits for the Panda"},
)
_UR5 = _CatalogueEntry(
    description=lambda: urdf.example_robot_data(*_ROBOTS, "ur_description", "urdf", "ur5_robot.urdf"),
    flange="tool0",
    flange_xyz=(0.0, 0.0, 0.0),
    flange_rpy=(0.0, 0.0, 0.0),
    home=(-0.2764, -1.7815, 1.5212, -1.3105, -pi / 2, -1.8472),
    limits={
        "velocity": (pi,) * 6,
        "acceleration": (10.0,) * 6,
        "jerk": (5000.0,) * 6,
    },
    sources={
        "position": "the description of ROS-Industrial (elbow within half a turn, the others within one)",
        "velocity": "Universal Robots, UR5 technical specifications: 180 deg/s",
        "acceleration": "tuned here: the maker publishes none",
        "jerk": "tuned here: the maker publishes none",
    },
)
_IIWA = _CatalogueEntry(
    description=lambda: urdf.package_folder("pybullet_data", "kuka_iiwa", "model.urdf"),
    flange="lbr_iiwa_link_7",
    flange_xyz=(0.0, 0.0, 0.045),
    flange_rpy=(0.0, 0.0, pi),  # so that the jaws point as the Panda's do in the same configuration
    home=(0.0, 0.0983, 0.0, -1.7997, 0.0, 1.2436, 0.0),
    limits={
        "lower": tuple(radians(-d) for d in (170, 120, 170, 120, 170, 120, 175)),
        "upper": tuple(radians(d) for d in (170, 120, 170, 120, 170, 120, 175)),
        "velocity": tuple(radians(d) for d in (85, 85, 100, 75, 130, 135, 135)),
        "acceleration": (10.0,) * 7,
        "jerk": (5000.0,) * 7,
    },
    sources={
        "position": "KUKA, LBR iiwa 14 R820 data sheet",
        "velocity": "KUKA, LBR iiwa 14 R820 data sheet",
        "acceleration": "tuned here: the maker publishes none",
        "jerk": "tuned here: the maker publishes none",
    },
)
_XARM7 = _CatalogueEntry(
    description=lambda: urdf.example_robot_data(*_ROBOTS, "xarm_description", "urdf", "xarm7.urdf"),
    flange="link_eef",
    flange_xyz=(0.0, 0.0, 0.0),
    flange_rpy=(0.0, 0.0, 0.0),
    home=(0.0, -0.3858, 0.0, 1.1405, 0.0, 1.5263, 0.0),
    limits={
        "acceleration": (5.0,) * 7,  # joint 2 may load 50 N m, and gravity alone takes up to 39 of them
        "jerk": (2500.0,) * 7,
    },
    sources={
        "position": "the maker's own description (xarm_ros)",
        "velocity": "the maker's own description (xarm_ros)",
        "acceleration": "tuned here",
        "jerk": "tuned here",
    },
)

_ARMS = {"panda": _PANDA, "ur5": _UR5, "iiwa": _IIWA, "xarm7": _XARM7}

ROBOT_NAMES: tuple[str, ...] = tuple(sorted(_ARMS))
"""Names that `load_robot` knows."""


def _composed(name: str, arm: _CatalogueEntry) -> Path:
    root = read_description(arm.description()).root
    if arm.flange is not None:
        hand = urdf.subtree(read_description(_PANDA.description()).root, "panda_hand")
        root = urdf.attach(root, arm.flange, hand, xyz=arm.flange_xyz, rpy=arm.flange_rpy)
    return urdf.store(root, name)


def load_robot(
    name_or_urdf: str | Path,
    tip: str | None = None,
    *,
    gripper: Gripper | None = None,
    home: ArrayLike | None = None,
    limits: dict[str, ArrayLike] | None = None,
    packages: Packages = (),
    locked: Mapping[str, float] | None = None,
    base: Pose | None = None,
    tool: Pose | None = None,
) -> RobotModel:
    """Return an arm of the catalogue (see `ROBOT_NAMES`), or the one of a URDF file.

    Args:
        name_or_urdf: a catalogue name, or the path of a URDF file.
        tip: the tool frame T; needed for a file, by default the gripper's for the catalogue.
        gripper: the jaws at the tip of a URDF file's arm, or at another tip of the catalogue's; by default the
            catalogue's arms have their own hand at their own tip, and none at another.
        home: a configuration (n,) [rad] in place of the catalogue's.
        limits: limits that replace the catalogue's or the file's, see `model_from_urdf`; for example tighter
            operational limits.
        packages: where the packages are that a file's ``package://`` names mean, see `optsc.robot.description`.
        locked: joints that stand still, and where [rad or m]: a second arm, a torso, a joint that is out of order.
        base: where the base stands, X_WB; by default at the origin of W.
        tool: X_FT, pose of the tool in the frame ``tip``; by default they are one.

    Raises:
        UnknownName: no such robot, frame, joint to lock or kind of limit; the message lists those there are.
        InvalidValue: no tip given for a file, or impossible limits.
        DamagedFile: the file cannot be read.
    """
    name = str(name_or_urdf)
    if name in _ARMS:
        arm = _ARMS[name]
        # The hand's jaws are where they are in its own frame; from any other frame they would be seen elsewhere.
        between_pads = tip in (None, _TOOL_FRAME) and tool is None
        return model_from_urdf(
            _composed(name, arm),
            tip or _TOOL_FRAME,
            name=name,
            gripper=PANDA_HAND if gripper is None and between_pads else gripper,
            home=arm.home if home is None else home,
            limits={**arm.limits, **(limits or {})},
            sources=arm.sources,
            locked=locked,
            base=base,
            tool=tool,
        )
    if not name.endswith((".urdf", ".xml")) and not Path(name).exists():
        raise UnknownName("robot", name, ROBOT_NAMES)
    if tip is None:
        raise InvalidValue("tip", tip, "the name of the tool frame in the URDF file")
    return model_from_urdf(
        name, tip, gripper=gripper, home=home, limits=limits, packages=packages, locked=locked, base=base, tool=tool
    )
