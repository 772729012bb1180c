"""Run files and a rig prepared for any verb: read, driven by their input, bad ones set aside, silent terms chosen."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
