"""The numbers by which a verdict is reached on the runs kept back; those that steer the search for explanations stand
with it, in context, model_search and model_comparison.

Detection outruns what matters: on every real rig a dozen small things are seen beyond doubt and change no simulation.
So a cause is said to be present where it is detected, replicates and can be; it *matters* where the simulation's error
on runs that chose nothing falls by more than a stated share when it is added. What matters and has no name is known
by a generic extension, which needs no library.
"""

from __future__ import annotations

ALPHA = 0.01
"""p-value, over all candidates tried, below which something is there."""
MATERIAL = 0.1
"""Share by which the rms error of free runs must fall for a cause to matter; the user's to set (`--material`)."""
SURE = 0.95
"""Share of resampled runs, of those that chose nothing, in which what is said must hold."""
SUFFICES = 0.5
"""Least share of what can be explained at all, listed effects and terms without a name together, that the named causes
must explain for them to be the answer, in part or whole: less, and they imitate something else."""
GENERIC_TERMS = 4
"""Most terms without a name that stand for what a library does not list."""
SHORTLIST = 6
"""Explanations whose free runs are measured, the likeliest of each number of effects first."""
DRAWS = 400
"""Resamplings of the runs kept back."""
EDGE = 3.0
"""Error of the nominal free run, in units of what white noise alone leaves, beyond which it is not put down to a
disturbance with memory: such a disturbance adds up over a free run. Beyond it explanations are sought even where no
term is detected, and where none lowers the error the verdict is `unexplained`; below it `none`, with a warning. What
surely errs more beside a cause, and by more than what matters, leaves it `partial`."""
