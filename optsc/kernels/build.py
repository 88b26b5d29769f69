"""From generated C to a shared library in the per-user cache.

A library's file name carries the hash of everything that determines it (source, compiler, flags) and the hash
of its own content. It is moved into place whole, so two processes may build the same one at once; a damaged
one is recognised before it is loaded, and built again.
"""

from __future__ import annotations

import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import sysconfig
import tempfile
import warnings
from functools import lru_cache
from pathlib import Path

import casadi

from optsc.cache import cache_directory, write_atomically
from optsc.errors import InvalidValue

FLAGS = ("-O2", "-fPIC", "-shared", "-fno-math-errno", "-fvisibility=hidden", "-DGCC_HASCLASSVISIBILITY", "-w")
"""Only the platform's base instructions, because machines may share a cache; IEEE arithmetic. Helper functions are not
visible from outside, or each of their calls would go through a table."""
_MATH = "#include <math.h>\n"
_INLINE = """static inline double optsc_fmax(double x, double y) { double m = x > y ? x : y; return y == y ? m : x; }
static inline double optsc_fmin(double x, double y) { double m = x < y ? x : y; return y == y ? m : x; }
#define fmax optsc_fmax
#define fmin optsc_fmin
"""
"""What the library's fmax and fmin return, numbers that are not included, without a call: some kernels spend a fifth of
their time in them."""

TIME_LIMIT = 300.0
"""Seconds after which a compiler counts as broken."""


def compiler() -> str | None:
    """Return the command of the C compiler that kernels are built with, or None where they run interpreted.

    ``OPTSC_COMPILER`` in the environment names one, or is ``none``; otherwise it is the first there is of
    ``CC``, cc, gcc and clang.

    Raises:
        InvalidValue: ``OPTSC_COMPILER`` names one that does not run.
    """
    wanted = os.environ.get("OPTSC_COMPILER", "").strip()
    if wanted.lower() == "none":
        return None
    if wanted and _version(wanted) is None:
        raise InvalidValue("OPTSC_COMPILER", wanted, "a C compiler that runs, or none")
    candidates = (wanted,) if wanted else (os.environ.get("CC", ""), "cc", "gcc", "clang")
    return next((command for command in candidates if _version(command) is not None), None)


@lru_cache(maxsize=8)
def _version(command: str) -> str | None:
    """Return the first line of what ``command --version`` says, or None when there is no such compiler."""
    words = shlex.split(command)
    if not words or shutil.which(words[0]) is None:
        return None
    try:
        done = subprocess.run([*words, "--version"], capture_output=True, text=True, timeout=30)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.partition("\n")[0] if done.returncode == 0 else None


def _compile(command: str, source: str) -> bytes:
    """Return the content of the shared library made of ``source``; raise `OSError` or `SubprocessError`."""
    with tempfile.TemporaryDirectory(prefix="optsc-kernel-") as folder:
        Path(folder, "kernel.c").write_text(source)
        # Relative names and the folder as working directory: the same source gives the same bytes.
        arguments = [*shlex.split(command), *FLAGS, "kernel.c", "-o", "kernel.so", "-lm"]
        done = subprocess.run(arguments, cwd=folder, capture_output=True, text=True, timeout=TIME_LIMIT)
        if done.returncode != 0:
            raise subprocess.SubprocessError(done.stderr.strip()[-500:])
        return Path(folder, "kernel.so").read_bytes()


def _intact(path: Path, digest: str) -> bool:
    """Tell whether a library is this user's own and whole: loading any other could end the process."""
    try:
        content = path.read_bytes()
        return path.stat().st_uid == os.getuid() and hashlib.sha256(content).hexdigest().startswith(digest)
    except OSError:
        return False


def shared_library(name: str, source: str) -> Path | None:
    """Return the path of the shared library of C code ``source``, built unless it is in the cache already.

    None means that there is no compiler, or that it failed, in which case a warning says what it reported.

    Raises:
        InvalidValue: the environment asks for a compiler that does not run.
    """
    command = compiler()
    if command is None:
        return None
    source = source.replace(_MATH, _MATH + _INLINE, 1)
    system = (sysconfig.get_platform(), *platform.libc_ver(), casadi.CasadiMeta.version())
    recipe = "\0".join((source, command, str(_version(command)), *FLAGS, *system))
    key = hashlib.sha256(recipe.encode()).hexdigest()[:24]
    try:
        folder = cache_directory("kernels")
        for path in sorted(folder.glob(f"{name}-{key}-*.so")):
            if _intact(path, path.stem.rpartition("-")[2]):
                return path
            path.unlink(missing_ok=True)
        content = _compile(command, source)
        path = folder / f"{name}-{key}-{hashlib.sha256(content).hexdigest()[:24]}.so"
        write_atomically(path, content)
        return path
    except (OSError, subprocess.SubprocessError) as error:
        warnings.warn(f"{name} runs interpreted, because {command} did not build it: {error}", stacklevel=3)
        return None
