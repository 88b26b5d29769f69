"""Measures of a motion as pure functions of arrays.

Rules that hold for all of them: what adds up is 0 for a motion of no samples; what divides by the amount of
motion is NaN when there is none, so that it cannot be mistaken for a good score; NaN or infinity in the input
raises `InvalidValue`, naming the first bad row.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
