"""What a set of grasps depends on besides its object, its seed and its settings."""

from __future__ import annotations

import hashlib

import numpy as np

from optsc.robot.gripper import Gripper

METHOD = "antipodal-2"
"""Name of the sampling method; the number rises with every change that gives other grasps."""


def gripper_fingerprint(gripper: Gripper) -> str:
    """Return a hash of everything about the gripper that grasps depend on, rounded to a micrometre."""
    numbers = [
        [gripper.max_opening, *gripper.pad_size, float(gripper.jaw_symmetric)],
        gripper.body,
        gripper.finger,
    ]
    digest = hashlib.sha256()
    for array in numbers:
        digest.update(np.round(np.asarray(array, dtype=float) * 1e6).astype("<i8").tobytes())
    return digest.hexdigest()[:16]
