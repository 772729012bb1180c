"""Thresholds of the verdict, in the order in which a diagnosis applies them.

A cause is *present* if it is significant, repeats between runs and is possible. It is *material* if it reduces the
free-run error of the held-out runs by more than a stated share. Present causes often are not material: they do not
change the simulation. Generic terms show a material error that no listed effect explains.

Gains are twice the log likelihood (no unit), over the scatter between runs. Limits on the steps of a fit are in `refit`
and `search`. docs/decisions.md says how the thresholds were chosen.
"""

from __future__ import annotations

import numpy as np

# The runs

LEAST_S = 8.0
"""Shortest data that are diagnosed, all runs together [s]."""
FEW_RUNS = 6
"""Below this many runs a warning says that their scatter is poorly known."""
HELD_OUT = (1, 2)
"""Held-out places among four neighbours in excitation, alternating: neither the strongest nor the weakest run."""
PARTS = 8
"""Segments into which a single run is cut."""

# What is detected

ALPHA = 0.01
"""p-value, over all candidates tried, below which something is there."""
LEAST_GAIN = 0.01
"""Least gain of an effect that is looked at, a sample. Smaller ones can be significant in long records (microseconds of
skew, a per mille of scale) and change no simulation."""
LEAST_GAIN_CLEAR = 0.4
"""... or this share of it where an effect of the library does not act near rest."""
HIDDEN = 1e-5
"""Candidates whose information after projection is below this share are not tested; nor are combinations of sizes. A
fitted size of which the other parameters leave less is not determined."""
PRIOR_RUNS = 8
"""Weight of the pooled scatter, in runs, relative to a candidate's own."""
REPLICATES = (2, 16)
"""Fewest and most replicates of each run, in between as many as make up ..."""
REPLICATED_SAMPLES = 24_000
"""... so many samples in all: with two of short records a verdict hangs on the seed."""
BAD_REPLICATE = 1.5
"""Times the run's own sum of squares above which a replicate is left out."""
LENT_BIAS = 3.0
"""Most by which a bias lent from other runs is scaled up to what a run informs of."""

# Noise levels: what a model lacks can hide there

NOISY_SENSOR, NOISY_UNDECLARED = 1.3, 2.0
"""How many times its level a sensor's noise may be: of a declared sensor, of one that is judged by its neighbouring
samples."""

# Which models are tried

MOST_EFFECTS = 3
"""Most effects of an explanation."""
PARENTS, GROWN = 3, 8
"""Sets of effects that are scored and extended by one, and number of effects by which each is."""
FINALISTS = 3
"""Sets of each number of effects that are fitted to the end, by each of two rankings."""
ZERO_WITHIN = 4.0
"""Standard deviations within which a size is not significant: friction smoothing alone moves sizes by two."""
COLLINEAR = 0.9
"""Cosine above which one effect is tried in another's place."""

# Which of them these runs cannot tell apart

TIE = 0.005
"""Explanations within this share of the best one's gain are not told apart ..."""
TIE_GAIN = 8.0
"""... or within this much gain ..."""
TIE_ALIKE = 0.02
"""... nor those that differ by one effect for another of its `Effect.equivalence_class` within this share ..."""
AGREE = 0.6
"""... nor where runs disagree: their differences in misfit sum to less than this share of their absolute values ..."""
WIDEST = 0.1
"""... and to less than this share of the gain."""

# Errors of free runs, on the held-out runs

DECIDING_S = (0.1, 1.0, np.inf)
"""Those of `estimator.prediction.HORIZONS_S` that decide [s]: what a controller looks ahead, a swing, the whole run."""
BLOCK_S = 2.0
"""Length of a block that is resampled [s]: a few periods of the slowest motion."""
DRAWS = 400
"""Number of bootstrap resamples of the held-out runs."""
SURE = 0.95
"""Least share of resampled held-out runs in which a statement holds."""
MATERIAL = 0.1
"""Material: the smallest relative reduction of the free-run rms error that counts (`--material`)."""
SUFFICES = 0.5
"""Least share of the explainable error that the named causes must explain; otherwise they imitate something else.

Explainable: by listed effects and generic terms together. For `partial` also the least share of the mean square error
beyond noise."""
GENERIC_TERMS = 4
"""Most generic terms, which represent what the library does not list."""
SHORTLIST, SHORTLIST_EACH = 6, 2
"""Explanations whose free runs are measured, and how many of each number of effects at least: the likeliest."""
EDGE = 1.5
"""Error of a free run, in units of what the rig's noise leaves, up to which it is put down to that noise (see
`noise_floor`). Beyond it explanations are sought even where no term is detected. A nominal model that errs more and is
not explained is `unexplained`; a cause that leaves more is `partial`."""

# What is reported in addition to a verdict

CONFUSABLE = 0.7
"""Cosine above which a cause is said to be confusable with an effect."""
CHANGED = 4.0
"""Standard deviations by which a parameter differs from a reference's for it to be reported as changed."""
SHORT_S = 1.0
"""Length of the pieces [s] that are simulated where noise, added up over a whole run, hides what is gained."""
