"""Floor 1: bytes to physical units, one module a device. Knows buses and datasheets, nothing above."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
