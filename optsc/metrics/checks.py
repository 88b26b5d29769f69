"""What the measures ask of their input."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from optsc.errors import InvalidValue
from optsc.geometry.rotation import Array


def finite(field: str, value: ArrayLike, columns: int | None = None) -> Array:
    """Return ``value`` as an array (N, d), or (N, ``columns``); raise `InvalidValue` unless it is finite."""
    array = np.asarray(value, dtype=float)
    if array.ndim != 2 or (columns is not None and array.shape[1] != columns):
        raise InvalidValue(field, array.shape, f"shape (N, {columns or 'd'})")
    good = np.all(np.isfinite(array), axis=1)
    if not np.all(good):
        row = int(np.argmin(good))
        raise InvalidValue(f"{field}, row {row}", array[row].tolist(), "finite")
    return array


def profile(field: str, value: ArrayLike) -> Array:
    """Return ``value`` (N,) or (N, d) as an array (N, d); raise `InvalidValue` unless it is finite."""
    array = np.asarray(value, dtype=float)
    return finite(field, array[:, None] if array.ndim == 1 else array)


def positive(field: str, value: float) -> float:
    """Return ``value``; raise `InvalidValue` unless it is finite and above zero."""
    if not 0.0 < value < np.inf:
        raise InvalidValue(field, value, "finite, above 0")
    return value


def deadband(value: float) -> float:
    """Return ``value``; raise `InvalidValue` unless it is finite and not negative."""
    if not 0.0 <= value < np.inf:
        raise InvalidValue("deadband", value, "finite, 0 or above")
    return value
