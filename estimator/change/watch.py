"""`Watch`: a sequential test whether a rig still is what its reference runs say, block by block of motion.

The local approach (Basseville and Nikiforov, Detection of Abrupt Changes, 1993, chapter 8): of each block the score of
the innovations' likelihood by every parameter, effect and generic term, at the reference model. Scores add up over
blocks. At the end of each block the generalised likelihood ratio compares "no change" with every single change
(`groups`) that began 1, 2, 4 or 8 blocks ago.

A window counts as one run: its own structure is integrated out once, so a drift that lasts for hours is no change while
reference runs drift as far. Left-out reference runs widen this further, change by change (`scale`): the variance of a
change's size is inverse chi-square a priori, so a ratio has Fisher's distribution.

The threshold is a weighted union bound: over all windows and changes a block alarms with at most the share of false
alarms that its length has of an hour. It needs no independence of blocks. Every effect has the same share of it,
however many shapes it is tried at (Genovese et al., Biometrika 93, 2006).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from daq import Dataset, FloatArray
from estimator.change.contrast import Contrast, contrast, seen
from estimator.change.groups import Group, groups_of
from estimator.change.reference import Reference
from estimator.change.scores import score_run
from estimator.change.structure import PRIOR_RUNS
from estimator.errors import FitError
from estimator.loops import LAW_FAULTS, LawChange, changed_law, without_changes
from estimator.score import HIDDEN, Score, total

BLOCK_S = 5.0
WINDOWS = (1, 2, 4, 8)
"""Blocks back to the change that is tried."""
HOUR_S = 3600.0


@dataclass(frozen=True)
class Block:
    """The test at the end of one block."""

    end_s: float
    """From the run's first sample"""
    seconds: float
    per_hour: float
    """False alarms per hour of a threshold that this block just reaches."""
    effect: str
    """The likeliest change"""
    joint: int | None
    since_s: float
    """Motion from where that change began to the end of the block"""


@dataclass(frozen=True)
class WatchedRun:
    """All blocks of one run."""

    run: str
    blocks: tuple[Block, ...] = ()
    alarm: Block | None = None
    """The first block below the threshold"""
    failed: str = ""
    """Why the run was not tested."""

    @property
    def worst(self) -> Block | None:
        """The likeliest change."""
        return min(self.blocks, key=lambda b: b.per_hour, default=None)

    @property
    def seconds(self) -> float:
        """Motion that was tested."""
        return sum(b.seconds for b in self.blocks)


@dataclass
class Watch:
    """The test, with the blocks since its last alarm."""

    reference: Reference
    false_alarms: float
    """Per hour of motion."""
    groups: tuple[Group, ...]
    scale: FloatArray
    """(windows, groups) mean of the left-out reference runs' statistic over that without structure of its own"""
    recent: list[tuple[float, Score]] = field(default_factory=list)
    """Length [s] and score of the latest blocks."""

    def test(self, run: Dataset) -> WatchedRun:
        """All blocks of `run`, the next one in time. After an alarm the test starts anew.

        The laws of its position loops are tested first; the blocks are without what these show.
        """
        found: list[Block] = []
        alarm = None
        if not self.reference.law.empty:
            model = self.reference.fit.model.mechanism
            changes = changed_law(self.reference.law, [run], model)
            alarm = self._by_law(run, changes)
            (run,) = without_changes([run], model, changes)
        try:
            for part in blocks_of(run):
                score = score_run(self.reference.fit, part)
                self.recent = [*self.recent[1 - WINDOWS[-1] :], (len(part) / part.rate_hz, score)]
                found.append(self._block(float(part.time_s[-1] - run.time_s[0])))
                if found[-1].per_hour < self.false_alarms:
                    alarm = alarm or found[-1]
                    self.recent = []
        except (FitError, np.linalg.LinAlgError) as error:
            self.recent = []
            return WatchedRun(run.name, tuple(found), alarm, str(error))
        return WatchedRun(run.name, tuple(found), alarm)

    def _by_law(self, run: Dataset, changes: Sequence[LawChange]) -> Block | None:
        """An alarm at the end of a run whose loop has another law than the reference runs."""
        best = min(changes, key=lambda one: one.cause.p_value, default=None)
        if best is None:
            return None
        seconds = len(run) / run.rate_hz
        block = Block(float(run.time_s[-1] - run.time_s[0]), seconds,
                      min(1.0, best.cause.p_value * len(LAW_FAULTS)) * HOUR_S / seconds, best.cause.effect,
                      best.cause.joint + 1, seconds)
        return block if block.per_hour < self.false_alarms else None

    def _block(self, end_s: float) -> Block:
        lengths = np.array([seconds for seconds, _ in self.recent])
        best: tuple[float, int, int] = (2.0, 0, 1)
        for w, blocks in enumerate(WINDOWS):
            if blocks > len(self.recent):
                break
            own = total([score for _, score in self.recent[-blocks:]])
            best = min(best, (*self._likeliest(self._contrast(own, self.reference.known), w), blocks))
        p_value, k, blocks = best
        group = self.groups[k]
        return Block(end_s, float(lengths[-1]), min(1.0, p_value * len(WINDOWS)) * HOUR_S / float(lengths[-1]),
                     group.effect, group.joint, float(lengths[-blocks:].sum()))

    def _contrast(self, own: Score, known: Score) -> Contrast:
        structure = self.reference.structure
        return contrast(seen([own], structure)[0], known, structure)

    def _likeliest(self, one: Contrast, window: int) -> tuple[float, int]:
        """p-value over all changes, and index of the likeliest single change. A body is fitted only where free sizes,
        which fit no worse, are the likeliest."""
        gains = self._gains(one, free=True)
        bodies = {k for k, g in enumerate(self.groups) if g.body}
        while True:
            p = self._tried * fdtrc(self.width, self.reference.structure.freedom,
                                    gains / self.width / self.scale[window])
            k = int(np.argmin(p))
            if k not in bodies:
                return float(p[k]), k
            bodies.remove(k)
            gains[k] = self.groups[k].fit(one.along(self.groups[k].basis))[1]

    @cached_property
    def width(self) -> FloatArray:
        """(groups,) number of sizes of each."""
        return np.array([float(len(g.names)) for g in self.groups])

    @cached_property
    def _tried(self) -> FloatArray:
        """(groups,) inverse of each one's share of the false alarms: every effect of every joint has the same, and its
        shapes have equal parts of that."""
        keys = [(*g.key, g.names if g.effect == "parameter" else ()) for g in self.groups]
        return np.array([float(len(set(keys)) * keys.count(key)) for key in keys])

    @cached_property
    def _bases(self) -> FloatArray:
        """(m, sizes) change of all columns by every size of every group."""
        return np.concatenate([g.basis for g in self.groups], axis=1)

    @cached_property
    def _alike(self) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
        """Groups of each number k of sizes: (n,) their indices, (n, k) those of their sizes in `_bases`."""
        first = np.cumsum(self.width) - self.width
        members = [(np.flatnonzero(self.width == k), int(k)) for k in np.unique(self.width)]
        return [(which, first[which, None].astype(int) + np.arange(k)) for which, k in members]

    def _gains(self, one: Contrast, free: bool = False) -> FloatArray:
        """(groups,) fall of -2 log likelihood, as `Group.fit` gives it; `free`: of bodies whose sizes may be any."""
        every, found = one.along(self._bases), np.zeros(len(self.groups))
        for which, sizes in self._alike:
            information, score = every.information[sizes[:, :, None], sizes[:, None, :]], every.score[sizes]
            scale = np.sqrt(np.maximum(np.diagonal(information, axis1=1, axis2=2), 1e-300))
            square = scale[:, :, None] * scale[:, None, :]
            covariance = np.linalg.pinv(information / square, HIDDEN, hermitian=True) / square
            found[which] = np.einsum("nk,nkl,nl->n", score, covariance, score)
        for k, group in enumerate(self.groups):
            if group.body and not free:
                found[k] = group.fit(one.along(group.basis))[1]
        return np.maximum(found, 0.0)

    def calibrate(self, runs: Sequence[Dataset]) -> None:
        """Set `scale` by the reference `runs`, each against the others. Raises `FitError`."""
        every = [[score_run(self.reference.fit, part) for part in blocks_of(run)] for run in runs]
        wholes = seen([total(parts) for parts in every], self.reference.structure)
        for w, blocks in enumerate(WINDOWS):
            means = []
            for k, parts in enumerate(every):
                others = total(wholes[:k] + wholes[k + 1 :])
                ends = range(min(blocks, len(parts)), len(parts) + 1)
                means.append(np.mean([self._gains(self._contrast(total(parts[max(end - blocks, 0) : end]), others))
                                      for end in ends], axis=0) / self.width)
            self.scale[w] = np.maximum(1.0, (PRIOR_RUNS + np.sum(means, axis=0)) / (PRIOR_RUNS + len(means)))


def start_watch(reference: Reference, false_alarms: float, runs: Sequence[Dataset] = ()) -> Watch:
    """The test against `reference`, calibrated on its left-out `runs` if these are at hand. Raises `FitError`."""
    groups = groups_of(reference.fit, reference.known)
    watch = Watch(reference, false_alarms, groups, np.ones((len(WINDOWS), len(groups))))
    if runs:
        watch.calibrate(runs)
    return watch


def blocks_of(run: Dataset) -> Iterator[Dataset]:
    """Parts of a run of about `BLOCK_S` each."""
    count = max(1, round(len(run) / run.rate_hz / BLOCK_S))
    edges = np.linspace(0, len(run), count + 1).round().astype(int)
    for begin, end in pairwise(edges):
        yield run.part(slice(int(begin), int(end)))
