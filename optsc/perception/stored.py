"""What was computed of a shape, in the per-user cache: it depends on nothing but the shape and a few numbers.

A file's name carries the hash of all that determines it and the hash of its own content. It is moved into place
whole, so two processes may compute the same at once; a damaged one is recognised, and computed anew.
"""

from __future__ import annotations

import hashlib
import io
import warnings
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from optsc.cache import cache_directory, write_atomically

Arrays = Mapping[str, np.ndarray]

_FOLDER = "templates"
_UNREADABLE = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile)


def content_key(*parts: np.ndarray | float | str) -> str:
    """Return a hash of arrays, numbers and words, and of numpy's version, in this order."""
    digest = hashlib.sha256(np.__version__.encode())
    for part in parts:
        if isinstance(part, np.ndarray):
            # Another layout or byte order of the same numbers is the same content.
            digest.update(f"{part.shape}{part.dtype.kind}".encode())
            digest.update(np.ascontiguousarray(part).astype(part.dtype.newbyteorder("<")).tobytes())
        else:
            digest.update(f"\0{part!r}".encode())
    return digest.hexdigest()[:32]


def computed_once(key: str, names: frozenset[str], compute: Callable[[], Arrays]) -> Arrays:
    """Return what ``compute`` does, arrays of these ``names``, from the cache if it has been computed before.

    Where the cache cannot be written, a warning says so, and the next process computes it again.
    """
    try:
        folder = cache_directory(_FOLDER)
    except OSError as error:
        warnings.warn(f"nothing is kept of a template: {error}", stacklevel=3)
        return compute()
    for path in sorted(folder.glob(f"{key}-*.npz")):
        found = _read(path, names)
        if found is not None:
            return found
        path.unlink(missing_ok=True)
    arrays = compute()
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **dict(arrays))
    content = buffer.getvalue()
    try:
        write_atomically(folder / f"{key}-{_digest(content)}.npz", content)
    except OSError as error:
        warnings.warn(f"nothing is kept of a template: {error}", stacklevel=3)
    return arrays


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:24]


def _read(path: Path, names: frozenset[str]) -> Arrays | None:
    """Return the arrays of a file; None for one that is damaged or of something else."""
    try:
        content = path.read_bytes()
        if _digest(content) != path.stem.rpartition("-")[2]:
            return None
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            return {name: file[name] for name in file.files} if set(file.files) == names else None
    except _UNREADABLE:
        return None
