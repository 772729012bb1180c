"""Floor 2: one time line. Clocks, recorder, safety, run files, alignment; hands over a `Dataset`."""
