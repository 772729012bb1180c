"""Runs that no fit can use are set aside by name, with the reason; the rest goes on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq import Dataset, FloatArray
from estimator import FIT_ERRORS, FitError, FitOptions, GapError
from estimator.fitting import design_rows, free_mask, weighted_least_squares
from estimator.model import Mechanism
from estimator.signals import angle_column, imu_columns, split_signals, torque_column

FEWEST = 3
"""Fewest other runs with which one is compared."""
STILL_SHARE = 0.01
"""A joint whose range in a run is below this share of its range in the others stands still there."""
STRANGE_LEFT, STRANGE_TIMES = 0.6, 3.0
"""A run is of another rig if its residual under the others' parameters exceeds both limits.

They are a share of its slow torque, and a multiple of the median run's residual.
(Measured: at most 0.54 and 2 times on 20 runs of real records.)"""


@dataclass(frozen=True)
class SetAside:
    """A run that is not used."""

    run: str
    why: str

    def __str__(self) -> str:
        return f"{self.run} is set aside: {self.why}"

    @property
    def document(self) -> dict[str, str]:
        """For the JSON documents."""
        return {"run": self.run, "why": self.why}


def usable_runs(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions
                ) -> tuple[tuple[Dataset, ...], tuple[SetAside, ...]]:
    """The runs that can be used, and those that cannot. Of a single run nothing is set aside.

    Raises `FitError` where none is left, with the reasons.
    """
    if len(datasets) < 2:
        return tuple(datasets), ()
    gone: dict[int, str] = {}
    for k, data in enumerate(datasets):
        why = _broken(data, mechanism, options)
        if why:
            gone[k] = why
    gone |= _stuck([d if k not in gone else None for k, d in enumerate(datasets)], mechanism, options)
    gone |= _strange([d if k not in gone else None for k, d in enumerate(datasets)], mechanism, options)
    kept = tuple(data for k, data in enumerate(datasets) if k not in gone)
    aside = tuple(SetAside(datasets[k].name, why) for k, why in sorted(gone.items()))
    if not kept:
        raise FitError("no run is left: " + "; ".join(map(str, aside)))
    return kept, aside


def _broken(data: Dataset, mechanism: Mechanism, options: FitOptions) -> str:
    try:
        split_signals([data], mechanism, options)
    except GapError:
        imus = [name for k in range(len(mechanism.imus)) for name in imu_columns(k)]
        needed = [c for c in (*imus, *_columns(mechanism, options)) if c in data]
        worst = max(needed, key=lambda c: int(np.sum(~np.isfinite(data[c]))))
        share = float(np.mean(~np.isfinite(data[worst])))
        return (f"it has no segment of 20 samples without a gap at {data.rate_hz:g} Hz ({100 * share:.0f} % of {worst} "
                "is missing); a lower rate_hz under [sampling] bridges pauses of its sampling")
    except FitError:  # a missing column is an input error
        pass
    return ""


def _columns(mechanism: Mechanism, options: FitOptions) -> list[str]:
    return [*(angle_column(mechanism, j) for j in options.encoders_of(mechanism.n)),
            *(torque_column(mechanism, j) for j in mechanism.actuated)]


def _stuck(datasets: Sequence[Dataset | None], mechanism: Mechanism, options: FitOptions) -> dict[int, str]:
    """Runs in which a driven joint stands still under a changing torque, or a torque never changes, unlike others."""
    found: dict[int, str] = {}
    for j in mechanism.actuated:
        angle, torque = angle_column(mechanism, j), torque_column(mechanism, j)
        spans = {k: (_span(d[angle]), _span(d[torque])) for k, d in enumerate(datasets)
                 if d is not None and angle in d and torque in d}
        usual = np.median([s for s, _ in spans.values()]) if spans else 0.0
        pushes = np.median([t for _, t in spans.values()]) if spans else 0.0
        for k, (moved, pushed) in spans.items():
            data = datasets[k]
            assert data is not None
            if moved < STILL_SHARE * usual and pushed > STILL_SHARE * pushes:
                found[k] = (f"joint {j + 1} never moves in it ({angle} within {moved:.1g}, {usual:.2g} in the others), "
                            "though its torque changes: locked, or the encoder is stuck")
            elif pushed == 0.0 < pushes and moved >= STILL_SHARE * usual and np.nanmax(np.abs(data[torque])) > 0.0:
                found[k] = f"{torque} never changes in it: the reading is stuck"
    return found


def _span(values: FloatArray) -> float:
    return float(np.nanmax(values) - np.nanmin(values)) if np.isfinite(values).any() else 0.0


def _strange(datasets: Sequence[Dataset | None], mechanism: Mechanism, options: FitOptions) -> dict[int, str]:
    """Runs whose slow torque is nothing like what the others' parameters make: of another rig, or wired otherwise."""
    known = {k: d for k, d in enumerate(datasets) if d is not None}
    if len(known) <= FEWEST or options.fixed or not mechanism.actuated:
        return {}
    slow = replace(options, cutoff_hz=min(3.0, options.cutoff(next(iter(known.values())).rate_hz)), hold="linear")
    try:
        with np.errstate(all="ignore"):
            blocks = {k: design_rows(split_signals([d], mechanism, slow), mechanism, slow) for k, d in known.items()}
            free, start = free_mask(mechanism, slow)
            driven = list(mechanism.actuated)
            left = np.zeros((len(blocks), len(driven)))
            power = np.maximum(np.median([np.mean(b.torque[:, driven] ** 2, axis=0) for b in blocks.values()], axis=0),
                               1e-300)  # a run that hardly drives a joint says little of its torque
            for row, (k, own) in enumerate(blocks.items()):
                others = [b for i, b in blocks.items() if i != k]
                beta, _, _ = weighted_least_squares(np.concatenate([b.z for b in others]),
                                                    np.concatenate([b.torque for b in others]), free, start, 1.0)
                mine = np.maximum(np.mean(own.torque[:, driven] ** 2, axis=0), power)
                left[row] = np.sqrt(np.mean((own.torque - own.z @ beta)[:, driven] ** 2, axis=0) / mine)
    except (*FIT_ERRORS, ValueError):
        return {}
    usual = np.median(left, axis=0)
    worst, j = divmod(int(np.argmax(left / usual)), len(driven))  # one run: it also spoils the others' figures
    share, others_share = float(left[worst, j]), float(usual[j])
    if share < STRANGE_LEFT or share < STRANGE_TIMES * others_share:
        return {}
    return {list(blocks)[worst]: f"the other runs' parameters do not explain {100 * share:.0f} % of its torque of "
            f"joint {driven[j] + 1} ({100 * others_share:.0f} % of the median run's): it is of another rig, or one of "
            "its columns is read differently"}
