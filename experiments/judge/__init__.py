"""Judgements of results: trust, checks of a fit, the better of two models, the next step."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
