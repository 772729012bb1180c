"""Results as they leave the program: each JSON document is a struct, and its keys are the struct's fields."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
