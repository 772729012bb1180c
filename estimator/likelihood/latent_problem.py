"""`LatentProblem`: the joint likelihood of one latent motion and the parameters, linearised.

Unknown at each sample: angle q, rate v and acting torque u of every joint (block size b = 3 joints); common:
beta, then the sizes and shapes of each effect. Where joints are `disturbed` there is also the coloured error e of each
torque reading (b = 4 joints). Residuals, each over its standard deviation:

    equation of motion at two Gauss points an interval   Z(q, v) beta - hold(u)        sigma_u * slack_of, and unseen
    torque sample (zero on a passive joint)              u + e - y_u                   sigma_u
    disturbance, of time constant T                      e' - exp(-dt / T) e           s (1 - exp(-2 dt / T))^1/2
    encoder                                              q - y_q                       sigma_q
    gyro of an IMU on a link at angle t q                t v - y_g                     sigma_g
    its accelerometer                                    a(q, v, qdd) - y_a            sigma_a by axis

The passive joint's torque is exactly zero, so B Sigma_u B^T of (17) is singular; its sigma_u stands for what
the model gets wrong there. Where a rig declares correlations, of both axes or of the torques at one time, these
rows have their whole inverse covariance. Effects add torques to the equation of motion and values to the readings
(`effect_columns`). Normal equations are block tridiagonal in the latents with a dense border for
the parameters; cost grows linearly with samples.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Self

import numpy as np

from daq import FloatArray, IndexArray
from estimator.effects import Backlash, Effect, GearEffect, Points, StribeckFriction, View
from estimator.likelihood import assembly_numba, correlated_torque
from estimator.likelihood.closed_loops import closed_loops, driven
from estimator.likelihood.disturbance import Process, expected_score
from estimator.likelihood.effect_columns import added, extra_of
from estimator.likelihood.measured_runs import MeasuredRuns
from estimator.likelihood.memory import keep_pages, pieces, refuse_too_long
from estimator.likelihood.noise import Noise
from estimator.likelihood.normal_equations import (
    Accumulators,
    Extra,
    Latents,
    Linearised,
    add_reading,
    of_channel,
)
from estimator.likelihood.stage import Candidate, Stage, Timeline
from estimator.model import GAUSS, Mechanism, mean_sign, smooth_sign
from estimator.numerics import BlockTridiagonal
from estimator.signals import Channel, SignalSet, encoder_of, imu_channels, torque_of, total

PIECE = 1024
"""Intervals, or samples, that are worked on at a time: what they need stays in the processor's cache."""


class LatentProblem(MeasuredRuns):
    """All segments of all runs on one stack of samples; see the module's text.

    Without effects and candidates, the plain case, no step pays for any. A search changes nothing of it: what a step
    finds is in the `State`, with the noise of each sample.
    """

    def __init__(self, signals: Sequence[SignalSet], mechanism: Mechanism, hold: str, stage: Stage | None = None,
                 effects: Sequence[Effect] = (), candidates: Sequence[Candidate] = ()) -> None:
        keep_pages()
        super().__init__(signals, mechanism, hold)
        self.stage = stage or Stage.blank(len(signals), self.n)
        self.effects, self.candidates = tuple(effects), tuple(candidates)
        self.disturbed, self.block = False, 3 * self.n
        refuse_too_long(self.total, self.block, 1 + mechanism.p)

    def with_disturbance(self) -> Self:
        """The same with a coloured disturbance at every joint."""
        own = copy(self)
        own.disturbed, own.block = True, 4 * self.n
        refuse_too_long(own.total, own.block, 1 + own.mechanism.p)
        return own

    @property
    def parameter_count(self) -> int:
        """Length of the parameter vector: beta, then the effects."""
        return self.mechanism.p + sum(e.count for e in self.effects)

    def dry_levels(self, beta: FloatArray) -> dict[int, float]:
        """Joint to its level of dry friction near rest [N m] at parameters `beta`, what effects there add included."""
        found = {p.at[0]: float(b) for b, p in zip(beta, self.mechanism.parameters) if p.term == "coulomb"}
        for effect, place in zip(self.effects, self.places()):
            if isinstance(effect, StribeckFriction) and effect.joint in found:
                found[effect.joint] += effect.level_at_rest(beta[place])
        return found

    def view(self, x: Latents, beta: FloatArray, torque: FloatArray | None = None) -> View:
        """View of the effects at (x, beta); `torque` (n, N) is the torque of effects at the samples."""
        return self._seen(x, beta, torque)[0]

    def _seen(self, x: Latents, beta: FloatArray, torque: FloatArray | None = None) -> tuple[View, FloatArray]:
        """As `view`, and the inverse of the inertia matrix at the samples (n, n, N)."""
        m, c, left = self.mechanism, self.collocation, self.left
        motion, (samples_times, gauss_times) = c.motion(x.q, x.v, left), self._times
        taken = x.u if torque is None else x.u - torque.T
        qdd, inverse = c.fast.forward_dynamics(x.q, x.v, taken, beta)
        sign = mean_sign(motion.rate_from, motion.rate_to, m.velocity_scales[:, None, None])[0]
        told = self.commands or (None, None)
        gauss = Points(motion.angle, motion.rate, motion.accel, c.torque(x.u, left), sign, *gauss_times,
                       commanded=told[1])
        samples = Points(x.q.T, x.v.T, qdd, x.u.T, smooth_sign(x.v.T, m.velocity_scales[:, None]), *samples_times,
                         commanded=told[0])
        starts = np.concatenate([[0], self.ends[:-1]])
        view = View(m, beta, gauss, samples, left, (GAUSS[0], GAUSS[1]), starts, self.dt, self.stage.angle_range,
                    self.stage.gear_ratio)
        return view, inverse

    @cached_property
    def _times(self) -> tuple[Timeline, Timeline]:
        """At the samples and at the Gauss points."""
        at_samples = Timeline.of(self.stage, self.signals, self.dt)
        return at_samples, at_samples.at_gauss(self.left)

    def _free(self, x: Latents, beta: FloatArray) -> tuple[View, FloatArray]:
        """View of a measured motion without the torques of effects, and the inverse of the inertia matrix (n, n, N)."""
        view, inverse = self._seen(x, beta)
        return replace(driven(view, closed_loops(self)), measured=self.record), inverse

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

    def _pairs(self, parameters: FloatArray) -> tuple[FloatArray, list[tuple[Effect, FloatArray]]]:
        """beta (p,), and the effects with their sizes, those of closed loops included."""
        beta, sizes = self.split(parameters)
        return beta, [*zip(self.effects, sizes), *((loop, np.zeros(0)) for loop in closed_loops(self))]

    @property
    def acts(self) -> bool:
        """Whether effects or closed loops act."""
        return bool(self.effects) or self.by_law

    def extra(self, x: Latents, parameters: FloatArray, columns: bool = True) -> Extra:
        """Torques and readings that the effects add at (x, parameters), and their derivatives; with `columns` also
        those by sizes and candidates."""
        beta, pairs = self._pairs(parameters)
        return extra_of(pairs, self.candidates, *self._free(x, beta), columns)

    def simulated(self, parameters: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
        """Parameters like `split`, for a simulation that has no record of the motor's motion."""
        beta, sizes = self.split(parameters)
        for effect, size in zip(self.effects, sizes):
            if isinstance(effect, GearEffect):
                beta = effect.simulated(beta, size, self.mechanism)
        return beta, sizes

    def motor_torque(self, x: Latents, parameters: FloatArray) -> FloatArray:
        """(N, n) torque of the motors along a fitted motion: the latent torque, and what gears lose before it."""
        opened = self.by_law and not self.closed  # of joints with and without loops, a free run has all of them open
        if not (self.effects or opened):
            return x.u.copy()
        beta, pairs = self._pairs(parameters)
        view = self._free(x, beta)[0]
        out = view.samples.u.T.copy() if opened else x.u.copy()
        for effect, size in pairs:
            if isinstance(effect, GearEffect):
                for j, drive_loss in effect.drive_loss(view, size).items():
                    out[:, j] += drive_loss
        return out

    def torque_readings(self, x: Latents, parameters: FloatArray) -> FloatArray:
        """(N, n) what effects add to the torques' readings along a motion: measured less this is what acted."""
        if not self.effects:
            return np.zeros((self.total, self.n))
        beta, pairs = self._pairs(parameters)
        readings = added(pairs, self.view(x, beta))[2]
        nothing = np.zeros(self.total)
        return np.stack([readings.get(torque_of(j), nothing) for j in range(self.n)], axis=-1)

    def linearise(self, x: Latents, beta: FloatArray, noise: Noise, predicted_misfit: FloatArray | None = None
                  ) -> Linearised:
        """Residuals, Gauss-Newton blocks and border at (x, beta), what is believed of sizes beforehand included.

        `beta` is the whole parameter vector; columns of candidates follow it. `predicted_misfit` (n,) is for
        `_inertia_gradient`: of each joint's torque after the last step of a search.
        """
        extra = self.extra(x, beta) if self.acts or self.candidates else None
        point = self._assembled(x, beta[: self.mechanism.p], noise, extra, predicted_misfit)
        if not self.effects:
            return point
        own = np.arange(self.mechanism.p, self.parameter_count)
        point.corner[own, own] += self._precision
        point.gradient_beta[own] += self._precision * beta[own]
        return replace(point, objective=point.objective + self._disbelief(beta))

    def motion_equations(self, x: Latents, parameters: FloatArray, noise: Noise) -> Linearised:
        """`linearise` for a search of the motion alone: without border, corner and gradient."""
        if not self.acts:
            return self._assembled(x, parameters[: self.mechanism.p], noise, None, motion_alone=True)
        extra = self.extra(x, parameters, columns=False)
        point = self._assembled(x, parameters[: self.mechanism.p], noise, extra, motion_alone=True)
        return replace(point, objective=point.objective + self._disbelief(parameters))

    def _disbelief(self, parameters: FloatArray) -> float:
        """Share of the objective that what is believed of sizes beforehand has."""
        sizes = parameters[self.mechanism.p : self.parameter_count]
        return float(sizes @ (self._precision * sizes))

    @cached_property
    def _precision(self) -> FloatArray:
        """By each size and shape; priors are those of a rig with torques up to 1 N m rms, and grow with them."""
        large = max(1.0, float(np.sqrt(np.mean(self.torque**2))))
        return np.array([x for e in self.effects
                         for x in (*((large * s.prior) ** -2 for s in e.sizes), *(0.0 for _ in e.shapes))])

    def _assembled(self, x: Latents, beta: FloatArray, noise: Noise, extra: Extra | None,
                   predicted_misfit: FloatArray | None = None, motion_alone: bool = False) -> Linearised:
        """`linearise` with columns of `extra` after those of beta, or `motion_equations`."""
        b, n, columns = self.block, self.n, 0 if extra is None else len(extra.sample_columns)
        width = 1 if motion_alone else 1 + self.mechanism.p + columns
        chain = BlockTridiagonal.zeros(self.total, b, width)  # right sides: residual, then parameters
        accumulators = Accumulators(chain, np.zeros((width, width)), np.zeros(n))
        weight = self.motion_weight(noise)
        for intervals, left in pieces(self.left, PIECE):
            assembly_numba.add_motion(self.collocation, x, beta, weight[:, intervals], intervals, left, extra,
                                      accumulators, self.between)
        residuals: dict[str, FloatArray] = {}
        accel = np.empty((self.imu_count, self.total, 2, b + width))
        if self.has_imu:
            for here, own in self._alike(noise):
                assembly_numba.add_accelerometer(self.collocation, x, beta, self.accel, own, here, extra,
                                                 accumulators, accel)
            residuals["accel"] = accel[..., b]
        upper = np.triu(accumulators.square)
        square, misfit = upper + np.triu(upper, 1).T, accumulators.misfit
        border = chain.right[:, :, 1:]
        objective, gradient_beta, corner = float(square[0, 0]), square[1:, 0], square[1:, 1:]
        variances = self.torque_variance(noise)
        objective += self._node_rows(x, variances, noise, chain, residuals, extra)
        if extra is not None and not motion_alone:
            self._node_columns(extra, variances, noise, residuals, border, corner, gradient_beta)
        if self.disturbed:
            assert x.e is not None
            process = Process.of(noise, self.dt)
            process.add(chain, x.e, self.ends)
            squares = process.squares(x.e, self.ends)
            misfit += squares
            objective += float(squares.sum())
            residuals["e"] = x.e
        if motion_alone:
            return Linearised(objective, chain, corner, gradient_beta, accel, residuals, extra)
        misfit += np.einsum("kj,kj->j", residuals["torque"] ** 2, 1.0 / variances)
        gradient_beta[: self.mechanism.p] -= self._inertia_gradient(beta, misfit, predicted_misfit)
        if self.disturbed:
            freedom = np.minimum(squares, self.total * process.share(noise.torque**2))
            freedom[list(self.mechanism.passive)] = 0.0  # see _inertia_gradient
            gradient_beta[: self.mechanism.p] -= expected_score(self.mechanism, x.q, beta, freedom)
        return Linearised(objective, chain, corner, gradient_beta, accel, residuals, extra)

    def _inertia_gradient(self, beta: FloatArray, misfit: FloatArray, predicted: FloatArray | None) -> FloatArray:
        """(p,) gradient by which a passive joint's misfit counts as acceleration, not as torque: -r^2 a / m^3.

        A passive joint's equation is homogeneous in beta, so shrinking beta shrinks its misfit r. Therefore r / m
        counts, m = a . beta the joint's inertia. Without this a weakly excited leg diverges to beta = 0. r^2 is bounded
        by the `predicted` misfit, at first by the number of samples: the latents' step reduces the rest.
        """
        out = np.zeros(self.mechanism.p)
        most = np.full(self.n, self.total) if predicted is None else predicted
        for j in self.mechanism.passive:
            a = self.mechanism.inertia_rows[:, j]
            m = float(a @ beta)
            if m > 0.0:
                out += min(misfit[j], most[j]) / m * a
        return out

    def _alike(self, noise: Noise) -> Iterator[tuple[slice, Noise]]:
        """Samples piece by piece, and the accelerometer's noise there."""
        scale = noise.scale
        ends = [self.total] if scale is None else [*self.run_starts[1:], self.total]
        start = 0
        for end in ends:
            own = noise if scale is None else replace(noise, accel=noise.accel * scale.accel[:, start])
            for first in range(start, end, PIECE):
                yield slice(first, min(first + PIECE, end)), own
            start = end

    def channels(self, variances: FloatArray, noise: Noise
                 ) -> list[tuple[Channel, tuple[int, ...], float | FloatArray]]:
        """(channel, columns of the latents, variance) of every sensor that reads one latent, or a sum of them."""
        n = self.n
        found: list[tuple[Channel, tuple[int, ...], float | FloatArray]] = []
        if noise.torque_correlation is None:
            found += [(torque_of(i), tuple(range(2 * n + i, self.block, n)), variances[:, i]) for i in range(n)]
        found += [(encoder_of(i), (i,), self.angle_variance(i, noise)) for i in range(n) if self.has_encoder[i]]
        return found + [(imu_channels(k)[0], tuple(n + j for j in joints), self.gyro_variance(k, noise))
                        for k, joints in enumerate(self.turned_by)]

    def _node_rows(self, x: Latents, variances: FloatArray, noise: Noise, chain: BlockTridiagonal,
                   residuals: dict[str, FloatArray], extra: Extra | None) -> float:
        """Add torque (of `variances`), encoder and gyro samples; returns their part of the objective."""
        n = self.n
        residuals["torque"] = x.u - self.torque if x.e is None else x.u + x.e - self.torque
        residuals["encoder"] = x.q - self.angles
        if self.has_imu:
            residuals["gyro"] = np.array([total(x.v.T, joints) for joints in self.turned_by]) - self.gyro
        objective = 0.0
        for channel, columns, variance in self.channels(variances, noise):
            r, weight = of_channel(residuals, channel), 1.0 / variance
            if extra is not None and channel in extra.readings:
                r += extra.readings[channel]  # a view: the residual of record moves with it
            objective += add_reading(chain, columns, weight, r)
            if extra is not None and channel in extra.by_torque:
                slope, other = extra.by_torque[channel], 2 * n + columns[0] % n
                chain.diagonal[:, other, other] += slope**2 * weight
                for column in columns:
                    chain.diagonal[:, other, column] += slope * weight
                    chain.diagonal[:, column, other] += slope * weight
                chain.right[:, other, 0] += slope * (weight * r)
        if noise.torque_correlation is not None:
            precision = noise.torque_precision(variances)
            objective += correlated_torque.add_samples(residuals["torque"], precision, extra,
                                                       chain.diagonal[:, 2 * n : 3 * n, 2 * n : 3 * n],
                                                       chain.right[:, 2 * n : 3 * n, 0])
        return objective

    def _node_columns(self, extra: Extra, variances: FloatArray, noise: Noise, residuals: dict[str, FloatArray],
                      border: FloatArray, corner: FloatArray, gradient_beta: FloatArray) -> None:
        """Border and corner of the sizes through the sensors that read one latent directly."""
        p = self.mechanism.p
        for channel, columns, variance in self.channels(variances, noise):
            if channel not in extra.reading_columns:
                continue
            which, values = extra.reading_columns[channel]
            c, place = values / variance, p + which
            for column in columns:
                border[:, column, place] += c.T
            if channel in extra.by_torque:
                border[:, 2 * self.n + columns[0] % self.n, place] += (extra.by_torque[channel] * c).T
            corner[np.ix_(place, place)] += c @ values.T
            gradient_beta[place] += c @ of_channel(residuals, channel)
        if noise.torque_correlation is not None:
            correlated_torque.add_columns(residuals["torque"], noise.torque_precision(variances), extra,
                                          border[:, 2 * self.n : 3 * self.n, p:], corner[p:, p:], gradient_beta[p:])

    def residuals_after(self, point: Linearised, step: FloatArray, step_beta: FloatArray,
                        index: IndexArray) -> dict[str, FloatArray]:
        """Sensor residuals `step` (N, b) and `step_beta` (on columns `index`) away from `point`, to first order."""
        n, p = self.n, self.mechanism.p
        out = {"torque": point.residuals["torque"] + step[:, 2 * n : 3 * n],
               "encoder": point.residuals["encoder"] + step[:, :n]}
        if self.disturbed:
            out["torque"] += step[:, 3 * n :]
            out["e"] = point.residuals["e"] + step[:, 3 * n :]
        if self.has_imu:
            turned = step[:, n : 2 * n].T
            out["gyro"] = point.residuals["gyro"] + np.array([total(turned, joints) for joints in self.turned_by])
            by_beta = np.zeros(point.accel.shape[3] - self.block)
            by_beta[0], by_beta[1 + index] = 1.0, step_beta
            out["accel"] = np.einsum("snab,nb->sna", point.accel_rows, step) + point.accel[..., self.block :] @ by_beta
        if point.extra is not None:
            size = np.zeros(len(point.gradient_beta))
            size[index] = step_beta
            for channel, slope in point.extra.by_torque.items():
                of_channel(out, channel)[:] += slope * step[:, 2 * n + (channel.joint or 0)]
            for channel, (which, values) in point.extra.reading_columns.items():
                if channel.kind in out:  # an accelerometer's are in its rows
                    of_channel(out, channel)[:] += size[p + which] @ values
        return out
