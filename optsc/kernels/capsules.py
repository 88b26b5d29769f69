"""Capsules fixed to the joints of an arm, and where their segments are at a configuration."""

from __future__ import annotations

from dataclasses import dataclass

import casadi
import numpy as np

from optsc.geometry.rotation import Array
from optsc.kernels.chain import Chain, joint_frames


@dataclass(frozen=True, eq=False)
class LinkCapsules:
    """The capsules of an arm with its hand.

    Attributes:
        link: name of the link that each of the C capsules covers. The two fingers count as one body, in every
            position of the jaws.
        joint: (C,) the joint of the arm that carries it, 0 to n - 1; -1 for what no joint moves.
        ends: (C, 2, 3) ends of the segments in the frame of that joint [m].
        radius: (C,) [m].
        hand: (C,) bool: part of the hand.
    """

    link: tuple[str, ...]
    joint: np.ndarray
    ends: Array
    radius: Array
    hand: np.ndarray

    @property
    def length(self) -> Array:
        """Lengths (C,) of the segments [m]."""
        return np.linalg.norm(self.ends[:, 1] - self.ends[:, 0], axis=1)

    @property
    def moving(self) -> list[int]:
        """Numbers of the capsules that a joint moves."""
        return np.flatnonzero(self.joint >= 0).tolist()


def capsule_ends(chain: Chain, capsules: LinkCapsules) -> casadi.Function:
    """Return the function q (n,) -> ends (6, C) of the capsules' segments in W [m]."""
    q = casadi.SX.sym("q", chain.n)
    frames = joint_frames(chain, q)
    columns = []
    for joint, ends in zip(capsules.joint.tolist(), capsules.ends, strict=True):
        R, p = (casadi.SX.eye(3), casadi.SX(3, 1)) if joint < 0 else frames[joint][:2]
        columns.append(casadi.vertcat(*(p + R @ casadi.DM(end) for end in ends)))
    return casadi.Function("capsule_ends", [q], [casadi.densify(casadi.horzcat(*columns))])
