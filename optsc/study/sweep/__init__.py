"""Sweeps: how results depend on many settings of the selection; rows kept on disk, search of settings."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
