"""Samples that one sensor has lost, or doubled, against the others: from a row on its readings are early, or late.

The equation of motion holds over the whole record with the readings of that sensor moved behind that row, and with no
constant delay of it. Parts before and behind a row are fitted together, by slow least squares.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from daq import Dataset, FloatArray, IndexArray
from estimator.calibration.readings import (
    Motion,
    as_it_is,
    filtered_motion,
    nothing_changed,
    slow_rows,
)
from estimator.calibration.windows import inverse
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.signals import angle_column, imu_columns, torque_column

ASKED = 0.025
"""Residual of slow least squares, as a share of the torque, above which lost samples are looked for."""
COUNTS = 1, 2, 3, 4, 6, 8, 10, 13, 16, 20, 25, 31, 38, 46
"""Samples that are looked for in one place, then those between the neighbours of the best one."""
BETTER, THAN_DELAYED = 1.5, 1.3
"""The mean square of the residual falls by so much, and is so much below that of a constant delay."""
BLOCK_S, LEAST_BLOCKS = 0.25, 8
"""A row is looked for in blocks; so many lie before it and behind it."""
AROUND = 2
"""Blocks before the row and behind it that are left out: the filters spread the jump over them."""
UNSURE_S = 0.15
"""Samples around the row that are left out: the low pass places it no better."""


class LostSamples(NamedTuple):
    """One place in a run."""

    columns: tuple[str, ...]
    row: int
    """First sample, from 0, that is early or late"""
    samples: int
    """Samples lost before it; doubled ones are negative"""


def find_lost(data: Dataset, mechanism: Mechanism, options: FitOptions) -> LostSamples | None:
    """The place in a run at which samples of one sensor are lost or doubled; None where there is none.

    Raises `FitError` for a run without a segment.
    """
    if mechanism.exchanged or not mechanism.actuated or as_it_is([data], mechanism, options).left < ASKED:
        return None
    whole = filtered_motion([data], mechanism, options)
    if len(whole.ends) != 1 or len(whole.q) != len(data):  # behind a gap rows are not known
        return None
    still = _Rows(whole, mechanism, options)
    if still.blocks < 2 * LEAST_BLOCKS:
        return None
    best: tuple[float, LostSamples] | None = None
    blocks = np.arange(LEAST_BLOCKS, still.blocks - LEAST_BLOCKS)
    unmoved = still.left(still, blocks)
    for columns, group in _groups(mechanism, options):
        moved, gains = dict[int, _Rows](), dict[int, FloatArray]()
        counts, fine = [sign * count for count in COUNTS for sign in (-1, 1)], 0
        for _ in range(2):
            for count in set(counts) - moved.keys():
                moved[count] = rows = _Rows(_moved(whole, group, count), mechanism, options)
                gains[count] = unmoved / still.left(rows, blocks)
            fine = max(gains, key=lambda count: gains[count].max())
            counts = [count for count in range(-COUNTS[-1], COUNTS[-1]) if count * fine > 0 and
                      0.7 * abs(fine) < abs(count) < 1.4 * abs(fine)]
        k = int(np.argmax(gains[fine]))
        gain, block = float(gains[fine][k]), blocks[k : k + 1]
        delayed = min(one.left(one, block)[0] for one in moved.values()) * gain / unmoved[k]
        if min(gain / BETTER, delayed / THAN_DELAYED) > 1.0 and (best is None or gain > best[0]):
            place = still.row(moved[fine], blocks[k])
            best = gain, LostSamples(columns, min(place, len(data) - 1), fine)
    return None if best is None else best[1]


def without_loss(data: Dataset, lost: LostSamples) -> Dataset:
    """The run with the readings behind the row moved back to their times; those around it are NaN."""
    around, columns = int(np.ceil(UNSURE_S * data.rate_hz)), dict(data.columns)
    for name in lost.columns:
        x = data[name].copy()
        behind = np.full(len(x) - lost.row, np.nan)
        take = x[max(lost.row - lost.samples, 0):][:len(behind)]
        behind[:len(take)] = take
        x[lost.row:] = behind
        x[max(lost.row - around, 0):lost.row + max(lost.samples, 0) + around] = np.nan
        columns[name] = x
    return replace(data, columns=columns)


def _groups(mechanism: Mechanism, options: FitOptions) -> Iterator[tuple[tuple[str, ...], tuple[str, int]]]:
    """Columns of each device, and what of the motion they give: ("q", joint) or ("tau", 0)."""
    encoders = options.encoders_of(mechanism.n)
    for j in range(mechanism.n):
        yield (angle_column(mechanism, j),) if j in encoders else imu_columns(0), ("q", j)
    if mechanism.n > 1:  # of one joint it is the same as of its angle
        yield tuple(torque_column(mechanism, j) for j in mechanism.actuated), ("tau", 0)


def _moved(motion: Motion, group: tuple[str, int], count: int) -> Motion:
    """`motion` with one device's part later by `count` samples; the ends are held."""
    kind, joint = group
    rows = np.clip(np.arange(len(motion.q)) - count, 0, len(motion.q) - 1)
    if kind == "tau":
        return replace(motion, tau=motion.tau[rows])
    parts = {}
    for name in ("q", "qd", "qdd"):
        parts[name] = getattr(motion, name).copy()
        parts[name][:, joint] = parts[name][rows, joint]
    return replace(motion, **parts)


class _Rows:
    """Slow least squares of one motion in blocks."""

    def __init__(self, motion: Motion, mechanism: Mechanism, options: FitOptions) -> None:
        thinned = motion.thinned()
        slow = slow_rows(thinned, mechanism, options, nothing_changed(mechanism.n))
        (self.first, self.rows), *_ = slow.explained(np.eye(mechanism.n)) or [(0, np.zeros((0, mechanism.n, 1)))]
        self.thin = round(motion.rate_hz / thinned.rate_hz)
        self.length = max(1, round(BLOCK_S * thinned.rate_hz))
        self.blocks = len(self.rows) // self.length
        parts = self.rows[:self.blocks * self.length].reshape(self.blocks, self.length, *self.rows.shape[1:])
        self.sums: FloatArray = np.cumsum(np.einsum("wlna,wlnb->wnab", parts, parts), axis=0)

    def left(self, behind: _Rows, blocks: IndexArray) -> FloatArray:
        """Sums of squares of the residual with the rows of `behind` from each of the `blocks` on, without those around
        it."""
        gram = self._gram(behind, blocks)
        return gram[:, -1, -1] - np.sum(_solved(gram) * gram[:, :-1, -1], axis=1)

    def row(self, behind: _Rows, block: np.intp) -> int:
        """First sample of the run that is better taken from `behind`, by parameters that both parts give."""
        found = np.append(_solved(self._gram(behind, block)), -1.0)
        squares = [np.sum((one.rows @ found) ** 2 * self.weights, axis=1) for one in (self, behind)]
        gain = np.cumsum(squares[0] - squares[1])
        return (self.first + int(np.argmin(gain)) + 1) * self.thin

    @property
    def weights(self) -> FloatArray:
        """(n,) of the joints: one over the mean square of what is to be explained, of the largest for those without."""
        torque = self.sums[-1][:, -1, -1]
        return np.asarray(1.0 / np.maximum(torque, 0.1 * max(float(torque.max()), 1e-300)))

    def _gram(self, behind: _Rows, block: np.intp | IndexArray) -> FloatArray:
        total = behind.sums[-1] - behind.sums[block + AROUND - 1] + self.sums[block - AROUND - 1]
        return np.asarray(np.einsum("n,...nab->...ab", self.weights, total))


def _solved(gram: FloatArray) -> FloatArray:
    return np.asarray((inverse(gram[..., :-1, :-1], 1e-9) @ gram[..., :-1, -1:])[..., 0])


def lost_text(lost: LostSamples, time_s: float) -> str:
    """Sentence for a person, without the run's name."""
    many = f"{abs(lost.samples)} samples" if abs(lost.samples) > 1 else "one sample"
    what = f"{'has' if len(lost.columns) == 1 else 'have'} {'lost ' + many if lost.samples > 0 else many + ' twice'}"
    return (f"{', '.join(lost.columns)} {what} against the other columns at about {time_s:.4g} s (row {lost.row + 1}): "
            "the readings behind go back to their times")
