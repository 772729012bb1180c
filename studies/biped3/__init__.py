"""The Monte Carlo study of the 3-link walker (Dolinsky and Celikovsky 2018, section V)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
