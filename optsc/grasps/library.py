"""Grasp library: the grasps of several objects for one gripper, stored in a directory and placed in the world."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

from optsc.errors import DamagedFile, InvalidValue, Mismatch, UnknownName
from optsc.geometry import Pose
from optsc.grasps.candidates import Candidates, place
from optsc.grasps.grasp_set import GraspSet
from optsc.grasps.storage import SUFFIX, load_set, path_of, save_set
from optsc.robot.gripper import Gripper


class GraspLibrary(Mapping[str, GraspSet]):
    """An immutable mapping from an object's name to its grasps, all for one gripper."""

    def __init__(self, sets: Mapping[str, GraspSet]) -> None:
        grippers = {s.gripper for s in sets.values()}
        if len(grippers) > 1:
            first, *others = sorted(grippers)
            raise Mismatch("part of a grasp library", first, ", ".join(others))
        for name, grasps in sets.items():
            if name != grasps.object_name:
                raise InvalidValue("key of a grasp set", name, f"its object's name, {grasps.object_name!r}")
        self._sets = MappingProxyType(dict(sets))

    def __getitem__(self, name: str) -> GraspSet:
        try:
            return self._sets[name]
        except KeyError:
            # A LookupError that is no KeyError would break `in` and `get`.
            raise _UnknownObjectError("object with stored grasps", name, self._sets) from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._sets)

    def __len__(self) -> int:
        return len(self._sets)

    def __repr__(self) -> str:
        return f"GraspLibrary({', '.join(f'{name}: {len(grasps)}' for name, grasps in self.items())})"

    @property
    def gripper(self) -> str | None:
        """Name of the gripper that the grasps are for; None if there are no grasps."""
        return next((grasps.gripper for grasps in self.values()), None)

    def place(self, X_WO: Mapping[str, Pose]) -> Candidates:
        """Return every grasp of every object in ``X_WO``, placed in the world, in that order.

        Raises `UnknownName` for an object without grasps and `InvalidValue` for a batch of poses.
        """
        return place(self, X_WO)

    def with_set(self, grasps: GraspSet) -> GraspLibrary:
        """Return a library that holds ``grasps`` too, in place of any earlier ones of that object.

        Raises `Mismatch` where they are for another gripper. The other sets are the same objects as before.
        """
        return GraspLibrary({**self._sets, grasps.object_name: grasps})

    def without(self, name: str) -> GraspLibrary:
        """Return a library without the grasps of an object; raise `UnknownName` where there are none."""
        self[name]
        return GraspLibrary({key: grasps for key, grasps in self._sets.items() if key != name})

    def save(self, directory: str | Path) -> None:
        """Write one file per object into a directory, which is made if it is missing."""
        for grasps in self.values():
            save_set(grasps, directory)

    @classmethod
    def load(cls, directory: str | Path, gripper: Gripper | None = None) -> GraspLibrary:
        """Return the library in a directory.

        Raises `DamagedFile` if there is none or a file in it is damaged, and `Mismatch` if a set was made for
        another gripper than ``gripper`` or than the others.
        """
        paths = sorted(Path(directory).glob(f"*{SUFFIX}"))
        if not paths:
            raise DamagedFile(directory, f"is no grasp library: it holds no file *{SUFFIX}")
        sets = {}
        for path in paths:
            grasps = load_set(path)
            if gripper is not None and grasps.gripper != gripper.name:
                raise Mismatch(f"grasp set {path}", grasps.gripper, gripper.name)
            if path != path_of(directory, grasps.object_name):
                raise DamagedFile(path, f"holds the grasps of {grasps.object_name!r}, which its name does not say")
            sets[grasps.object_name] = grasps
        return cls(sets)


class _UnknownObjectError(UnknownName, KeyError):
    __str__ = Exception.__str__  # KeyError would print the message in quotes
