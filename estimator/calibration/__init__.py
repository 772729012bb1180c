"""Sensors calibrated by a motion: IMU, its mount, encoders, their zeros, a distance meter; columns read wrongly."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
