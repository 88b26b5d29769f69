"""User-defined things by name, as on a command line: ``FILE.py:NAME`` or ``MODULE:NAME``."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

from optsc.errors import DamagedFile, UnknownName


def load_named(text: str) -> Any:
    """Return what ``text``, ``FILE.py:NAME`` or ``MODULE:NAME``, names; the same file gives the same thing twice.

    Raises:
        DamagedFile: there is no such file or module, or it cannot be imported.
        UnknownName: it has nothing of that name.
    """
    place, _, name = text.rpartition(":")
    try:
        module = _of_file(Path(place)) if place.endswith(".py") else importlib.import_module(place)
    except (OSError, ImportError, SyntaxError, ValueError) as error:
        raise DamagedFile(place, f"cannot be loaded ({error})") from None
    content = vars(module)
    if name not in content:
        there = [n for n, item in content.items() if callable(item) and n[0] != "_"]
        raise UnknownName(f"thing in {place}", name, there)
    return content[name]


def absolute(text: str) -> str:
    """Return ``text`` with its file, if it has one, named from the root: for processes that start elsewhere."""
    place, _, name = text.rpartition(":")
    return f"{Path(place).resolve()}:{name}" if place.endswith(".py") else text


def _of_file(path: Path) -> ModuleType:
    """Import a file under a name that its content gives, so that it collides with no other file and no older version.

    It has to be among the imported modules, where dataclasses and `inspect` look for it.
    """
    digest = hashlib.sha256(path.read_bytes()).hexdigest()[:12]
    name = f"own_{path.stem}_{digest}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError("it is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
