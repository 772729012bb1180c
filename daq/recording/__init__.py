"""The recorder: plan, intake of every device, supervision of its limits, remote control."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
