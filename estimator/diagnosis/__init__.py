"""Diagnosis of a simulation's errors: score tests, re-fits, an error budget, a verdict."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
