"""Products of matrices whose inner side is short: three coordinates of many points, in many frames."""

from __future__ import annotations

import numpy as np

_ALONE = 250_000
"""Multiplications up to which BLAS libraries leave a product to one thread; OpenBLAS: 4 * 65536."""


def thin_product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return a @ b, (M, k) by (k, N), worked on in pieces that are too small for several threads.

    A product with a k of three is done before other threads have woken up; on a machine that is busy, waiting for
    them costs many times the work.
    """
    result = np.empty((len(a), b.shape[1]), dtype=np.result_type(a, b))
    step = max(1, _ALONE // max(1, b.size))
    for start in range(0, len(a), step):
        np.matmul(a[start : start + step], b, out=result[start : start + step])
    return result
