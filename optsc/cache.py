"""The per-user cache: generated robot descriptions and compiled kernels."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path


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


def write_atomically(path: Path, content: bytes) -> None:
    """Write ``content`` so that other processes see the old file or the new one, never a half."""
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
