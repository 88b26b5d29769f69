"""Parallel-jaw grippers as boxes that move with the opening."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optsc.errors import InvalidValue, UnknownName
from optsc.geometry.rotation import Array


@dataclass(frozen=True, eq=False)
class Gripper:
    """A parallel-jaw gripper in its tool frame T: z is the approach axis, the jaws close along y.

    The origin of T lies between the pads. A half turn about z is the same grasp (`jaw_symmetric`).

    Attributes:
        name: key under which grasps made for it are stored.
        max_opening: greatest distance between the pads [m].
        pad_size: extent of a pad along x and z [m].
        body: boxes that do not move with the jaws (N, 2, 3): lower and upper corners in T [m].
        finger: boxes of the jaw on the +y side when the pads touch (N, 2, 3), in T [m]; the other is its mirror.
        finger_joints: joint names of the two jaws in the robot's URDF; each moves by half the opening.
        jaw_symmetric: whether a half turn about z gives the same grasp.
    """

    name: str
    max_opening: float
    pad_size: tuple[float, float]
    body: Array
    finger: Array
    finger_joints: tuple[str, str]
    jaw_symmetric: bool = True

    def boxes(self, opening: float) -> Array:
        """Return all boxes (N, 2, 3) in T [m] when the pads are ``opening`` [m] apart; raise `InvalidValue`."""
        if not 0.0 <= opening <= self.max_opening + 1e-9:
            raise InvalidValue("gripper opening", opening, f"0 to {self.max_opening} m")
        shift = np.array([0.0, 0.5 * opening, 0.0])
        left = self.finger + shift
        right = (self.finger * [1.0, -1.0, 1.0])[:, ::-1].copy()
        # Mirroring swaps lower and upper along y only; x and z must be swapped back.
        right[:, :, [0, 2]] = self.finger[:, :, [0, 2]]
        return np.concatenate([self.body, left, right - shift])


def _boxes(*corners: tuple[tuple[float, float, float], tuple[float, float, float]]) -> Array:
    array = np.array(corners)
    array.flags.writeable = False
    return array


PANDA_HAND = Gripper(
    name="panda_hand",
    max_opening=0.08,
    pad_size=(0.0175, 0.0185),
    # The hull of the hand's collision mesh; the tool centre point is 0.1034 m in front of the flange.
    body=_boxes(((-0.0317, -0.1040, -0.1294), (0.0317, 0.1005, -0.0374))),
    # The finger's four collision boxes (franka_description), the tilted one by its bounding box.
    finger=_boxes(
        ((-0.0110, 0.0110, -0.0440), (0.0110, 0.0260, -0.0240)),
        ((-0.0110, 0.0024, -0.0447), (0.0110, 0.0112, -0.0409)),
        ((-0.00875, 0.0070, -0.0286), (0.00875, 0.0248, -0.0047)),
        ((-0.00875, 0.0, -0.0090), (0.00875, 0.0152, 0.0095)),
    ),
    finger_joints=("panda_finger_joint1", "panda_finger_joint2"),
)

_GRIPPERS = {PANDA_HAND.name: PANDA_HAND}


def gripper(name: str) -> Gripper:
    """Return the gripper of that ``name``; raise `UnknownName`."""
    try:
        return _GRIPPERS[name]
    except KeyError:
        raise UnknownName("gripper", name, _GRIPPERS) from None
