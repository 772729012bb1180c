"""Calibration as a person runs it: records at rest and by hand, what they gave, what is written."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
