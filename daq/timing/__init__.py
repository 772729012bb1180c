"""One clock out of several: fitted from pings, ticks and sample counts; alignment to a uniform grid."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
