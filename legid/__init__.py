"""Python interface: the verbs of the `legid` command on data in memory, with results that show themselves.

    import legid

    runs = legid.load(["run1.mcap", "run2.mcap"])
    result = legid.fit(runs)
    result.to_frame()

A name is loaded when it is first used, so that `import legid` itself costs next to nothing.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
