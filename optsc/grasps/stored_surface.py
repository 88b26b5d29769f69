"""A copy of an object's surface beside its stored grasps, so that they can be tried and drawn wherever they go.

``NAME.surface.npz`` holds ``vertices`` (V, 3) [m] and ``faces`` (F, 3) in the object's frame O of ``NAME.grasps.npz``.
Which surface belongs to a set is said by the set: its ``object_hash``, or ``surface_hash`` in its provenance where it
was made from a view. So a copy that is left over from other grasps is recognised, and not used.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from optsc.cache import write_atomically
from optsc.errors import DamagedFile, InvalidValue
from optsc.geometry import TriangleMesh
from optsc.grasps.grasp_set import GraspSet
from optsc.grasps.storage import BAD_ARCHIVE, path_of

SUFFIX = ".surface.npz"


def surface_path(directory: str | Path, object_name: str) -> Path:
    """Return the file for the surface of an object; raise `InvalidValue` for a name no file should have."""
    return path_of(directory, object_name).with_name(f"{object_name}{SUFFIX}")


def surface_hash(grasps: GraspSet) -> str | None:
    """Return the hash of the surface that a set is of; None where it is not known."""
    named = grasps.provenance.get("surface_hash")
    return named if isinstance(named, str) else grasps.object_hash if grasps.made_on_mesh else None


def save_surface(name: str, mesh: TriangleMesh, directory: str | Path) -> Path:
    """Write the surface of an object beside its grasps and return the file's path; same surface, same bytes."""
    path, buffer = surface_path(directory, name), io.BytesIO()
    np.savez(buffer, vertices=mesh.vertices, faces=mesh.faces)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, buffer.getvalue())
    return path


def load_surface(grasps: GraspSet, directory: str | Path) -> TriangleMesh | None:
    """Return the surface that is stored for a set; None where there is none, or one of something else.

    Raises:
        DamagedFile: the file is no surface.
    """
    path = surface_path(directory, grasps.object_name)
    if not path.exists():
        return None
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
            mesh = TriangleMesh(file["vertices"], file["faces"])
    except (KeyError, TypeError, InvalidValue, ValueError, *BAD_ARCHIVE) as error:
        raise DamagedFile(path, f"is no surface ({error})") from None
    return mesh if mesh.hash == surface_hash(grasps) else None
