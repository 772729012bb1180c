"""Thresholds of the verdict, in the order in which a diagnosis applies them.

A cause is *present* if it is significant, repeats between runs and is possible. It is *material* if it reduces the
free-run error of the held-out runs by more than a stated share. Present causes often are not material: they do not
change the simulation. Generic terms show a material error that no listed effect explains.

Gains are twice the log likelihood (no unit), over the scatter between runs. Limits on the steps of a fit are in `refit`
and `search`. docs/decisions.md says how the thresholds were chosen.
"""

from __future__ import annotations

import numpy as np

from estimator.prediction import SHORT_S
from estimator.score import RUNS

# The runs

LEAST_S = RUNS * SHORT_S
"""Shortest data that are diagnosed, all runs together [s]: each segment of a single run is a swing."""

# What is detected

MATERIAL = 0.1
"""Material: the smallest relative reduction of the free-run rms error that counts (`--material`).

Its square is the least gain a sample of an effect that is looked at: smaller ones can be significant in long records
(microseconds of skew, a per mille of scale) and change no simulation."""

# Which models are tried

MOST_EFFECTS = 3
"""Most effects of an explanation."""
WIDTH = 3
"""Sets of each number of effects that are fitted to the end, by each of two rankings. So many are then extended by one
effect, and of so many at least the free runs are measured."""
GROWN = 8
"""Effects by which each of them is extended."""

# Errors of free runs, on the held-out runs

DECIDING_S = (0.1, SHORT_S, np.inf)
"""Those of `estimator.prediction.HORIZONS_S` that decide [s]: what a controller looks ahead, a swing, the whole run."""
SURE = 0.95
"""Least share of resampled held-out runs in which a statement holds. Two explanations are told apart with this
probability, and by this share of what the runs have for and against it."""
SUFFICES = 0.5
"""Least share of the explainable error that the named causes must explain; otherwise they imitate something else.

Explainable: by listed effects and generic terms together. The same share holds for what they explain of the readings,
by likelihood. For `partial` it is also the least share of the mean square error beyond noise. An effect that explains
as much of what a cause explains is tried in its place, and the cause is said to be confusable with it."""
GENERIC_TERMS = 4
"""Most generic terms, which represent what the library does not list."""
EDGE = 1.0 + SUFFICES
"""Ratio to what the rig's noise leaves up to which an error is put down to that noise.

Of free runs (see `noise_floor`): beyond it explanations are sought even where no term is detected, a nominal model that
is not explained is `unexplained`, and a cause that leaves more is `partial`. Of a sensor: its fitted noise over what
the rig declares (see `noise_ratios`)."""

# Numerics: the resolution of tests and of simulated noise

WHOLE_RUNS = 16
"""Replicates, of all runs that are measured together, whose free runs over whole runs say what noise leaves."""
DRAWS = 400
"""Number of bootstrap resamples of the held-out runs."""
