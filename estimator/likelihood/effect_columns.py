"""Torques and readings that effects add to a model at one motion, and their derivatives by sizes: columns.

Effects are evaluated on the current motion. The Gauss-Newton matrix includes the derivatives of torque laws by their
joint's motion, without which laws with a large slope near rest do not converge. It neglects those of memory and
readings, which costs iterations only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from daq import FloatArray
from estimator.effects import FEATURES, Around, Effect, Perturbation, StateTorque, TorqueEffect, View, by_motion
from estimator.likelihood.normal_equations import Extra, ReadingColumns
from estimator.likelihood.stage import Candidate
from estimator.model import RATE
from estimator.signals import Channel

Sized = Sequence[tuple[Effect, FloatArray]]
"""Effects, each with its sizes and shapes."""
LEAST_FALL = 0.01
"""Where `fixed_point` divides by less than this share of the torque, the link has next to no inertia left."""
SIZE_STEP = 0.1
"""Step of a central difference by a size, as a share of the size's scale."""
SHAPE_STEP, LEAST_SHAPE_STEP = 1e-3, 1e-9
"""By a shape, as a share of it; and what is added for a shape of zero."""


def acting(pairs: Sized, free: View, inverse: FloatArray
           ) -> tuple[View, FloatArray, FloatArray, dict[Channel, FloatArray]]:
    """View that effects have of the motion, and what they add to torques and readings there, as `added` has it.

    `free` is the view without their torques, `inverse` (n, n, N) that of the inertia matrix at the samples.
    """
    torque, at_samples, readings = added(pairs, free)
    view, first = free, at_samples
    if first.any():
        view = braked(free, inverse, first)
        torque, at_samples, readings = added(pairs, view)
        if not np.array_equal(first, at_samples):  # what an effect takes changes the acceleration it feels
            view = braked(free, inverse, fixed_point(first, at_samples))
            torque, at_samples, readings = added(pairs, view)
    return view, torque, at_samples, readings


def fixed_point(first: FloatArray, second: FloatArray) -> FloatArray:
    """x = F(x) (n, N) by F(0) and F(F(0)): Aitken's step, exact of a joint whose torque is linear in its acceleration.

    F itself only contracts for a rotor of less than its link's inertia.
    """
    fall = 2.0 * first - second
    return np.divide(first**2, fall, out=second.copy(), where=np.abs(fall) > LEAST_FALL * np.abs(first))


def derivatives_of(pairs: Sized, candidates: Sequence[Candidate], view: View) -> list[Perturbation]:
    """Derivatives by each size and shape of the effects, then by each size of the candidates at zero."""
    out = [one for effect, size in pairs for one in slopes(effect, view, size)]
    return out + [one for candidate in candidates for one in slopes_at_zero(candidate, view)]


def columns_of(derivatives: Sequence[Perturbation], view: View
               ) -> tuple[FloatArray, FloatArray, np.ndarray, dict[Channel, ReadingColumns]]:
    """Columns at Gauss points (k, n, 2, K) and at samples (k, n, N), whether each acts at a joint (k, n), and columns
    of the readings."""
    k, n = len(derivatives), len(view.samples.q)
    at_gauss, at_samples = (np.zeros((k, *at.q.shape)) for at in (view.gauss, view.samples))
    acts = np.zeros((k, n), bool)
    rows: dict[Channel, list[int]] = {}
    for i, d in enumerate(derivatives):
        if d.torque is not None and d.torque_at_samples is not None:
            at_gauss[i], at_samples[i] = d.torque, d.torque_at_samples
            acts[i] = d.torque.any(axis=(1, 2))
        for channel in d.readings:
            rows.setdefault(channel, []).append(i)
    readings = {channel: ReadingColumns(np.array(which), np.stack([derivatives[i].readings[channel] for i in which]))
                for channel, which in rows.items()}
    return at_gauss, at_samples, acts, readings


def extra_of(pairs: Sized, candidates: Sequence[Candidate], free: View, inverse: FloatArray, with_columns: bool
             ) -> Extra:
    """Contributions of effects, see `acting`, and their derivatives by the motion.

    `with_columns` those by sizes and candidates are in, too.
    """
    view, torque, at_samples, readings = acting(pairs, free, inverse)
    derivatives = derivatives_of(pairs, candidates, view) if with_columns else []
    by_torque: dict[Channel, FloatArray] = {}
    for effect, size in pairs:
        for channel, slope in effect.by_torque(view, size).items():
            by_torque[channel] = by_torque.get(channel, 0.0) + slope
    return Extra(torque, at_samples, readings, *columns_of(derivatives, view), *law_slopes(pairs, view), by_torque)


def law_slopes(pairs: Sized, view: View) -> tuple[FloatArray | None, FloatArray | None]:
    """Derivatives of the torque laws by the features of the motion, at Gauss points (n, 5, n, 2, K) and at samples
    (n, 5, n, N); None without a law."""
    laws = [(part, s) for e, s in pairs if isinstance(e, TorqueEffect) for part in e.parts]
    if not laws:
        return None, None
    n, scale = len(view.samples.q), view.mechanism.velocity_scales
    at_gauss, at_samples = (np.zeros((n, 5, *at.q.shape)) for at in (view.gauss, view.samples))
    gauss, samples = Around(view.gauss), Around(view.samples)
    for law, size in laws:
        j = law.joint or 0
        joints = law.felt(n) if isinstance(law, StateTorque) else (j,)  # generic terms take their own joint's only
        for k, (around, out) in product(joints, ((gauss, at_gauss), (samples, at_samples))):
            found = by_motion(law, around, size, view, k)
            sign = found.pop("sign", None)
            for name, slope in found.items():
                out[j, FEATURES[name], k] += slope
            if sign is not None:
                out[j, RATE, k] += sign * np.maximum(1.0 - around.at.sign[k] ** 2, 0.0) ** 1.5 / scale[k]
    return at_gauss, at_samples


def braked(view: View, inverse: FloatArray, torque: FloatArray) -> View:
    """`view` of a motion that effects brake by `torque` (n, N) at the samples, where the inertia's `inverse` is (n, n,
    N)."""
    less = np.einsum("ijk,jk->ik", inverse, torque)
    return replace(view, samples=replace(view.samples, a=view.samples.a - less))


def added(pairs: Sized, view: View) -> tuple[FloatArray, FloatArray, dict[Channel, FloatArray]]:
    """Torque of effects of some size at Gauss points (n, 2, K) and at samples (n, N), and what they add to readings."""
    torque, at_samples = np.zeros_like(view.gauss.q), np.zeros_like(view.samples.q)
    readings: dict[Channel, FloatArray] = {}
    for effect, size in pairs:
        got = effect.perturb(view, size)
        if got.torque is not None and got.torque_at_samples is not None:
            torque += got.torque
            at_samples += got.torque_at_samples
        for channel, values in got.readings.items():
            readings[channel] = readings.get(channel, 0.0) + values
    return torque, at_samples, readings


def slopes(effect: Effect, view: View, size: FloatArray) -> list[Perturbation]:
    """Derivative by each size and shape, central differences."""
    steps = [s.scale * SIZE_STEP for s in effect.sizes]
    steps += [SHAPE_STEP * abs(v) + LEAST_SHAPE_STEP for v in size[len(effect.sizes) :]]
    effect = effect.about(size)
    return [_difference(effect.perturb(view, size + at), effect.perturb(view, size - at), 2.0 * h)
            for at, h in zip(np.diag(steps), steps)]


def slopes_at_zero(candidate: Candidate, view: View) -> list[Perturbation]:
    """Derivative by each size at zero, at the candidate's shape."""
    scales = [s.scale for s in candidate.effect.sizes]
    blank = np.append(np.zeros(len(scales)), candidate.shape)
    effect = candidate.effect.about(blank)
    return [_difference(effect.perturb(view, blank + at), Perturbation(), h)
            for at, h in zip(np.diag(np.append(scales, 0.0 * blank[len(scales) :])), scales)]


def _difference(a: Perturbation, b: Perturbation, by: float) -> Perturbation:
    def part(x: FloatArray | None, y: FloatArray | None) -> FloatArray | None:
        return None if x is None else (x - (0.0 if y is None else y)) / by

    readings = {k: (v - b.readings.get(k, 0.0)) / by for k, v in a.readings.items()}
    return Perturbation(part(a.torque, b.torque), part(a.torque_at_samples, b.torque_at_samples), readings)
