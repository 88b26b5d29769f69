"""Robot models: kinematics, limits, grippers, the catalogue, compiled kernels, collision geometry."""

from optsc.robot.catalogue import ROBOT_NAMES, load_robot
from optsc.robot.gripper import PANDA_HAND, Gripper, gripper
from optsc.robot.limits import JointLimits
from optsc.robot.model import RobotModel, model_from_urdf

__all__ = [
    "PANDA_HAND",
    "ROBOT_NAMES",
    "Gripper",
    "JointLimits",
    "RobotModel",
    "gripper",
    "load_robot",
    "model_from_urdf",
]
