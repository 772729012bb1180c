"""Changes of a rig against runs of the same rig, or between two sessions: the rig is its own reference."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
