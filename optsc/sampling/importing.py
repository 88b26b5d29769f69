"""Import of grasps: ACRONYM's HDF5 files and plain tables of poses.

ACRONYM (C. Eppner, A. Mousavian, D. Fox, 2021) gives the pose of the Panda's hand link, whose origin lies at
the flange, in the frame of the mesh file times ``object/scale``; z is its approach axis and the jaws close along
its x axis. Here a grasp is the pose of the tool frame between the pads, z along the approach and y along the
closing: X_OG = X_OH X_HG with a quarter turn about z and an offset of 0.1034 m along z (`ACRONYM_X_HG`).
"""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from optsc.errors import DamagedFile, InvalidValue
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.grasps.grasp_set import GraspSet
from optsc.robot.gripper import Gripper

ACRONYM_X_HG = Pose.from_rotation_vector([0.0, 0.0, 0.5 * np.pi], [0.0, 0.0, 0.1034])
"""The tool frame between the pads in the hand frame of ACRONYM's files."""

PANDA_X_HG = Pose.from_translation([0.0, 0.0, 0.1034])
"""The same in the frame ``panda_hand`` of the arm's own description, whose jaws close along y."""

COLUMNS = ("x", "y", "z", "qw", "qx", "qy", "qz")
"""Columns that a table of poses has to have; ``opening`` and ``quality`` may follow, in any order."""
OPTIONAL = ("opening", "quality")

FARTHEST = 2.0
"""Distance of a grasp from the object's origin [m] above which millimetres are suspected."""
_UNIT = 1e-3  # deviation of a quaternion's length from one that rounding explains


def import_grasps(
    path: str | Path, gripper: Gripper, *, name: str, X_HG: Pose | None = None, object_hash: str | None = None
) -> GraspSet:
    """Return the grasps in a file: ``.h5`` and ``.hdf5`` as ACRONYM's, ``.csv`` as a table of poses.

    Args:
        path: of the file.
        gripper: that the grasps are for.
        name: of the object.
        X_HG: tool frame in the frame that the file's poses are of: `ACRONYM_X_HG` by default for HDF5, no
            difference for tables.
        object_hash: `TriangleMesh.hash` of the object where it is known, so that the grasps can be tried on it.

    Raises:
        InvalidValue: another suffix, no grasps, a number out of its range, or one that seems to be in millimetres.
        DamagedFile: the file is missing or is not what its suffix says.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix in (".h5", ".hdf5"):
        return _acronym(path, gripper, name, ACRONYM_X_HG if X_HG is None else X_HG, object_hash)
    if suffix == ".csv":
        return _table(path, gripper, name, Pose.identity() if X_HG is None else X_HG, object_hash)
    raise InvalidValue("suffix of the grasp file", suffix, ".h5 or .hdf5 (ACRONYM), .csv (poses)")


def _acronym(path: Path, gripper: Gripper, name: str, X_HG: Pose, object_hash: str | None) -> GraspSet:
    entries = _hdf5(path)
    matrices = np.asarray(entries["transforms"], dtype=float)
    if matrices.ndim != 3 or matrices.shape[1:] != (4, 4):
        raise DamagedFile(path, f"grasps/transforms has shape {matrices.shape}, not (N, 4, 4)")
    _check_positions(path, matrices[:, :3, 3])
    R = matrices[:, :3, :3]
    with np.errstate(invalid="ignore", over="ignore"):
        off = np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max(axis=(1, 2))
        proper = (off <= _UNIT) & (np.linalg.det(R) > 0.0) & np.all(matrices[:, 3] == [0, 0, 0, 1], axis=1)
    if not proper.all():
        raise InvalidValue(f"{path}: grasps/transforms[{int(np.argmin(proper))}]", "no rigid motion", "R'R = 1, det 1")
    held = entries["success"]
    if held is not None and (held.shape != (len(matrices),) or not np.all((held >= 0.0) & (held <= 1.0))):
        raise InvalidValue(f"{path}: quality_flex_object_in_gripper", held.shape, f"({len(matrices)},), 0 to 1")
    facts = {key: entries[key] for key in ("object_file", "object_scale") if entries[key] is not None}
    return _imported(
        path,
        gripper,
        name,
        Pose.from_matrix(matrices) @ X_HG,
        None,
        held,
        object_hash,
        {"format": "ACRONYM", **facts, "validation": "from the file"},
        held=None if held is None else held >= 0.5,
    )


def _hdf5(path: Path) -> dict[str, Any]:
    try:
        import h5py
    except ModuleNotFoundError:
        raise InvalidValue("h5py", "not installed", "installed: pip install 'optsc[import]'") from None
    if not path.exists():
        raise DamagedFile(path, "cannot be read (no such file)")
    try:
        with h5py.File(path, "r") as file:
            if "grasps/transforms" not in file:
                raise DamagedFile(path, "has no grasps/transforms, so it is not laid out as ACRONYM's files are")
            success = "grasps/qualities/flex/object_in_gripper"
            older = "grasps/quality_flex_object_in_gripper"
            found = success if success in file else older if older in file else None
            return {
                "transforms": file["grasps/transforms"][()],
                "success": None if found is None else np.asarray(file[found][()], dtype=float),
                "object_file": _text(file["object/file"][()]) if "object/file" in file else None,
                "object_scale": float(file["object/scale"][()]) if "object/scale" in file else None,
            }
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise DamagedFile(path, f"is damaged or no HDF5 file ({error})") from None


def _text(value: Any) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def _table(path: Path, gripper: Gripper, name: str, X_HG: Pose, object_hash: str | None) -> GraspSet:
    columns = _columns(path)
    translation = np.stack([columns[key] for key in COLUMNS[:3]], axis=-1)
    quaternion = np.stack([columns[key] for key in COLUMNS[3:]], axis=-1)
    _check_positions(path, translation)
    length = np.linalg.norm(quaternion, axis=1)
    wrong = ~(np.abs(length - 1.0) <= _UNIT)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InvalidValue(f"{path}: length of quaternion qw..qz in row {row + 1}", float(length[row]), "1")
    X_OG = Pose.from_quaternion(quaternion, translation) @ X_HG
    facts: dict[str, object] = {"format": "CSV"}
    opening, quality = columns.get("opening"), columns.get("quality")
    return _imported(path, gripper, name, X_OG, opening, quality, object_hash, facts, held=None)


def _columns(path: Path) -> Mapping[str, Array]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise DamagedFile(path, f"cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise DamagedFile(path, "is no text in UTF-8") from None
    rows = [row for row in csv.reader(io.StringIO(text)) if any(cell.strip() for cell in row)]
    header = [cell.strip().lower() for cell in rows[0]] if rows else []
    missing = [column for column in COLUMNS if column not in header]
    unknown = [column for column in header if column not in (*COLUMNS, *OPTIONAL)]
    if missing or unknown or len(set(header)) < len(header):
        valid = f"{','.join(COLUMNS)} and, if wanted, {','.join(OPTIONAL)}, each once"
        raise InvalidValue(f"{path}: header", ",".join(header), valid)
    numbers = np.zeros((len(rows) - 1, len(header)))
    for index, row in enumerate(rows[1:]):
        if len(row) != len(header):
            raise InvalidValue(f"{path}: cells in row {index + 1}", len(row), f"{len(header)}")
        for column, cell in enumerate(row):
            try:
                numbers[index, column] = float(cell)
            except ValueError:
                raise InvalidValue(f"{path}: {header[column]} in row {index + 1}", cell, "a number") from None
    return dict(zip(header, numbers.T, strict=True))


def _check_positions(path: Path, translation: Array) -> None:
    if len(translation) == 0:
        raise InvalidValue(f"{path}: number of grasps", 0, "at least 1")
    finite = np.isfinite(translation).all(axis=1)
    if not finite.all():
        row = int(np.argmin(finite))
        raise InvalidValue(f"{path}: position of grasp {row + 1}", translation[row].tolist(), "finite [m]")
    far = float(np.linalg.norm(translation, axis=1).max())
    if far > FARTHEST:
        raise InvalidValue(
            f"{path}: greatest distance of a grasp from the object",
            far,
            f"at most {FARTHEST} m; is it in millimetres?",
        )


def _imported(
    path: Path,
    gripper: Gripper,
    name: str,
    X_OG: Pose,
    opening: Array | None,
    quality: Array | None,
    object_hash: str | None,
    facts: Mapping[str, object],
    held: np.ndarray | None,
) -> GraspSet:
    """Return the set; an opening that is not known is taken as that of the open jaws, a quality as 1."""
    for field, values, top in (("opening", opening, gripper.max_opening), ("quality", quality, 1.0)):
        if values is None:
            continue
        wrong = ~((values >= 0.0) & (values <= top + 1e-9))
        if wrong.any():
            row = int(np.argmax(wrong))
            unit = "; is it in millimetres?" if field == "opening" and values[row] > 1.0 else ""
            raise InvalidValue(f"{path}: {field} of grasp {row + 1}", float(values[row]), f"0 to {top:g}{unit}")
    count = len(X_OG)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    return GraspSet(
        object_name=name,
        object_hash=object_hash or f"imported:{digest}",
        gripper=gripper.name,
        X_OG=X_OG,
        opening=np.full(count, gripper.max_opening) if opening is None else opening,
        quality=np.ones(count) if quality is None else quality,
        provenance={
            "source": "imported",
            "file": path.name,
            **facts,
            "opening_known": opening is not None,
            "quality_known": quality is not None,
        },
        jaw_symmetric=gripper.jaw_symmetric,
        tried=None if held is None else np.ones(count, dtype=bool),
        held=held,
    )
