"""The account of a diagnosis: verdict in words, sizes with intervals, gain, budget, warnings, and what to draw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import fdtrc

from estimator.diagnosis.calibration import calibrated
from estimator.diagnosis.context import DiagnosisContext
from estimator.diagnosis.decision_rule import EDGE, SUFFICES
from estimator.diagnosis.error_budget import budget
from estimator.diagnosis.error_table import NOMINAL, ErrorTable
from estimator.diagnosis.explanation import Explanation
from estimator.diagnosis.family import FittedFamily, with_terms
from estimator.diagnosis.gain import gains_by_horizon, measure_gain, smoothed_tests
from estimator.diagnosis.model import Model
from estimator.diagnosis.noise_check import in_words, noisy_sensors
from estimator.diagnosis.residual_signature import signature
from estimator.diagnosis.result import Cause, Diagnosis, Remainder, Rotation
from estimator.diagnosis.small_faults import taken_in_words
from estimator.diagnosis.tolerances import with_tolerances
from estimator.diagnosis.verdict import Decision, excused
from estimator.effects import Effect, GenericReading, GenericTorque, Shape, Size, TorqueDelay
from estimator.errors import FitError
from estimator.fitting import disturbance_levels, imu_levels, torque_levels
from estimator.prediction import FloorNoise
from estimator.score import ALPHA, RUNS, least_sigmas
from estimator.verdicts import SizeEstimate

NO_GAP = ("free runs over whole runs do not show the gain: noise alone gives about the error of the nominal model. "
          "The evidence for the extension is the likelihood of the held-out runs")
NEXT_UNEXPLAINED = ("Record slow motion, fast motion, holds and a free swing as separate runs: the missing effect is "
                    "larger in one of them. You can add an effect as a file.")
UNSURE_GAP = "free runs over whole runs do not show whether the extension helps: the interval of its gain includes zero"


def describe(context: DiagnosisContext, base: Diagnosis, family: FittedFamily, decision: Decision, table: ErrorTable,
             first: ErrorTable, rotations: tuple[Rotation, ...], probability: float | None, rng: np.random.Generator
             ) -> Diagnosis:
    """The diagnosis of a decision by its `table`; the `first` one has the test runs alone."""
    best, nominal = decision.best, context.nominal
    row = NOMINAL if decision.answer is None else decision.answer.row
    found = replace(base, material=context.share, budget=budget(table, decision.answer), rotations=rotations,
                    error=(table.error(NOMINAL), table.error(row)),
                    by_horizon=gains_by_horizon(table, row) if row and decision.verdict != "none" else (),
                    compared=compared(family, first), in_library=probability,
                    probability=probability and min(probability, calibrated(probability)),
                    remainder=remainder(family, decision))
    found = with_noise(found, nominal if best is None else best.model, family.noise)
    p = 1.0 if best is None else chance_of(context, best, best.gain, best.model.effects)
    if decision.verdict == "none":
        start = Explanation(nominal, 0.0) if best is None or not decision.within else best
        own = with_terms(context, start, context.terms)
        if own.keys:
            found = with_model(found, own)
        small = [c for e in (best, own) if e is not None and e.keys for c in causes_of(
            e, chance_of(context, e, e.gain, e.model.effects), found)]
        immaterial = tuple({(c.effect, c.joint): c for c in small}.values())
        return (tolerated if decision.within else nothing)(with_blind_sensors(found, first), immaterial)
    if decision.verdict == "unexplained" or decision.answer is None:
        return unexplained(found, nominal, best, decision.why, rng, family.noise, p)
    answer, *others = decision.answer.best
    if decision.minor is not None:
        answer = with_minor(answer, decision.minor)
    told = [with_terms(context, answer, context.terms), *others]
    final = excused(table, replace(decision, answer=replace(decision.answer, best=tuple(told))))
    if final.verdict != decision.verdict:  # with the terms, the tolerances hold what was named
        return describe(context, base, family, final, table, first, rotations, None, rng)
    return finding(found, nominal, told, p, rng, decision.verdict == "partial", family.noise)


def undecided(diagnosis: Diagnosis, why: str) -> Diagnosis:
    """Verdict `unexplained` where no error could be measured."""
    return replace(diagnosis, verdict="unexplained", sentence=f"The model is wrong, and no listed effect explains the "
                   f"error: {why}.", next_experiment=NEXT_UNEXPLAINED)


def chance_of(context: DiagnosisContext, explanation: Explanation, gain: float, effects: Sequence[Effect]) -> float:
    """p-value, over all that were tried, of the gain that `effects` of an explanation make."""
    count = sum(len(e.sizes) for e in effects)
    return max(1e-12, min(1.0, float(fdtrc(count, explanation.left.freedom, max(gain, 0.0) / count)) * context.trials))


def compared(family: FittedFamily, first: ErrorTable) -> tuple[tuple[tuple[str, ...], float], ...]:
    """Keys of the effects and error of every model of listed effects alone, the least error first."""
    errors: dict[tuple[str, ...], float] = {}
    noisy = {hidden.declared for hidden in family.rows.hidden}
    for row, model in enumerate(family.models):
        keys = tuple(sorted(e.key for e in model.effects))
        if keys and row not in noisy and not any(isinstance(e, GenericTorque | GenericReading) for e in model.effects):
            errors[keys] = min(first.error(row), errors.get(keys, np.inf))
    return tuple(sorted(errors.items(), key=lambda one: one[1]))


def remainder(family: FittedFamily, decision: Decision) -> Remainder | None:
    """Place of the residual that the decision tells of; None without one."""
    if decision.terms == "":
        return None
    answer = decision.answer
    row = family.rows.own if decision.terms == "nominal" or answer is None else answer.with_generic
    return remainder_of(family.models[row])


def base(nominal: Model, refused: Mapping[str, str], reference: Mapping[str, tuple[float, float]] | None) -> Diagnosis:
    """Parts that every verdict has: runs, nominal parameters, what cannot be tested."""
    split = nominal.split
    names = split.mechanism.names
    values, covariance = with_tolerances(nominal)
    std = np.sqrt(np.diag(covariance))
    warnings = taken_in_words(nominal)
    if split.single:
        warnings.append("one run only: p-values and intervals are approximate, because parts of one run are not "
                        "independent; record several runs")
    elif len(split.names) < RUNS:
        warnings.append(f"{len(split.names)} runs only: the scatter between runs is poorly known; eight are better")
    if np.isinf(std).any():
        warnings.append("the nominal fit does not converge: the nominal parameters are least squares on filtered "
                        "motion and have no intervals")
    if reference:
        warnings += changes(dict(zip(names, zip(values, std))), reference)
    groups: dict[str, tuple[int, ...]] = {"fit": split.train, "screen": (), "confirm": split.test}
    noise = nominal.state.noise
    levels = torque_levels(noise, split.mechanism)
    if np.isfinite(noise.encoder).any():
        levels["encoder_rad"] = float(np.max(noise.encoder[np.isfinite(noise.encoder)]))
    if split.has_imu:
        levels |= imu_levels(noise)
    return Diagnosis(
        "none", "", confirm_runs=tuple(split.names[i] for i in split.test), not_testable=dict(refused),
        nominal=dict(zip(names, map(float, values))), nominal_std=dict(zip(names, map(float, std))),
        runs={k: tuple(split.names[i] for i in v) for k, v in groups.items()}, warnings=tuple(warnings), noise=levels,
        angle_range=nominal.problem.stage.angle_range)


def with_noise(found: Diagnosis, model: Model, floor: FloorNoise) -> Diagnosis:
    """`found` with the disturbance torques that count as noise, and warnings.

    A warning for each disturbance above the torque's noise that lasts longer than a sample, and for each noisy sensor.
    """
    mechanism, noise = model.split.mechanism, floor.noise
    shunt = max((float(noise.torque[j]) for j in mechanism.actuated), default=0.0)
    unmeasured = {j: float(level)
                  for j, (level, constant_s) in enumerate(zip(noise.disturbance, noise.time_constant), 1)
                  if level > shunt and constant_s > model.problem.dt}
    told = [f"an unmeasured torque of {level:.2g} {mechanism.unit('N m')} (rms, time constant "
            f"{noise.time_constant[j - 1]:.2g} s) acts {counted_as_noise(j)}" for j, level in unmeasured.items()]
    told += [f"{in_words(channel, ratio)}; this is a finding about the sensor, not about the simulation"
             for channel, ratio in noisy_sensors(model).items()]
    return replace(found, noise={**found.noise, **disturbance_levels(noise)}, warnings=(*found.warnings, *told),
                   unmeasured={j: f"{level:.2g} {mechanism.unit('N m')}" for j, level in unmeasured.items()})


def counted_as_noise(joint: int) -> str:
    """End of the warning that says so of the disturbance at a joint."""
    return f"at joint {joint}; it does not depend on the state and counts as noise"


def with_blind_sensors(diagnosis: Diagnosis, table: ErrorTable) -> Diagnosis:
    """`diagnosis` with a warning for each sensor of whose variance noise alone leaves more than SUFFICES in free runs.

    It names the shortest horizon. "Nothing found" is then no promise: an error as large as the motion does not show.
    """
    told: dict[str, str] = {}
    for (sensor, horizon_s), floor, variance in zip(table.columns, table.floor, table.bound, strict=True):
        if floor > SUFFICES * variance > 0.0:
            over = f"{horizon_s:g} s" if np.isfinite(horizon_s) else "whole runs"
            share = f"noise alone makes {100.0 * floor / variance:.0f} % of the variance of {sensor}"
            told.setdefault(sensor, f"{share} in free runs over {over}: an error of the simulation does not show there")
    return replace(diagnosis, warnings=(*diagnosis.warnings, *told.values()))


def changes(now: Mapping[str, tuple[float, float]], reference: Mapping[str, tuple[float, float]]) -> list[str]:
    """One line for each parameter that differs from the reference by `least_sigmas`."""
    out = []
    for name, (value, std) in now.items():
        if name in reference:
            old, old_std = reference[name]
            spread = float(np.hypot(std, old_std))
            if spread > 0 and abs(value - old) > least_sigmas(len(now)) * spread:
                out.append(f"{name} is {value:.4g}, the reference has {old:.4g} ({(value - old) / spread:+.1f} sigma): "
                           "a changed payload or link changes parameters only")
    return out


def remainder_of(model: Model) -> Remainder | None:
    """Place of the first generic term of `model`; None where it has none."""
    for effect in model.effects:
        if isinstance(effect, GenericTorque):
            joint = (effect.joint or 0) + 1
            return Remainder(joint, f"torque{joint}", effect.label)
        if isinstance(effect, GenericReading):
            return Remainder(None, str(effect.channel), effect.label)
    return None


def nothing(diagnosis: Diagnosis, immaterial: tuple[Cause, ...] = ()) -> Diagnosis:
    """Verdict `none`; `immaterial` are there, but hardly change the simulation."""
    best = diagnosis.candidates[0] if diagnosis.candidates else None
    sentence = "These runs show no error beyond noise"
    if best is not None:
        sentence += (f". The nearest effect, {label(best.effect, best.joint)}, is not significant (p = "
                     f"{best.p_value:.2g}, corrected for all effects tried)")
    if best is not None and best.p_value < ALPHA:
        sentence = (f"No material error beyond noise. The residual resembles {label(best.effect, best.joint)} "
                    f"(p = {best.p_value:.2g}, corrected for all effects tried), but that effect does not reduce the "
                    "free-run error of the held-out runs")
    if immaterial:
        told = " and ".join(label(c.effect, c.joint) for c in immaterial)
        verb = ("is present, but does not surely reduce" if len(immaterial) == 1 else
                "are present, but not each of them surely reduces")
        sentence = (f"No material error beyond noise. {told[:1].upper()}{told[1:]} {verb} the free-run rms error by "
                    f"{100 * diagnosis.material:.0f} %")
    if diagnosis.unmeasured:
        sentence += (". Noise includes an unmeasured torque of "
                     + " and ".join(f"{level} (rms) at joint {j}" for j, level in diagnosis.unmeasured.items()))
    called = "None is needed"
    if diagnosis.error is not None and diagnosis.error[0] > 1.0 / (1.0 - diagnosis.material):
        before, after = diagnosis.error
        lower = bool(immaterial) and after < before * (1.0 - diagnosis.material)
        why = ("No tried effect reduces it: the cause is a correlated disturbance, or resembles none of the terms tried"
               if not lower else
               f"It is {after:.1f} times with the effects that are present but not material")
        if diagnosis.remainder is not None:
            why = (f"Generic terms reduce it{_where(diagnosis)}. Up to {EDGE:g} times noise an error is not called "
                   "unexplained")
        diagnosis = replace(diagnosis, warnings=(*diagnosis.warnings, (
            f"the free-run error is {before:.1f} times that of noise alone. {why}")))
        called = "None is needed if that error is acceptable"
    return replace(diagnosis, verdict="none", sentence=sentence + ".", immaterial=immaterial,
                   next_experiment=f"{called}. To look for smaller effects, record more runs like these: the smallest "
                   "detectable sizes fall with the square root of their number.")


def tolerated(diagnosis: Diagnosis, causes: tuple[Cause, ...]) -> Diagnosis:
    """Verdict `none` where what is there and changes the simulation is within the tolerances of the rig."""
    told = "; ".join(f"{label(c.effect, c.joint)}, {sizes_text(c)}" for c in causes)
    before, after = diagnosis.error or (np.nan, np.nan)
    return replace(diagnosis, verdict="none", immaterial=causes, sentence=(
        f"No fault beyond the tolerances of the rig. Within them, {told} explains the error: {before:.2g} times that "
        f"of noise alone, {after:.2g} with it."), next_experiment="None is needed if that is acceptable. To have the "
        "simulation right, calibrate it, or state its size in the rig file.")


def unexplained(diagnosis: Diagnosis, nominal: Model, best: Explanation | None, why: str,
                rng: np.random.Generator, noise: FloorNoise, p_value: float = 1.0) -> Diagnosis:
    """Verdict `unexplained`: the closest explanation, if any, is kept with its p-value, but not named as a finding."""
    sentence = f"The model is wrong, and no listed effect explains the error: {why}."
    causes: tuple[Cause, ...] = ()
    if best is not None:
        causes = tuple(causes_of(best, p_value, diagnosis))
        diagnosis = with_gain(diagnosis, nominal, best, noise, rng)
        sentence = (f"The model is wrong, and no listed effect explains the error. The closest, "
                    f"{' with '.join(label(c.effect, c.joint) for c in causes)}, does not suffice: {why}.")
    return replace(diagnosis, verdict="unexplained", sentence=sentence, causes=causes, effects=(),
                   next_experiment=NEXT_UNEXPLAINED)


def finding(found: Diagnosis, nominal: Model, indistinguishable: Sequence[Explanation], p_value: float,
            rng: np.random.Generator, partial: bool, noise: FloorNoise) -> Diagnosis:
    """Verdict `named`, or `one_of` where several explanations fit alike; `partial` where the residual is material."""
    best = indistinguishable[0]
    lacking = undetermined_sizes(best)
    if lacking:
        found = replace(found, warnings=(*found.warnings, f"these runs do not determine {' and '.join(lacking)}: other "
                                         "sizes or parameters can replace them"))
    found = with_gain(found, nominal, best, noise, rng)
    listed = [list(zip(t.model.effects, causes_of(t, p_value, found), strict=True)) for t in indistinguishable]
    rivals = [[c for e, c in own if e.key in t.beyond or not t.beyond] for t, own in zip(indistinguishable, listed)]
    causes = tuple({c.effect + str(c.joint): c for own in rivals for c in own}.values())
    found = replace(found, immaterial=(*found.immaterial, *(c for e, c in listed[0] if e.key in best.within)))
    if len(indistinguishable) == 1:
        told = "; ".join(_told(c) for c in rivals[0])
        sentence = f"{told[0].upper()}{told[1:]}."
        steps = "; ".join(sorted({e.experiment for e in best.model.effects}))
        if partial:
            sentence += f" A material residual remains that no listed effect explains{_where(found)}."
        return replace(found, verdict="partial" if partial else "named", sentence=sentence,
                       causes=causes, next_experiment=f"To measure it better: {steps}.")
    told = " or ".join(" with ".join(_told(c) for c in r) for r in rivals)
    steps = "; ".join(f"for {' and '.join(e.key for e in t.model.effects)}: "
                      f"{'; '.join(e.experiment for e in t.model.effects)}" for t in indistinguishable)
    return replace(found, verdict="one_of", sentence=f"One of these causes; these runs cannot tell which: {told}.",
                   causes=causes, next_experiment=f"To tell them apart: {steps}.")


def _told(cause: Cause) -> str:
    """Its sentence, its place and its sizes with intervals."""
    return f"{cause.sentence}: {label(cause.effect, cause.joint)}, {sizes_text(cause)}"


def _where(diagnosis: Diagnosis) -> str:
    """Place of the remainder, in words."""
    left = diagnosis.remainder
    return "" if left is None else f": it is in {left.channel}, as a function of {left.depends_on}"


def with_gain(diagnosis: Diagnosis, nominal: Model, best: Explanation, noise: FloorNoise,
              rng: np.random.Generator) -> Diagnosis:
    """`diagnosis` with the gain over the floor of `noise`, the extended parameters and the pictures of `best`."""
    model = best.model
    diagnosis = replace(with_model(diagnosis, best), signatures=tuple(
        s for e in model.effects if (s := signature(nominal, model, e)) is not None))
    told = [replace(one.fitted, parameters=values) for one, values in (
        (nominal, np.array(list(diagnosis.nominal.values()))), (model, diagnosis.extended_beta))]
    try:
        gain = measure_gain(model, smoothed_tests(told, model), rng, noise)
    except FitError as error:
        return replace(diagnosis, warnings=(*diagnosis.warnings, f"the gain could not be measured: {error}"))
    if gain.ci95 is None or gain.ci95[0] <= 0.0:
        unsure = () if diagnosis.rotations else (NO_GAP if gain.closed is None else UNSURE_GAP,)  # all runs have said
        diagnosis = replace(diagnosis, warnings=(*diagnosis.warnings, *unsure))
    return replace(diagnosis, sensors=gain.sensors, gap_closed=gain.closed, gap_closed_ci95=gain.ci95,
                   torque_rms_nm=gain.torque, traces=gain.traces)


def with_model(found: Diagnosis, best: Explanation) -> Diagnosis:
    """`found` with the extended parameters of `best`."""
    values, covariance = best.estimate
    names, std = best.model.split.mechanism.names, np.sqrt(np.diag(covariance))
    return replace(
        found, extended=dict(zip(names, map(float, values))), extended_std=dict(zip(names, map(float, std))),
        effects=tuple(zip(best.model.effects, best.sizes())), extended_beta=values, extended_covariance=covariance)


def causes_of(explanation: Explanation, p_value: float, diagnosis: Diagnosis) -> list[Cause]:
    """Sizes with their 95 % intervals.

    Without sizes that these runs do not determine, and without shapes that were held or are at a limit of their range.
    """
    model = explanation.model
    unit = model.problem.mechanism.unit
    half = explanation.half_widths
    keys, cosines = diagnosis.separability
    out = []
    for effect, size, here in zip(model.effects, explanation.sizes(), model.places()):
        parts: list[Size | Shape] = [*effect.sizes, *effect.shapes]
        fitted = np.array([not s.discrete for s in effect.shapes], dtype=bool)
        held = effect.at_limits(size) | ((half[here][len(effect.sizes) :] == 0.0) & fitted)
        told = np.append(explanation.determined[here][: len(effect.sizes)], ~held)
        sizes = tuple(SizeEstimate(s.name, unit(s.unit), float(v), interval(model, effect, float(v), float(d)))
                      for s, v, d, known in zip(parts, size, half[here], told) if known)
        near: tuple[str, ...] = ()
        if effect.key in keys:
            row = np.abs(cosines[keys.index(effect.key)])
            near = tuple(dict.fromkeys(k.split("@")[0] for k, c in zip(keys, row)
                                       if c**2 > SUFFICES and k.split("@")[0] != effect.name))
        out.append(Cause(effect.name, effect.joint_number, effect.told(size), sizes, p_value, explanation.gain,
                         near))
    return out


def interval(model: Model, effect: Effect, value: float, half: float) -> tuple[float, float]:
    """(low, high) of a size: value -+ half.

    A torque's delay depends on how it acts between samples. So its interval also holds the intervals about the delays
    that the likelihood of the hold found, up to half a sample from the value: the most by which two holds differ.
    """
    others = [-delay_s for delay_s in model.split.delays_s if isinstance(effect, TorqueDelay)]
    near = [value, *(other for other in others if abs(other - value) < 0.5 * model.problem.dt)]
    return min(near) - half, max(near) + half


def with_minor(answer: Explanation, more: Explanation) -> Explanation:
    """The `answer` as it is fitted together with the further effect of `more`, which is `within`."""
    return replace(more, gain=answer.gain, within=answer.within | more.keys - answer.keys)


def undetermined_sizes(explanation: Explanation) -> list[str]:
    """Each size that these runs do not determine, with its effect, in words."""
    model = explanation.model
    return [f"the {size.name.replace('_', ' ')} of {effect.key.replace('_', ' ').replace('@', ' at joint ')}"
            for effect, here in zip(model.effects, model.places())
            for size, known in zip(effect.sizes, explanation.determined[here]) if not known]


def label(effect: str, joint: int | None) -> str:
    """Effect and joint in words."""
    return effect.replace("_", " ") + ("" if joint is None else f" at joint {joint}")


def sizes_text(cause: Cause) -> str:
    """Sizes with their intervals in words."""
    return ", ".join(f"{s.name.replace('_', ' ')} {s.value:.3g}{'' if s.unit == '1' else ' ' + s.unit} "
                     f"[{s.ci95[0]:.3g}, {s.ci95[1]:.3g}]" for s in cause.size)
