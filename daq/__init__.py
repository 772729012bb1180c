"""Floor 2: one time line. Clocks, recorder, safety, run files, alignment; hands over a `Dataset`."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
