"""The per-user cache, files that are written whole or not at all, archives of arrays, results computed once."""

from __future__ import annotations

import hashlib
import io
import os
import struct
import tempfile
import warnings
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

Arrays = Mapping[str, np.ndarray]

# What zipfile and numpy raise for bytes that are no such archive, found by flipping every byte of a file.
_BAD_ARCHIVE = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    RuntimeError,
    EOFError,
    OSError,
    TypeError,
    AttributeError,
    KeyError,
)


def cache_directory(*parts: str) -> Path:
    """Return (and create) a folder of the per-user cache; ``OPTSC_CACHE`` in the environment moves it.

    Falls back to a folder of this user's below the system's temporary directory where the home is read-only.
    """
    root = os.environ.get("OPTSC_CACHE")
    if root is None:
        import platformdirs

        root = platformdirs.user_cache_dir("optsc")
    path = Path(root, *parts)
    try:
        path.mkdir(parents=True, exist_ok=True)
        if os.access(path, os.W_OK):
            return path
    except OSError:
        pass
    path = Path(tempfile.gettempdir(), f"optsc-{os.getuid()}", *parts)
    path.mkdir(parents=True, exist_ok=True, mode=0o700)
    return path


def write_atomically(path: Path, content: bytes | str) -> None:
    """Write ``content`` (text as UTF-8) so that other processes see the old file or the new one, never a half."""
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def archive(arrays: Arrays) -> bytes:
    """Return a NumPy archive (.npz) of ``arrays``; the same arrays give the same bytes."""
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **dict(arrays))
    return buffer.getvalue()


def arrays_of(content: bytes) -> dict[str, np.ndarray]:
    """Return the arrays of an `archive`; raise `ValueError` for bytes that are none or are damaged."""
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except _BAD_ARCHIVE as error:
        raise ValueError(str(error)) from None


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


def computed_once(folder: str, key: str, names: frozenset[str], compute: Callable[[], Arrays]) -> Arrays:
    """Return what ``compute`` does, from a folder of the per-user cache if it has been computed before.

    A file's name carries ``key`` and the hash of its own content: two processes may compute the same at once, and
    a damaged file is recognised and replaced. Where the cache cannot be written, a warning says so.

    Args:
        folder: of the cache.
        key: hash of all that determines the arrays, see `content_key`.
        names: of the arrays.
        compute: makes the arrays.
    """
    try:
        directory = cache_directory(folder)
    except OSError as error:
        warnings.warn(f"nothing is kept in the cache of {folder}: {error}", stacklevel=3)
        return compute()
    for path in sorted(directory.glob(f"{key}-*.npz")):
        found = _intact(path, names)
        if found is not None:
            return found
        path.unlink(missing_ok=True)
    arrays = compute()
    content = archive(arrays)
    try:
        write_atomically(directory / f"{key}-{_digest(content)}.npz", content)
    except OSError as error:
        warnings.warn(f"nothing is kept in the cache of {folder}: {error}", stacklevel=3)
    return arrays


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:24]


def _intact(path: Path, names: frozenset[str]) -> Arrays | None:
    """Return the arrays of a file; None for one that is damaged or of something else."""
    try:
        content = path.read_bytes()
        arrays = arrays_of(content) if _digest(content) == path.stem.rpartition("-")[2] else {}
    except (OSError, ValueError):
        return None
    return arrays if set(arrays) == names else None
