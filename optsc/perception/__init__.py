"""What a depth camera sees: objects apart from table and arm, whether the arm hides them, and what they are."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
