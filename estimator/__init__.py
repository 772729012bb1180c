"""Floor 3: mathematics on arrays. No I/O, no clock on the wall, no printing; knows `daq.dataset` alone."""
