"""Excitation: multisines, designs by Fisher information, waveforms, limits, sessions of runs."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
