"""The same devices emulated at the byte level: registers and frames, never the driver's own API."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
