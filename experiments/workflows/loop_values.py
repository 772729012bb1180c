"""`find_loop_values`: what a rig file does not state of its position loops, by its runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from daq import Dataset, Rig, Servo
from estimator import TWO_SIDED, Finding, FitError, FitResult, LoopTerm
from estimator.fitting import UNLIMITED, find_loop, limit_met
from estimator.model import Mechanism
from experiments.session import Choice, Setup, prepare, with_choices

ROUNDS, SMALL_S, SMALL = 8, 2e-4, 2e-3
"""Most times that the values are sought; steps of the delay [s], and shares of others, that need no further round."""
AT_LIMIT = 0.999
"""Share of the largest torque from which on a loop is at its limit."""
WHY = {"delay_s": "commands that act late", "limit": "a loop that gives no more",
       "integral": "a loop that integrates its error", "damping": "a loop that damps"}
"""Key of `[servo]` -> why the runs ask for it."""
ABSENT: dict[str, float] = {"limit": UNLIMITED, "integral": 0.0, "damping": 0.0}


@dataclass(frozen=True)
class LoopValues:
    """Values that were found, and those that the runs do not show."""

    choices: tuple[Choice, ...] = ()
    hidden: tuple[LoopTerm, ...] = ()
    """Sought, and as likely absent"""


def find_loop_values(datasets: Sequence[Dataset], rig: Rig, sensors: str | None = None) -> LoopValues:
    """Delay, limit, integral and damping by the motion of joints whose loop makes the torque; what `rig` states, and
    what the runs do not show, is not among the choices.

    Each round makes the torque anew by the loop as it acts, so that no other term takes the place of its values.
    """
    unknown = [] if rig.servo is None else _unstated(rig.servo, rig.mechanism.input == "voltage")
    if not unknown:
        return LoopValues()
    values = dict[str, Any]()
    if "limit" in unknown:
        values = _limits(prepare(datasets, rig, sensors=sensors).setup, rig, unknown)
    search = _Search(datasets, rig, sensors)
    found = search.rounds(unknown, values)
    if found is None:  # no fit with that limit converges near it
        found = search.rounds([key for key in unknown if key != "limit"], {})
    return found or LoopValues()


@dataclass(frozen=True)
class _Search:
    datasets: Sequence[Dataset]
    rig: Rig
    sensors: str | None

    def rounds(self, unknown: Sequence[str], values: dict[str, Any]) -> LoopValues | None:
        """The values `unknown`, from those that are given; None where they have a limit that no fit confirms."""
        sure, hidden = [key for key in unknown if key == "delay_s" or key in values], tuple[LoopTerm, ...]()
        for number in range(ROUNDS):
            setup = prepare(self.datasets, with_choices(self.rig, _choices(values)), sensors=self.sensors).setup
            options = replace(setup.options, unknown_loop=tuple(unknown if number == 0 else sure))
            try:
                terms = find_loop(setup.datasets, setup.mechanism, options, sure) if setup.mechanism.followers else ()
            except FitError:
                terms = ()
            shown = [one for one in terms if one.found]
            if "limit" in values and not any(one.key == "limit" for one in shown):
                return None
            if number == 0:
                hidden = tuple(one for one in terms if not one.found)
                sure = [key for key in unknown if any(one.key == key for one in shown)]
            if not shown:
                break
            before, values = values, {key: _value(key, shown, self.rig) for key in sure}
            if all(_near(key, value, before.get(key, 0.0)) for key, value in values.items()):
                break
        if abs(values.get("delay_s", 0.0)) < SMALL_S:
            values.pop("delay_s", None)
        return LoopValues(_choices(values), hidden)


def _limits(setup: Setup, rig: Rig, unknown: Sequence[str]) -> dict[str, Any]:
    """The limit of loops that meet one, and what else is `unknown` of them where that is not zero."""
    m, met = setup.mechanism, dict[int, dict[str, float]]()
    for j in m.followers:
        found = limit_met(setup.datasets, m, setup.options, j, unknown)
        met |= {} if found is None else {j: found}
    return {key: _entry(key, own, rig) for key in unknown
            if any((own := {j: one[key] for j, one in met.items()}).values())}


def _near(key: str, value: Any, before: Any) -> bool:
    return bool(np.all(np.abs(np.subtract(value, before)) < (SMALL_S if key == "delay_s" else SMALL * np.abs(value))))


def _unstated(servo: Servo, voltage: bool) -> list[str]:
    """Keys of `[servo]` that a fit may find. A motor on voltage has the limit of its duty."""
    found = [key for key in WHY if getattr(servo, key) is None]
    if servo.limit == UNLIMITED:
        found.insert(1, "limit")
    motor = voltage or servo.resistance_ohm is not None
    return [key for key in found if not (motor and key == "limit")]


def _value(key: str, terms: Sequence[LoopTerm], rig: Rig) -> Any:
    """As rig.toml has it: one number, or one for each driven joint."""
    return _entry(key, {one.joint: one.value for one in terms if one.key == key}, rig)


def _entry(key: str, values: Mapping[int, float], rig: Rig) -> Any:
    """`values` by joint (0-based) as rig.toml has them."""
    if key == "delay_s":
        return round(float(np.mean(list(values.values()))), 5)
    found = tuple(float(f"{values.get(j - 1, ABSENT[key]):.4g}") for j in sorted(rig.mechanism.actuated))
    return found[0] if len(found) == 1 else found


def _choices(values: dict[str, Any]) -> tuple[Choice, ...]:
    return tuple(Choice("servo", key, value, WHY[key], "the likeliest value, uncertain in the fit")
                 for key, value in values.items())


def in_units(choices: Sequence[Choice], gain: float) -> tuple[Choice, ...]:
    """Choices of a fit in units of the servo's gain, with that gain."""
    def scaled(value: Any) -> Any:
        return tuple(map(scaled, value)) if isinstance(value, tuple) else float(f"{gain * value:.4g}")

    return tuple(replace(one, value=scaled(one.value)) if one.table == "servo" and one.key in ABSENT else one
                 for one in choices)


def with_open_damping(result: FitResult, stated: Servo) -> FitResult:
    """`result` with limits of loops that are as uncertain as a damping that nobody states makes them.

    A loop that damps within its limit l asks for gain e - d q'. With d = 0 the fit has d as viscous friction, which
    acts beyond the limit, too, and its limit is l + d q' there. At most, d is all of the viscous friction b: b times
    the largest rate at the limit, in quadrature with what noise leaves open, is half of the interval.
    """
    if stated.damping is not None or any(one.key == "damping" and one.found for one in result.loop):
        return result
    viscous = {p.at[0]: float(b) for p, b in zip(result.mechanism.parameters, result.beta) if p.term == "viscous"}

    def widened(one: LoopTerm) -> LoopTerm:
        if one.key != "limit":
            return one
        torque, rate = (np.concatenate([x[:, one.joint] for x in columns]) for columns in (
            [t.tau_measured for t in result.trajectories], [t.qd for t in result.trajectories]))
        there = np.abs(torque) >= AT_LIMIT * np.nanmax(np.abs(torque))
        open_by = viscous.get(one.joint, 0.0) * float(np.max(np.abs(rate[there])))
        return replace(one, std=float(np.hypot(one.std, open_by / TWO_SIDED)))

    return replace(result, loop=tuple(map(widened, result.loop)))


def loop_findings(result: FitResult, stated: Servo) -> list[Finding]:
    """Sentences on the values of loops that were found or that the runs cannot tell, with the key that states them."""
    mechanism: Mechanism = result.mechanism
    texts = [_told(one, mechanism) for one in result.loop]
    sought = {one.key for one in result.loop}
    viscous = {p.at[0]: p.name for p in mechanism.parameters if p.term == "viscous"}
    for j in mechanism.followers:
        if stated.damping is None and "damping" not in sought and j in viscous:
            texts.append(f"{viscous[j]} has the damping of joint {j + 1}'s loop in it: these runs do not tell both "
                         "apart; servo.damping states it")
        if stated.limit is None and "limit" not in sought and mechanism.force_unit != "V":
            most = max(float(np.nanmax(np.abs(t.tau_measured[:, j]))) for t in result.trajectories)
            texts.append(f"these runs ask joint {j + 1}'s loop for {most:.3g} {mechanism.force_unit} and meet no "
                         "limit; servo.limit states it")
    return [Finding("assumption", "run_note", text) for text in texts]


def _told(term: LoopTerm, mechanism: Mechanism) -> str:
    unit = mechanism.force_unit
    name = f"joint {term.joint + 1}"
    size, low, high = term.value, term.value - term.half, term.value + term.half
    if term.key == "delay_s" and term.half > 1.0:  # the rig file takes no delay of more than a second
        return f"these runs do not show how late commands of {name} act; servo.delay_s states it"
    if term.key == "delay_s":
        return f"commands of {name} act {1e3 * size:.3g} ms late, +-{1e3 * term.half:.2g} ms, by this motion; corrected"
    units = {"limit": unit, "integral": f"{unit}/(rad s)", "damping": f"{unit} s/rad"}[term.key]
    told = f"{size:.4g} [{low:.4g}, {high:.4g}] {units}"
    if term.found:
        return {"limit": f"the loop of {name} gives at most {told}", "damping": f"the loop of {name} damps by {told}",
                "integral": f"the loop of {name} has an integral of {told}"}[term.key]
    return (f"these runs do not show {'an' if term.key == 'integral' else 'a'} {term.key} of {name}'s loop: {told}; "
            f"servo.{term.key} states it")
