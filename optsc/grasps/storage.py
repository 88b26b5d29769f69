"""Grasp files: per object one NumPy archive with a checksum, and a copy of the surface beside it.

``NAME.grasps.npz`` holds:

==================  =====================================================================
entry               content
==================  =====================================================================
quaternion          (N, 4) of X_OG, ordered w, x, y, z
translation         (N, 3) of X_OG [m]
opening, quality    (N,)
tried, held         (N,) bool; only where grasps were tried
description         UTF-8 JSON: format, object_name, object_hash, gripper, jaw_symmetric,
                    provenance
checksum            SHA-256 of all the entries above
==================  =====================================================================

Format 1 knew no trials; its files are read as sets that were never tried.

``NAME.surface.npz`` holds ``vertices`` (V, 3) [m] and ``faces`` (F, 3) in the same frame O, so that the grasps can be
tried and drawn anywhere. Which surface belongs to a set is said by the set: its ``object_hash``, or ``surface_hash`` in
its provenance where it was made from a view. A copy that is left over from other grasps is so recognised.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from optsc.cache import archive, arrays_of, write_atomically
from optsc.errors import DamagedFile, InvalidValue
from optsc.geometry import Pose, TriangleMesh
from optsc.grasps.grasp_set import GraspSet

FORMAT = 2
"""Version of the file format; a file with a greater one is refused."""
SUFFIX = ".grasps.npz"
SURFACE_SUFFIX = ".surface.npz"
_ARRAYS = ("quaternion", "translation", "opening", "quality")
_TRIALS = ("tried", "held")
_FIELDS = {"object_name": str, "object_hash": str, "gripper": str, "jaw_symmetric": bool, "provenance": dict}
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")


def path_of(directory: str | Path, object_name: str) -> Path:
    """Return the file for the grasps of an object; raise `InvalidValue` for a name no file should have."""
    if not _NAME.fullmatch(object_name):
        raise InvalidValue("object name", object_name, "letters, digits, '_', '.', '-', not starting with a sign")
    return Path(directory) / f"{object_name}{SUFFIX}"


def save_set(grasps: GraspSet, directory: str | Path) -> Path:
    """Write a set into a directory (made if it is missing) and return the file's path.

    The same set gives the same bytes. Whoever reads meanwhile sees the old file or the new one, never a half.
    """
    path = path_of(directory, grasps.object_name)
    description = {
        "format": FORMAT,
        **{field: getattr(grasps, field) for field in _FIELDS if field != "provenance"},
        "provenance": dict(grasps.provenance),
    }
    entries: dict[str, np.ndarray] = {
        "quaternion": grasps.X_OG.quaternion,
        "translation": grasps.X_OG.translation,
        "opening": grasps.opening,
        "quality": grasps.quality,
        "description": np.frombuffer(json.dumps(description).encode(), dtype=np.uint8),
    }
    if grasps.tried is not None and grasps.held is not None:
        entries |= {"tried": grasps.tried, "held": grasps.held}
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, archive({**entries, "checksum": _checksum(entries)}))
    return path


def load_set(path: str | Path) -> GraspSet:
    """Return the set in a file.

    Raises `DamagedFile` for anything that is no intact grasp file, also for impossible numbers, and
    `InvalidValue` for an intact one from a later version of the library.
    """
    entries = _read(path)
    try:
        description = json.loads(entries["description"].tobytes().decode())
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise DamagedFile(path, f"its description is not JSON ({error})") from None
    version = description.get("format") if isinstance(description, dict) else None
    if not isinstance(version, int):
        raise DamagedFile(path, "its description names no format")
    if version > FORMAT:
        raise InvalidValue(f"format of {path}", version, f"at most {FORMAT}: the file is from a later version of optsc")
    for field, kind in _FIELDS.items():
        if not isinstance(description.get(field), kind):
            raise DamagedFile(path, f"its description lacks {field}")
    quaternion, translation = entries["quaternion"], entries["translation"]
    if quaternion.shape[1:] != (4,) or translation.shape != (len(quaternion), 3):
        raise DamagedFile(path, f"its poses have shapes {quaternion.shape} and {translation.shape}")
    try:
        # The plain constructor: normalising once more would change the last digit. GraspSet checks the poses.
        return GraspSet(
            X_OG=Pose(quaternion, translation),
            opening=entries["opening"],
            quality=entries["quality"],
            tried=entries.get("tried"),
            held=entries.get("held"),
            **{field: description[field] for field in _FIELDS},
        )
    except (InvalidValue, ValueError) as error:
        raise DamagedFile(path, f"holds impossible grasps: {error}") from None


def _read(path: str | Path) -> Mapping[str, np.ndarray]:
    """Return the entries of an intact file."""
    found = _stored_arrays(path, "grasp file")
    names = (*_ARRAYS, *(name for name in _TRIALS if name in found), "description", "checksum")
    for name in names:
        if name not in found:
            raise DamagedFile(path, f"is no grasp file (without {name})")
    entries = {name: found[name] for name in names}
    if not np.array_equal(entries.pop("checksum"), _checksum(entries)):
        raise DamagedFile(path, "its content does not agree with its checksum")
    return entries


def _checksum(entries: Mapping[str, np.ndarray]) -> np.ndarray:
    digest = hashlib.sha256()
    for name in (*_ARRAYS, *(name for name in _TRIALS if name in entries), "description"):
        array = np.ascontiguousarray(entries[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(array.tobytes())
    return np.frombuffer(digest.digest(), dtype=np.uint8)


def surface_path(directory: str | Path, object_name: str) -> Path:
    """Return the file for the surface of an object; raise `InvalidValue` for a name no file should have."""
    return path_of(directory, object_name).with_name(f"{object_name}{SURFACE_SUFFIX}")


def surface_hash(grasps: GraspSet) -> str | None:
    """Return the hash of the surface that a set is of; None where it is not known."""
    named = grasps.provenance.get("surface_hash")
    return named if isinstance(named, str) else grasps.object_hash if grasps.made_on_mesh else None


def save_surface(name: str, mesh: TriangleMesh, directory: str | Path) -> Path:
    """Write the surface of an object beside its grasps and return the file's path; same surface, same bytes."""
    path = surface_path(directory, name)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, archive({"vertices": mesh.vertices, "faces": mesh.faces}))
    return path


def load_surface(grasps: GraspSet, directory: str | Path) -> TriangleMesh | None:
    """Return the surface that is stored for a set; None where there is none, or one of something else.

    Raises:
        DamagedFile: the file is no surface.
    """
    path = surface_path(directory, grasps.object_name)
    if not path.exists():
        return None
    found = _stored_arrays(path, "surface")
    try:
        mesh = TriangleMesh(found["vertices"], found["faces"])
    except (KeyError, TypeError, ValueError) as error:
        raise DamagedFile(path, f"is no surface ({error})") from None
    return mesh if mesh.hash == surface_hash(grasps) else None


def _stored_arrays(path: str | Path, kind: str) -> dict[str, np.ndarray]:
    """Return the arrays of an archive; raise `DamagedFile` where it cannot be read."""
    try:
        return arrays_of(Path(path).read_bytes())
    except OSError as error:
        raise DamagedFile(path, f"cannot be read ({error.strerror})") from None
    except ValueError as error:
        raise DamagedFile(path, f"is damaged or no {kind} ({error})") from None
