"""Floor 3: mathematics on arrays. No I/O, no clock on the wall, no printing; knows `daq.Dataset` alone."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
