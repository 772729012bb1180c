"""The emulated rig: a plant, an effect hidden in it, devices served as files."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
