"""rig.toml turned into what the estimator takes; asked for, probed and written; its devices opened."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
