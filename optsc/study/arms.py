"""Arms of a study: those of the catalogue by name, any other as a value with the hash of its description."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from optsc.errors import DamagedFile, InvalidValue, Mismatch
from optsc.robot import PANDA_HAND, ROBOT_NAMES, Gripper, RobotModel, load_robot
from optsc.study.fingerprint import fingerprint


@dataclass(frozen=True)
class Arm:
    """An arm that the catalogue does not have, or has otherwise: what `optsc.load_robot` needs for it.

    Two are equal if their content is. It can be sent to other processes; the file has to be there, too, and the same.

    Attributes:
        name: for tables; none of the catalogue's.
        urdf: path of the description, its gripper included.
        tip: the tool frame T, see `optsc.robot.Gripper`.
        gripper: the jaws at the tip.
        home: the configuration (n,) [rad] at which episodes begin; by default the middle of the limits.
        limits: limits that replace the file's, see `optsc.robot.model_from_urdf`.
        file_hash: SHA-256 of the description; meshes that it refers to are not in it.
        key: hash of all of this but the path.
    """

    name: str
    urdf: str | Path = field(compare=False)
    tip: str = field(compare=False)
    gripper: Gripper = field(default=PANDA_HAND, compare=False)
    home: ArrayLike | None = field(default=None, compare=False)
    limits: Mapping[str, ArrayLike] = field(default_factory=dict, compare=False)
    file_hash: str = field(init=False, repr=False)
    key: str = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.name in ROBOT_NAMES:
            raise InvalidValue("name of an arm", self.name, f"none of the catalogue's: {', '.join(ROBOT_NAMES)}")
        home = None if self.home is None else np.array(self.home, dtype=float)
        limits = {name: np.array(value, dtype=float) for name, value in self.limits.items()}
        object.__setattr__(self, "file_hash", _file_hash(self.urdf))
        object.__setattr__(self, "key", fingerprint([self.name, self.file_hash, self.tip, self.gripper, home, limits]))

    def load(self) -> RobotModel:
        """Return the arm.

        Raises `Mismatch` if the file is no longer the same, and whatever `optsc.load_robot` does.
        """
        found = _file_hash(self.urdf)
        if found != self.file_hash:
            raise Mismatch(f"description of {self.name}, {self.urdf}", self.file_hash[:12], found[:12])
        return load_robot(self.urdf, self.tip, gripper=self.gripper, home=self.home, limits=dict(self.limits) or None)


def _file_hash(path: str | Path) -> str:
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError as error:
        raise DamagedFile(path, f"cannot be read ({error.strerror})") from None


@lru_cache(maxsize=8)
def arm(which: str | Arm) -> RobotModel:
    """Return an arm by its name in the catalogue or by its value; what is equal gives the same object every time."""
    return load_robot(which) if isinstance(which, str) else which.load()
