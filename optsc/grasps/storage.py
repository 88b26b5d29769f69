"""One file per object: a NumPy archive (.npz) of the arrays, a JSON text that describes them, a checksum.

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
"""

from __future__ import annotations

import hashlib
import io
import json
import re
import struct
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from optsc.cache import write_atomically
from optsc.errors import DamagedFile, InvalidValue
from optsc.geometry import Pose
from optsc.grasps.grasp_set import GraspSet

FORMAT = 2
"""Version of the file format; a file with a greater one is refused."""

SUFFIX = ".grasps.npz"

_ARRAYS = ("quaternion", "translation", "opening", "quality")
_TRIALS = ("tried", "held")
_FIELDS = {"object_name": str, "object_hash": str, "gripper": str, "jaw_symmetric": bool, "provenance": dict}
# What zipfile and numpy raise for bytes that are no such archive, found by flipping every byte of a file.
BAD_ARCHIVE = (zipfile.BadZipFile, zlib.error, struct.error, RuntimeError, EOFError, OSError)
_BAD_ARRAY = (ValueError, TypeError, AttributeError)
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")


def path_of(directory: str | Path, object_name: str) -> Path:
    """Return the file for the grasps of an object; raise `InvalidValue` for a name no file should have."""
    if not _NAME.fullmatch(object_name):
        raise InvalidValue(
            "object name", object_name, "letters, digits, '_', '.', '-', not starting with a sign"
        )
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
    entries = {
        "quaternion": grasps.X_OG.quaternion,
        "translation": grasps.X_OG.translation,
        "opening": grasps.opening,
        "quality": grasps.quality,
        "description": np.frombuffer(json.dumps(description).encode(), dtype=np.uint8),
    }
    if grasps.tried is not None and grasps.held is not None:
        entries |= {"tried": grasps.tried, "held": grasps.held}
    buffer = io.BytesIO()
    np.savez(buffer, **entries, checksum=_checksum(entries))  # type: ignore[arg-type]
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, buffer.getvalue())
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
        raise InvalidValue(
            f"format of {path}", version, f"at most {FORMAT}: the file is from a later version of optsc"
        )
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
    try:
        # Read as a whole first: an error of the file system then says what it is.
        content = Path(path).read_bytes()
    except OSError as error:
        raise DamagedFile(path, f"cannot be read ({error.strerror})") from None
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            trials = [name for name in _TRIALS if name in archive.files]
            entries = {name: archive[name] for name in (*_ARRAYS, *trials, "description", "checksum")}
    except KeyError as error:
        raise DamagedFile(path, f"is no grasp file ({error.args[0]})") from None
    except (*BAD_ARCHIVE, *_BAD_ARRAY) as error:
        raise DamagedFile(path, f"is damaged or no grasp file ({error})") from None
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
