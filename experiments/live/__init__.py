"""`legid live`: the dashboard. It opens no device: a recorder of its own process does, see `daq.recording`."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
