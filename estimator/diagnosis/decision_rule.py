"""Every number on which a verdict hangs, in the order in which a diagnosis asks them.

Detection outruns what matters: on every real rig a dozen small things are seen beyond doubt and change no simulation.
So a cause is said to be present where it is detected, replicates and can be; it *matters* where the simulation's error
on runs that chose nothing falls by more than a stated share when it is added. What matters and has no name is known
by a generic extension, which needs no library.

Gains are twice the log likelihood (no unit), over the scatter between runs. How many steps a fit may take, and from
where, stands with the fits (`refit`, `candidate_fit`). What was measured for a number is in docs/decisions.md.
"""

from __future__ import annotations

import numpy as np

# The runs

LEAST_S = 8.0
"""Shortest data that are diagnosed, all runs together [s]."""
FEW_RUNS = 6
"""Below this many runs a warning says that their scatter is poorly known."""
KEPT_BACK = (1, 2)
"""Which of four neighbours in excitation is kept back, in turn: neither the strongest nor the weakest of all runs."""
PARTS = 8
"""Stretches into which a single run is cut."""

# What is detected

ALPHA = 0.01
"""p-value, over all candidates tried, below which something is there."""
LEAST_GAIN = 0.01
"""Least gain of an effect that is looked at, a sample. Smaller ones can be significant in long records (microseconds of
skew, a per mille of scale) and change no simulation."""
LEAST_GAIN_CLEAR = 0.4
"""... or this share of it where an effect of the library does not act near rest."""
HIDDEN = 1e-5
"""A candidate that the nominal parameters imitate but for this share of its information is not tested: what is left is
rounding. Nor is a combination of its sizes: on one run a drift over the session and one within the run are the same."""
PRIOR_RUNS = 8
"""Runs that the pooled scatter counts for beside a candidate's own."""
REPLICATES = (2, 16)
"""Fewest and most replicates of each run, in between as many as make up ..."""
REPLICATED_SAMPLES = 24_000
"""... so many samples in all: with two of short records a verdict hangs on the seed."""
BAD_REPLICATE = 1.5
"""Times the run's own sum of squares above which a replicate is left out."""
LENT_BIAS = 3.0
"""Most by which a bias lent from other runs is scaled up to what a run informs of."""

# Noise levels: what a model lacks can hide there

LOUD_SENSOR, LOUD_UNDECLARED, LOUD_TORQUE = 1.3, 2.0, 1.6
"""How many times its level a channel's noise may have: of a declared sensor, of one that is judged by its neighbouring
samples, and of torque, for a room and a motor add some to the shunt's noise."""
STILL_LOUD = 0.2
"""... or this share of what the nominal fit had beyond its level, in variance: functional forms differ."""

# Which models are tried

WORTH_TRYING = 0.5
"""p-value, over all candidates tried, from which an effect is not re-fitted."""
FIRST_SINGLES = 2
"""Best effects beside which friction's rounding is sought before anything else is tried."""
SINGLES = 5
"""Best effects that are re-fitted one by one, beside ..."""
SCATTERED = 2
"""... the best of the others by gains that are not divided by their own scatter between runs: what is badly missing
scatters by itself."""
HOPELESS = 0.1
"""Share of the log likelihood that the best gains, each under its own noise, below which a fit is given up: what leads
to the truth gains nearly all that can be gained."""
COMPARED = 6
"""Most fits that are compared under the noise of the best: the likeliest under their own."""
MOST_ASSESSED = 4
"""Of them, those whose rest is looked at: the likeliest."""
PARENTS = 2
"""Best singles that are extended to pairs where none closes."""
PAIRS, TRIPLES = 3, 2
"""Second effects that are tried beside these together, and third ones beside the best pair."""
MOST_GROWN = 3
"""Of them, those whose rest is looked at: the likeliest."""
COLLINEAR = 0.9
"""Cosine above which one effect is tried in another's place."""

# Which of them close: what they leave over is no other cause

LEFT_OVER = 0.03
"""What a cause may leave for others on the discover runs: this share of its own gain. Functional forms differ."""
LEFT_AT_REST = 0.15
"""... and this share to another friction near rest at its joint."""
STILL_LEFT = 0.1
"""Share of what a single leaves that a second cause may still leave beside it: forms differ, as above. By the same
share of its gain another may be likelier, under its own noise, than a single that closes."""
NIL = 4.0
"""Standard deviations within which a size is nil: the rounding of dry friction near rest alone moves sizes by two."""
RIVAL = 0.5
"""An explanation with less than this share of the best one's gain leaves the rest of it unexplained: not a rival."""

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

# Errors of free runs, on the runs kept back

HORIZONS_S = (0.1, 1.0, np.inf)
"""Lengths of the pieces [s]: what a controller looks ahead, a swing, and the whole run. Long free runs of a leg that
sticks are chaotic, and tell nothing of friction near rest; short ones do not add up what is slow."""
BLOCK_S = 2.0
"""Length of a block that is resampled [s]: a few periods of the slowest motion."""
DRAWS = 400
"""Resamplings of the runs kept back."""
SURE = 0.95
"""Share of resampled runs, of those that chose nothing, in which what is said must hold."""
MATERIAL = 0.1
"""Share by which the rms error of free runs must fall for a cause to matter; the user's to set (`--material`)."""
SUFFICES = 0.5
"""Least share of what can be explained at all, listed effects and terms without a name together, that the named causes
must explain for them to be the answer, in part or whole: less, and they imitate something else. And of the whole mean
square beyond noise, where they are the answer in part."""
GENERIC_TERMS = 4
"""Most terms without a name that stand for what a library does not list."""
SHORTLIST, SHORTLIST_EACH = 6, 2
"""Explanations whose free runs are measured, and how many of each number of effects at least: the likeliest."""
EDGE = 1.5
"""Error of a free run, in units of what the rig's noise leaves, up to which it is put down to that noise (see
`noise_floor`). Beyond it explanations are sought even where no term is detected. A nominal model that errs more and is
not explained is `unexplained`; a cause that leaves more is `partial`."""

FAR_WRONG = 3.0
"""Error of the nominal free run beyond which its fit may have hidden the one cause that there is. Then all other
effects are fitted, too, where none of the best closes."""

# What is told beside a verdict

CONFUSABLE = 0.7
"""Cosine above which a cause is said to be confusable with an effect."""
CHANGED = 4.0
"""Standard deviations by which a parameter differs from a reference's for it to be reported as changed."""
SHORT_S = 1.0
"""Length of the pieces [s] that are simulated where noise, added up over a whole run, hides what is gained."""
