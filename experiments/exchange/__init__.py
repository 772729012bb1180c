"""Other people's data: files of any program read by a map of columns or a guess, runs written for other programs."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
