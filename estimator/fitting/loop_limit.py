"""`limit_met`: the torque limit of a position loop that runs may meet, by least squares of their motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from daq import Dataset, FloatArray
from estimator.errors import FitError
from estimator.fitting.wls import Design, design_rows, free_mask, stacked
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.signals import SignalSet, earlier, split_signals

GRIDS: dict[str, tuple[float, ...]] = {
    "limit": tuple(np.geomspace(0.95, 0.05, 14)), "damping": (0.0, 0.01, 0.02, 0.04, 0.08),
    "delay_s": (0.0, 0.01, 0.03), "integral": (0.0, 0.1, 0.3, 0.8)}
"""Where the search begins: of a limit as a share of the largest torque that the law asks for, of damping and integral
over the gain, on top of what is stated."""
STEPS = {"limit": 0.05, "damping": 0.005, "delay_s": 0.003, "integral": 0.05}
"""By which it begins to move."""
NONE = {"limit": np.inf, "damping": 0.0, "delay_s": 0.0, "integral": 0.0}
"""Values of a loop that has none of them."""
FURTHEST = 3.0
"""Largest values over the largest of a grid"""
MOST_LEFT = 0.98
"""Residual with a limit over that without, as shares of the torque, up to which a limit is worth a fit.

The fit says whether runs meet it (`find_loop_terms`). Differences of angles leave a residual that no limit explains:
one that two of eight runs met took 14 % of it."""


def limit_met(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions, joint: int,
              unknown: Sequence[str]) -> dict[str, float] | None:
    """The limit [N m] of a joint's loop (0-based), and other `unknown` values, that explain its torque best.

    None where none is worth a fit.

    The torque is u = clip(w, +-l), w that of the law: the least of min over beta of |Z beta - u| / |u0 - mean u0| in
    the joint's own equation, by the best point of a grid and the simplex of Nelder and Mead from there. u0 is u without
    damping: u grows with it, and friction takes all of it up.
    """
    signals, (free, beta) = split_signals(datasets, mechanism, options), free_mask(mechanism, options)
    options = replace(options, half_power=None)
    try:
        design = design_rows(signals, mechanism, options)
    except FitError:
        return None
    from scipy.optimize import minimize  # 0.15 s to import, which a fit without a loop saves

    tried = _Tried(signals, design, joint, options)
    known = design.z[:, joint, ~free] @ beta[~free]
    basis, _ = np.linalg.qr(design.z[:, joint, free])
    keys = [key for key in GRIDS if key in unknown]
    others = [key for key in keys if key not in ("limit", "damping")]  # without a limit, damping is viscous friction

    def error(size: FloatArray, own: Sequence[str]) -> float:
        values = {**NONE, **dict(zip(own, size))}
        furthest = {key: 1.0 if key == "limit" else FURTHEST * GRIDS[key][-1] for key in own}
        if min(values.values()) < 0.0 or any(values[key] > most for key, most in furthest.items()):
            return 2.0  # worse than any
        torque = tried.torque(values) - known
        left = torque - basis @ (basis.T @ torque)
        plain = tried.torque({**values, "damping": 0.0}) if values["damping"] else torque + known
        return float(np.linalg.norm(left)) / max(float(np.linalg.norm(plain - plain.mean())), 1e-300)

    def best(own: Sequence[str]) -> tuple[float, FloatArray]:
        begin = min((np.array(one) for one in product(*(GRIDS[key] for key in own))), key=lambda one: error(one, own))
        if not own:
            return error(begin, own), begin
        simplex = np.vstack([begin, begin + np.diag([STEPS[key] for key in own])])
        settings: dict[str, Any] = {"method": "Nelder-Mead", "options": {"initial_simplex": simplex, "maxiter": 400}}
        found = minimize(error, begin, (own,), **settings)
        return float(found.fun), np.asarray(found.x)

    (bare, _), (least, size) = best(others), best(keys)
    bare = min(bare, error(size[1:], keys[1:]))
    return tried.stated({**NONE, **dict(zip(keys, map(float, size)))}) if least < MOST_LEFT * bare else None


@dataclass(frozen=True)
class _Tried:
    signals: Sequence[SignalSet]
    design: Design
    joint: int
    options: FitOptions

    @property
    def gain(self) -> float:
        commands = self.signals[0].commands
        loop = None if commands is None else commands.loops[self.joint]
        return 1.0 if loop is None else float(loop.gain)

    def wanted(self, values: Mapping[str, float]) -> list[FloatArray]:
        """w (N,) of each segment with the values in units of GRIDS."""
        found, j = [], self.joint
        for s, motion in zip(self.signals, self.design.motions):
            assert s.commands is not None
            command = s.commands.angle[:, j]
            late = earlier(command, values["delay_s"], s.rate_hz)
            summed = np.cumsum(late - motion.q[:, j]) / s.rate_hz
            more = late - command - values["damping"] * motion.qd[:, j] + values["integral"] * summed
            found.append(s.torque[:, j] + self.gain * more)
        return found

    def torque(self, values: Mapping[str, float]) -> FloatArray:
        """(m,) as the design has torques."""
        rate_hz, wanted = self.signals[0].rate_hz, self.wanted(values)
        limit = values["limit"] * max(float(np.nanmax(np.abs(one))) for one in wanted)
        return stacked([np.clip(one, -limit, limit) for one in wanted], rate_hz,
                       self.options.cutoff(rate_hz), self.options.filter_order)

    def stated(self, values: Mapping[str, float]) -> dict[str, float]:
        """The values as `[servo]` has them."""
        most = max(float(np.nanmax(np.abs(one))) for one in self.wanted(values))
        return {"limit": values["limit"] * most, "delay_s": values["delay_s"],
                **{key: values[key] * self.gain for key in ("damping", "integral")}}
