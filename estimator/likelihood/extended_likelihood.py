"""`ExtendedProblem`: the latent likelihood of a mechanism with effects, and the derivative of more of them.

Parameters are beta, then the sizes and shapes of each effect. Effects are evaluated on the current motion. The
Gauss-Newton matrix includes the derivatives of torque laws by their joint's motion, without which laws with a large
slope near rest do not converge. It neglects those of memory and readings, which costs iterations only.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np

from daq import FloatArray
from estimator.effects import (
    Backlash,
    Effect,
    GearEffect,
    Perturbation,
    Points,
    Record,
    StateTorque,
    StribeckFriction,
    TorqueEffect,
    View,
    by_motion,
)
from estimator.likelihood.noise import Noise
from estimator.likelihood.normal_equations import Extra, Latents, Linearised, ReadingColumns
from estimator.likelihood.trajectory_likelihood import LatentProblem
from estimator.likelihood.weighted_residuals import WeightedResiduals
from estimator.model import ACCEL, ANGLE, GAUSS, RATE, Mechanism, mean_sign, smooth_sign
from estimator.signals import GYRO, Channel, SignalSet, encoder_of, imu_columns, torque_of

SLOW_HZ = 12.0
SLOW_SHARE = 0.12
"""Of the rate, of a torque: below it a spline between samples changes nothing."""
PASSES = 3
"""Evaluations of the effects at the samples: of a rotor a tenth of the link's inertia they leave a thousandth."""


@dataclass(frozen=True)
class Candidate:
    """An effect at one point of its shape grid, to be scored at zero size."""

    effect: Effect
    shape: tuple[float, ...] = ()

    @property
    def width(self) -> int:
        """Number of columns: one a size."""
        return len(self.effect.sizes)


@dataclass(frozen=True)
class Stage:
    """Places and times of the segments of a record: what a `View` needs beyond the motion."""

    run: tuple[int, ...]
    """Number of the run of each segment."""
    session_s: tuple[float, ...]
    """Session time of each segment's first sample."""
    time_s: tuple[float, ...]
    """Time since the start of its run of each segment's first sample."""
    angle_range: FloatArray
    """(n, 2)"""
    gear_ratio: float = 1.0


class ExtendedProblem(LatentProblem):
    """`LatentProblem` whose parameter vector goes on after beta; see the module's text."""

    def __init__(self, signals: Sequence[SignalSet], mechanism: Mechanism, hold: str, stage: Stage,
                 effects: Sequence[Effect] = (), candidates: Sequence[Candidate] = (), disturbed: bool = False
                 ) -> None:
        super().__init__(signals, mechanism, hold, disturbed)
        self.stage, self.effects, self.candidates = stage, tuple(effects), tuple(candidates)
        lengths = np.diff(np.concatenate([[0], self.ends]))
        index = np.concatenate([np.arange(k) for k in lengths]) * self.dt
        which = np.repeat(np.arange(len(lengths)), lengths)
        self._run = np.asarray(stage.run, dtype=np.float64)[which]
        self._time = np.asarray(stage.time_s)[which] + index
        self._session = np.asarray(stage.session_s)[which] + index
        self._exchanged = np.repeat([float(s.exchanged) for s in signals], lengths)
        self._starts = np.concatenate([[0], self.ends[:-1]])

    @property
    def parameter_count(self) -> int:
        """Length of the parameter vector: beta, then the effects."""
        return self.mechanism.p + sum(e.count for e in self.effects)

    def dry_levels(self, beta: FloatArray) -> dict[int, float]:
        """Joint to its level of dry friction near rest [N m], with what the effects at the joint add."""
        found, at = super().dry_levels(beta), self.mechanism.p
        for effect in self.effects:
            size, at = beta[at : at + effect.count], at + effect.count
            if isinstance(effect, StribeckFriction) and effect.joint in found:
                found[effect.joint] += effect.level_at_rest(size)
        return found

    def view(self, x: Latents, beta: FloatArray, torque: FloatArray | None = None) -> View:
        """View of the effects at (x, beta); `torque` (n, N) is the torque of effects at the samples."""
        return self._seen(x, beta, torque)[0]

    def _seen(self, x: Latents, beta: FloatArray, torque: FloatArray | None = None) -> tuple[View, FloatArray]:
        """As `view`, and the inverse of the inertia matrix at the samples (n, n, N)."""
        m, c, left = self.mechanism, self.collocation, self.left
        motion = c.motion(x.q, x.v, left)
        taken = x.u if torque is None else x.u - torque.T
        qdd, inverse = c.fast.forward_dynamics(x.q, x.v, taken, beta)
        sign = mean_sign(motion.rate_from, motion.rate_to, m.velocity_scales[:, None, None])[0]
        gauss = Points(motion.angle, motion.rate, motion.accel, c.torque(x.u, left), sign, *self._gauss_times)
        samples = Points(x.q.T, x.v.T, qdd, x.u.T, smooth_sign(x.v.T, m.velocity_scales[:, None]), self._time,
                         self._session, self._run, self._exchanged)
        view = View(m, beta, gauss, samples, left, (GAUSS[0], GAUSS[1]), self._starts, self.dt, self.stage.angle_range,
                    self.stage.gear_ratio)
        return view, inverse

    @cached_property
    def _gauss_times(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """(2, K) time in the run, time in the session, number of the run, and which leg stands at the Gauss points."""
        left = self.left

        def between(values: FloatArray) -> FloatArray:
            return np.stack([values[left] + w * (values[left + 1] - values[left]) for w in GAUSS])

        both = 2, left.size
        return (between(self._time), between(self._session), np.broadcast_to(self._run[left], both),
                np.broadcast_to(self._exchanged[left], both))

    @cached_property
    def _measured(self) -> Record:
        def slow(column: str, cutoff_hz: float) -> FloatArray:
            return np.concatenate([s.low_passed(column, cutoff_hz) for s in self._signals])

        with_encoder = [int(j) for j in np.flatnonzero(self.has_encoder)]
        readings = {torque_of(j): self.torque[:, j] for j in range(self.n)}
        readings |= {encoder_of(j): self.angles[:, j] for j in with_encoder}
        torques = np.ascontiguousarray(slow("torque", SLOW_SHARE / self.dt).T)
        low_passed = {torque_of(j): torque for j, torque in enumerate(torques)}
        readings |= self.imu_readings()
        if self.has_imu:
            low_passed[GYRO] = slow(imu_columns(0)[0], SLOW_HZ)
        derivatives = {j: self._derivatives(self.angles[:, j]) for j in with_encoder}
        return Record(readings, low_passed, {j: rate for j, (rate, _) in derivatives.items()},
                      {j: acceleration for j, (_, acceleration) in derivatives.items()})

    def _derivatives(self, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        parts = np.split(angle, self.ends[:-1])
        second = [np.pad(np.diff(part, 2) / self.dt**2, 1, mode="edge") for part in parts]
        return np.concatenate([np.gradient(part, self.dt) for part in parts]), np.concatenate(second)

    def places(self) -> list[slice]:
        """Slices of the parameter vector with the sizes and shapes of each effect."""
        stops = self.mechanism.p + np.cumsum([e.count for e in self.effects], dtype=int)
        return [slice(int(b) - e.count, int(b)) for e, b in zip(self.effects, stops)]

    def split(self, parameters: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
        """beta (p,) and one size vector an effect, its shapes kept within range."""
        sizes = [e.clipped(parameters[place]) for e, place in zip(self.effects, self.places())]
        return parameters[: self.mechanism.p], sizes

    def relaxed(self, parameters: FloatArray, slack: float) -> FloatArray:
        """The parameter vector with a smaller slope of a gear's play; see `Backlash.relaxed`."""
        beta, sizes = self.split(parameters)
        return np.concatenate([beta, *(e.relaxed(size, slack) if isinstance(e, Backlash) else size
                                       for e, size in zip(self.effects, sizes))])

    def extra(self, x: Latents, parameters: FloatArray, columns: bool = True) -> Extra:
        """Torques and readings that the effects add at (x, parameters), and their derivatives by effects and
        candidates."""
        view, torque, at_samples, readings = self._acting(x, parameters)
        sizes = self.split(parameters)[1]
        n, count, total = self.n, self.left.size, self.total
        derivatives: list[Perturbation] = []
        if columns:
            for effect, size in zip(self.effects, sizes):
                derivatives += slopes(effect, view, size)
            for candidate in self.candidates:
                derivatives += slopes_at_zero(candidate, view)
        k = len(derivatives)
        gauss_columns, sample_columns = np.empty((k, n, 2, count)), np.empty((k, n, total))
        acts = np.zeros((k, n), dtype=bool)
        rows: dict[Channel, list[int]] = {}
        for i, d in enumerate(derivatives):
            if d.torque is not None and d.torque_at_samples is not None:
                gauss_columns[i], sample_columns[i] = d.torque, d.torque_at_samples
                acts[i] = d.torque.any(axis=(1, 2))
            else:
                gauss_columns[i], sample_columns[i] = 0.0, 0.0
            for channel in d.readings:
                rows.setdefault(channel, []).append(i)
        reading_columns = {channel: ReadingColumns(np.array(which), np.stack([derivatives[i].readings[channel]
                                                                              for i in which]))
                           for channel, which in rows.items()}
        gauss_slopes, sample_slopes = self._law_slopes(view, sizes)
        by_torque: dict[Channel, FloatArray] = {}
        for effect, size in zip(self.effects, sizes):
            for channel, slope in effect.by_torque(view, size).items():
                by_torque[channel] = by_torque.get(channel, 0.0) + slope
        return Extra(torque, at_samples, readings, gauss_columns, sample_columns, acts, reading_columns, gauss_slopes,
                     sample_slopes, by_torque)

    def _acting(self, x: Latents, parameters: FloatArray
                ) -> tuple[View, FloatArray, FloatArray, dict[Channel, FloatArray]]:
        """What effects see, the torque that they add at Gauss points and at samples, and what they add to readings."""
        beta, sizes = self.split(parameters)
        pairs = list(zip(self.effects, sizes))
        free, inverse = self._seen(x, beta)
        free = replace(free, measured=self._measured)
        torque, at_samples, readings = added(pairs, free)
        view = free
        if at_samples.any():
            for _ in range(PASSES - 1):  # what an effect takes changes the acceleration it feels
                view, before = braked(free, inverse, at_samples), at_samples
                torque, at_samples, readings = added(pairs, view)
                if np.array_equal(before, at_samples):
                    break
            else:
                view = braked(free, inverse, at_samples)
        return view, torque, at_samples, readings

    def candidate_gradient(self, x: Latents, parameters: FloatArray, residuals: WeightedResiduals) -> FloatArray:
        """(c,) derivative of half the objective by the candidates' sizes, at these `residuals`."""
        view = self._acting(x, parameters)[0]
        return np.array([residuals.along(d) for candidate in self.candidates for d in slopes_at_zero(candidate, view)])

    def without_candidates(self) -> ExtendedProblem:
        """The same with effects alone."""
        own = copy(self)
        own.candidates = ()
        return own

    def simulated(self, parameters: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
        """Parameters like `split`, for a simulation that has no record of the motor's motion."""
        beta, sizes = self.split(parameters)
        for effect, size in zip(self.effects, sizes):
            if isinstance(effect, GearEffect):
                beta = effect.simulated(beta, size, self.mechanism)
        return beta, sizes

    def motor_torque(self, x: Latents, parameters: FloatArray) -> FloatArray:
        """(N, n) torque of the motors along a fitted motion: the latent torque, and what gears lose before it."""
        if not self.effects:
            return x.u.copy()
        beta, sizes = self.split(parameters)
        view = replace(self.view(x, beta), measured=self._measured)
        out = x.u.copy()
        for effect, size in zip(self.effects, sizes):
            if isinstance(effect, GearEffect):
                for j, drive_loss in effect.drive_loss(view, size).items():
                    out[:, j] += drive_loss
        return out

    def torque_readings(self, x: Latents, parameters: FloatArray) -> FloatArray:
        """(N, n) what effects add to the torques' readings along a motion: measured less this is what acted."""
        if not self.effects:
            return np.zeros((self.total, self.n))
        beta, sizes = self.split(parameters)
        readings = added(list(zip(self.effects, sizes)), self.view(x, beta))[2]
        nothing = np.zeros(self.total)
        return np.stack([readings.get(torque_of(j), nothing) for j in range(self.n)], axis=-1)

    def _law_slopes(self, view: View, sizes: Sequence[FloatArray]) -> tuple[FloatArray | None, FloatArray | None]:
        """Derivatives of the torque laws by the features of the motion, at Gauss points and at samples."""
        laws = [(part, s) for e, s in zip(self.effects, sizes) if isinstance(e, TorqueEffect) for part in e.parts]
        if not laws:
            return None, None
        n, scale = self.n, self.mechanism.velocity_scales
        at_gauss, at_samples = np.zeros((n, 5, n, 2, self.left.size)), np.zeros((n, 5, n, self.total))
        for law, size in laws:
            j = law.joint or 0
            joints = law.felt(n) if isinstance(law, StateTorque) else (j,)  # generic terms take their own joint's only
            for k, (at, out) in product(joints, ((view.gauss, at_gauss), (view.samples, at_samples))):
                found = by_motion(law, at, size, view, k)
                for name, feature in (("q", ANGLE), ("v", RATE), ("a", ACCEL)):
                    out[j, feature, k] += found[name]
                out[j, RATE, k] += found["sign"] * np.maximum(1.0 - at.sign[k] ** 2, 0.0) ** 1.5 / scale[k]
        return at_gauss, at_samples

    def linearise(self, x: Latents, beta: FloatArray, noise: Noise, predicted_misfit: FloatArray | None = None
                  ) -> Linearised:
        """`beta` is the whole parameter vector here; what is believed of sizes beforehand is in."""
        extra = self.extra(x, beta) if self.effects or self.candidates else None
        point = self._assembled(x, beta[: self.mechanism.p], noise, extra, predicted_misfit)
        p, own = self.mechanism.p, self._precision.size
        sizes = beta[p : p + own]
        point.corner[range(p, p + own), range(p, p + own)] += self._precision
        point.gradient_beta[p : p + own] += self._precision * sizes
        return replace(point, objective=point.objective + self._disbelief(beta))

    def motion_equations(self, x: Latents, parameters: FloatArray, noise: Noise) -> Linearised:
        """`linearise` for a search of the motion alone: without border, corner and gradient."""
        extra = self.extra(x, parameters, columns=False) if self.effects else None
        point = self._assembled(x, parameters[: self.mechanism.p], noise, extra, motion_alone=True)
        return replace(point, objective=point.objective + self._disbelief(parameters))

    def _disbelief(self, parameters: FloatArray) -> float:
        """Share of the objective that what is believed of sizes beforehand has."""
        sizes = parameters[self.mechanism.p : self.mechanism.p + self._precision.size]
        return float(sizes @ (self._precision * sizes))

    @cached_property
    def _precision(self) -> FloatArray:
        """By each size and shape; priors are those of a rig with torques up to 1 N m rms, and grow with them."""
        large = max(1.0, float(np.sqrt(np.mean(self.torque**2))))
        return np.array([x for e in self.effects
                         for x in (*((large * s.prior) ** -2 for s in e.sizes), *(0.0 for _ in e.shapes))])


def braked(view: View, inverse: FloatArray, torque: FloatArray) -> View:
    """`view` of a motion that effects brake by `torque` (n, N) at the samples, where the inertia's `inverse` is (n, n,
    N)."""
    less = np.einsum("ijk,jk->ik", inverse, torque)
    return replace(view, samples=replace(view.samples, a=view.samples.a - less))


def added(pairs: Sequence[tuple[Effect, FloatArray]], view: View) -> tuple[FloatArray, FloatArray,
                                                                           dict[Channel, FloatArray]]:
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
    steps = [s.scale * 0.1 for s in effect.sizes] + [1e-3 * abs(v) + 1e-9 for v in size[len(effect.sizes):]]
    out = []
    for i, h in enumerate(steps):
        up, down = size.copy(), size.copy()
        up[i] += h
        down[i] -= h
        out.append(_difference(effect.perturb(view, up), effect.perturb(view, down), 2.0 * h))
    return out


def slopes_at_zero(candidate: Candidate, view: View) -> list[Perturbation]:
    """Derivative by each size at zero, at the candidate's shape."""
    effect = candidate.effect
    out = []
    for i, s in enumerate(effect.sizes):
        size = np.array([0.0] * len(effect.sizes) + list(candidate.shape))
        size[i] = s.scale
        out.append(_difference(effect.perturb(view, size), None, s.scale))
    return out


def _difference(a: Perturbation, b: Perturbation | None, by: float) -> Perturbation:
    def part(x: FloatArray | None, y: FloatArray | None) -> FloatArray | None:
        return None if x is None else (x - y if y is not None else x) / by

    readings = {k: (v - (b.readings[k] if b is not None else 0.0)) / by for k, v in a.readings.items()}
    return Perturbation(part(a.torque, b.torque if b else None),
                        part(a.torque_at_samples, b.torque_at_samples if b else None), readings)
