"""`hip_effect`: an effect of one hip of a walker, whose place in the mechanism changes with the leg that stands.

A mechanism whose joints are by role (`Mechanism.exchanged`) has the hip of leg 1 at one joint as leg 1 stands and at
the other as leg 2 does. An effect of that hip is the effect at one joint over some steps, and at the other over the
rest, with one size.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import TypeVar

import numpy as np

from daq import FloatArray
from estimator.effects.base import Effect, Joined, LawEffect, Perturbation, Points, View
from estimator.effects.gear_effect import GearEffect
from estimator.signals import Channel

K = TypeVar("K")


class Half:
    """A law at one joint that acts while one leg stands."""

    def __init__(self, effect: Effect, exchanged: bool, pair: tuple[int, ...]) -> None:
        self.effect, self.exchanged, self.pair, self.joint = effect, exchanged, pair, effect.joint

    def acts(self, at: Points) -> FloatArray:
        """1 where it acts, 0 elsewhere; as broad as the instants of `at`."""
        return np.asarray(np.equal(at.exchanged, self.exchanged), dtype=np.float64)

    def felt(self, count: int) -> Iterable[int]:
        """See `LawEffect.felt`."""
        return self.effect.felt(count) if isinstance(self.effect, LawEffect) else ()

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        """The effect's law where it acts; see `LawEffect.law`."""
        assert isinstance(self.effect, LawEffect)
        return np.asarray(self.acts(at) * self.effect.law(at, size, self.seen(view)))

    def seen(self, view: View) -> View:
        """`view` in which both joints have the range that a hip of theirs goes through by turns."""
        reach, pair = view.angle_range.copy(), list(self.pair)
        reach[pair] = reach[pair, 0].min(), reach[pair, 1].max()
        return replace(view, angle_range=reach)


class _HipEffect(Effect):
    """Mixed with an effect's class: it adds what two effects of that class add alternately."""

    halves: tuple[Half, Half]

    def __reduce__(self) -> tuple[object, ...]:  # its class is made on the spot: another process makes its own
        return hip_effect, (type(self.halves[0].effect), self.joint, self.halves[0].pair)

    @property
    def parts(self) -> tuple[Joined, ...]:
        effect = self.halves[0].effect
        return self.halves if isinstance(effect, LawEffect) and effect.parts else ()

    def perturb(self, view: View, size: FloatArray) -> Perturbation:
        torque, at_samples = np.zeros_like(view.gauss.q), np.zeros_like(view.samples.q)
        readings: dict[Channel, FloatArray] = {}
        for half in self.halves:
            found = half.effect.perturb(half.seen(view), size)
            if found.torque is not None and found.torque_at_samples is not None:
                torque += half.acts(view.gauss) * found.torque
                at_samples += half.acts(view.samples) * found.torque_at_samples
            for channel, values in found.readings.items():
                readings[channel] = readings.get(channel, 0.0) + half.acts(view.samples) * values
        return Perturbation(torque, at_samples, readings)

    def by_torque(self, view: View, size: FloatArray) -> Mapping[Channel, FloatArray]:
        return self._by_turns(view, lambda effect: effect.by_torque(view, size))

    def drive_loss(self, view: View, size: FloatArray) -> Mapping[int, FloatArray]:
        """See `GearEffect.drive_loss`."""
        return self._by_turns(view, lambda gear: gear.drive_loss(view, size) if isinstance(gear, GearEffect) else {})

    def _by_turns(self, view: View, of: Callable[[Effect], Mapping[K, FloatArray]]) -> dict[K, FloatArray]:
        out: dict[K, FloatArray] = {}
        for half in self.halves:
            for key, values in of(half.effect).items():
                out[key] = out.get(key, 0.0) + half.acts(view.samples) * values
        return out


def hip_effect(kind: type[Effect], joint: int, pair: tuple[int, ...]) -> Effect:
    """An effect of this kind at the hip that is `joint` (of `pair`) as leg 1 stands and the other of the pair as leg 2
    does."""
    other = pair[1] if joint == pair[0] else pair[0]
    effect: _HipEffect = type(kind.__name__, (_HipEffect, kind), {"__module__": kind.__module__})(joint)
    effect.halves = Half(kind(joint), False, pair), Half(kind(other), True, pair)
    return effect
