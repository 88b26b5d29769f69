"""Studies with people: who does what when, whose hand it is, what they answered, where it is kept, what came out."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
