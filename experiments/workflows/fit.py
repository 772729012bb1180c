"""`fit_runs`: runs prepared, estimated, checked, and all findings joined once into the result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from msgspec import structs

from daq import Dataset, InputError, Rig
from estimator import FIT_ERRORS, Finding, FitError, FitResult, Method
from estimator.fitting import UNLIMITED, fit_admissible, with_second_opinion
from estimator.model import Mechanism
from estimator.prediction import SHORT_S, FittedModel, predict_filtered, predict_left_out, uses_of
from estimator.score import TORQUE_GAIN
from estimator.signals import split_signals
from experiments.documents import FitDocument
from experiments.judge import disputed
from experiments.session import (
    Choice,
    Prepared,
    RunFlag,
    Runs,
    SetAside,
    Setup,
    as_datasets,
    needs_law,
    prepare,
    suspect,
    with_choices,
)
from experiments.workflows.loop_values import LoopValues, find_loop_values, in_units, loop_findings, with_open_damping
from experiments.workflows.servo_gain import scaled

D = TypeVar("D", bound=FitDocument)
NOISY = 0.2
"""Share of a torque's spread that, put down to noise, asks whether the angles err by more than their encoder shows."""
NEARLY_ALL = 0.98
"""Share of the samples from which on a fit does not say how many it has used."""
NOT_WHITE = 0.25
"""Such a share that remains at the end is said: intervals take it for white. (On two real arms the published values lie
up to eight half widths away.)"""
LEVELS = (2.5, 6.0)
"""Times its estimate that an encoder's error is then taken to be."""
BETTER = 0.05
"""Share by which the next second must be predicted better for it. (Measured on two real arms: 45 and 57 %.)"""


@dataclass(frozen=True)
class Fitted:
    """A fit with what was chosen for it."""

    setup: Setup
    result: FitResult
    rig: Rig
    """With the choices in it."""
    choices: tuple[Choice, ...]
    aside: tuple[SetAside, ...] = ()
    """Runs that were not used."""
    flags: tuple[RunFlag, ...] = ()
    """Of the runs that were."""
    servo_gain: tuple[float, float, float] | None = None
    """Value and 95 % interval of a servo's gain that the fit found"""

    def as_document(self, kind: type[D]) -> D:
        """`legid.fit/1` as `kind`, the struct or one derived from it, without its provenance."""
        return kind.of(self.result, self.setup.settings, self.setup.datasets, self.aside, self.choices,
                       self.servo_gain)


def fit_runs(runs: Runs, rig: Rig, *, sensors: str | None = None, fixed: Mapping[str, float] | None = None,
             latent: str = "trajectory", method: Method = "mle", damaged: bool = False, choose: bool = True) -> Fitted:
    """A fit of the `runs` that can be used. What `rig` leaves open is chosen by the records, unless `choose` is False.

    A servo whose gain is not known is fitted in units of the gain, which the one parameter in `fixed` then tells.
    Raises `InputError` and `FitError` as `prepare`, and `FitError` where the data cannot answer, with the remedies of a
    set-up that contradicts itself.
    """
    datasets = as_datasets(runs, rig, damaged)
    gainless = rig.servo is not None and rig.servo.gain is None and any(needs_law(data, rig) for data in datasets)
    name, value = _gain_teller(rig, fixed) if gainless else ("", 0.0)
    used = _in_units_of_gain(rig) if gainless else rig
    loop = find_loop_values(datasets, used, sensors) if choose and method == "mle" else LoopValues()
    given = loop.choices
    prepared = prepare(datasets, with_choices(used, given), sensors=sensors, fixed=None if gainless else fixed,
                       latent=latent, choose=choose)
    setup, choices = prepared.setup, (*given, *prepared.choices)
    unknown = dict.fromkeys((*setup.options.unknown_loop, *(choice.key for choice in given)))
    setup = replace(setup, options=replace(setup.options, unknown_loop=tuple(unknown)))
    if gainless and name not in setup.mechanism.names:
        raise InputError("--fix", f"{rig.mechanism.model} has no parameter {name}",
                         f"it has {', '.join(setup.mechanism.names)}")
    if gainless and setup.tolerances is not None:  # the parameter that is given tells the scale
        setup = replace(setup, tolerances={**setup.tolerances, TORQUE_GAIN: (0.0,)})
    result, wrong = _checked(setup, method)
    if choose and method == "mle" and latent == "trajectory" and rig.noise.encoder_rad is None and result.converged:
        found = encoder_error(setup, result)
        if found is not None:
            choice, setup, result, wrong = found
            choices = (*choices, choice)
    findings = [*_of_runs(prepared), *_of_samples(result, setup.datasets), *_noise_findings(result),
                *result.findings, *wrong,
                *(Finding("assumption", "run_note", text) for text in setup.notes),
                *(Finding("assumption", "choice", str(choice)) for choice in choices if choice not in given)]
    result = with_uses(setup, result)
    choices = (*choices, *_found_smoothing(setup.mechanism, result.mechanism))  # its fit has said so
    gain, result = None, replace(result, loop=(*result.loop, *loop.hidden))
    if gainless:
        result, size, half = scaled(result, name, value)
        gain, choices = (size, size - half, size + half), in_units(choices, size)
    known = with_choices(rig, choices)
    if known.servo is not None and choose and method == "mle":
        result = with_open_damping(result, known.servo)
        findings += loop_findings(result, known.servo)
    if gain is not None and known.servo is not None:
        known = structs.replace(known, servo=structs.replace(known.servo, gain=gain[0]))
        findings.append(_gain_finding(gain, rig, result.mechanism, f"{name} = {value:g}"))
    return Fitted(setup, _joined(result, findings), known, choices, prepared.set_aside, prepared.flags, gain)


def _checked(setup: Setup, method: Method = "mle") -> tuple[FitResult, tuple[Finding, ...]]:
    """A fit, and what its set-up contradicts. Raises `FitError`, naming the remedies."""
    try:
        options = replace(setup.options, seeks_omitted=True, tolerances=setup.tolerances, gear_ratio=setup.gear_ratio)
        result = fit_admissible(setup.datasets, setup.mechanism, options, method)
    except FitError as error:
        fixes = suspect(setup.datasets, setup.mechanism, setup.options, setup.gear_ratio, True).remedies
        raise FitError("; ".join([str(error), *["; or ".join(fixes)] * bool(fixes)])) from None
    result = with_second_opinion(setup.datasets, setup.mechanism, setup.options, result)
    kinds = {one.kind for one in result.findings}
    suspected = not result.converged or bool(kinds & {"impossible", "level_negative"})
    seen = suspect(setup.datasets, setup.mechanism, setup.options, setup.gear_ratio, suspected)
    against = () if "impossible" in kinds else seen.against
    return result, (*(Finding("fault", "columns", text) for text in against),
                    *(Finding("doubt", "sensor_scale", text) for text in seen.scales),
                    *(Finding("remedy", "columns", text) for text in seen.remedies))


def with_uses(setup: Setup, result: FitResult) -> FitResult:
    """`result` with what it is good for by runs that it was not fitted to; as it is where that cannot be said."""
    opinion = result.second_opinion
    if result.method == "shooting" and opinion and opinion.held_out and opinion.held_out.use:
        return replace(result, uses=(opinion.held_out.use,))
    with suppress(*FIT_ERRORS):
        table = predict_left_out(result, split_signals(setup.datasets, result.mechanism, setup.options), setup.options)
        return result if table is None else replace(result, uses=uses_of(table, result.mechanism))
    return result


def _joined(result: FitResult, findings: Sequence[Finding]) -> FitResult:
    """`result` with `findings` in place of its own; assumptions among them follow the estimator's."""
    more = tuple(one.text for one in findings if one.role == "assumption")
    return replace(result, findings=tuple(findings), assumptions=(*result.assumptions, *more))


def _of_runs(prepared: Prepared) -> list[Finding]:
    """Runs that were set aside, and flags of the others."""
    return [*(Finding("warning", "run_set_aside", str(run)) for run in prepared.set_aside),
            *(Finding("doubt", "rig_contradiction", f"the rig file contradicts a run: {one}")
              if one.flag.kind == "rig" else Finding("warning", "run_doubt", str(one)) for one in prepared.flags)]


def _of_samples(result: FitResult, datasets: Sequence[Dataset]) -> list[Finding]:
    """How many samples of the runs the fit has used, if it is not nearly all."""
    recorded = sum(map(len, datasets))
    if result.samples >= NEARLY_ALL * recorded:
        return []
    return [Finding("assumption", "run_note", f"uses {result.samples} of {recorded} samples: the others are gaps, or "
                    "too few between gaps")]


def _noise_findings(result: FitResult) -> list[Finding]:
    """Torque that is put down to noise, where that is too much to be white."""
    if (share := noise_share(result)) <= NOT_WHITE:
        return []
    narrow = "intervals allow for what runs disagree about alone" if disputed(result) else "intervals may be too narrow"
    return [Finding("warning", "noise_share", f"{100 * share:.0f} % of the torque's spread counts as noise, which "
                    f"is hardly white: {narrow}")]


def noise_share(result: FitResult) -> float:
    """Torque that a fit puts down to noise, as a share of the spread of what was measured, at the worst joint."""
    mechanism: Mechanism = result.mechanism
    if not result.trajectories or not mechanism.actuated:
        return 0.0
    torque = np.concatenate([t.tau_measured for t in result.trajectories])[:, list(mechanism.actuated)]
    return float(result.noise.get("torque_nm", 0.0) / max(float(np.std(torque, axis=0).max()), 1e-300))


def encoder_error(setup: Setup, result: FitResult
                  ) -> tuple[Choice, Setup, FitResult, tuple[Finding, ...]] | None:
    """A larger error of the encoders than they show, such as play, where a fit that takes it for granted predicts the
    next second better; None where none does.

    Without it the likelihood holds on to angles that are off by play, and puts torque down to noise instead.
    """
    share = noise_share(result)
    if share < NOISY or "encoder_rad" not in result.noise:
        return None
    first = best = _score(setup, result)
    shown, found = result.noise["encoder_rad"], None
    for times in LEVELS:
        level = float(f"{times * shown:.1g}")
        trial = replace(setup, options=replace(setup.options, noise={**setup.options.noise, "encoder_rad": level}))
        try:
            tried, wrong = _checked(trial)
        except FitError:
            continue
        score = _score(setup, tried)
        faulty = any(one.role == "fault" for one in (*tried.findings, *wrong))
        if tried.converged and not faulty and score < best + np.log(1.0 - BETTER):
            best = score
            why = (f"angle errors above the encoder's noise {shown:.2g} (play, or jitter of time stamps): "
                   f"{100 * share:.0f} % of the torque's spread counted as noise")
            gain = f"{100 * (1 - np.exp(best - first)):.0f} % better" if np.isfinite(first) else "at all"
            choice = Choice("noise", "encoder_rad", level, why, f"the next second is predicted {gain}")
            found = choice, trial, tried, wrong
    return found


def _score(setup: Setup, result: FitResult) -> float:
    """Log of the error of a fit's free runs over a second from filtered motion, over that of the last velocity kept."""
    likeliest = result.beta - (0.0 if result.budget is None else result.budget.moved)
    model = FittedModel(result.mechanism, result.hold, likeliest)
    signals = split_signals(setup.datasets, result.mechanism, setup.options)
    return predict_filtered([model], signals, setup.options, SHORT_S).score(SHORT_S)


def _found_smoothing(stated: Mechanism, mechanism: Mechanism) -> list[Choice]:
    """The friction smoothing velocities of a fit, where they are not the ones stated."""
    if np.array_equal(mechanism.velocity_scales, stated.velocity_scales):
        return []
    value = tuple(float(f"{speed:.2g}") for speed in mechanism.velocity_scales)
    return [Choice("terms", "friction_velocity_radps", value, "friction that takes its full level over that speed",
                   "the likeliest of speeds from the default up")]


def _gain_teller(rig: Rig, fixed: Mapping[str, float] | None) -> tuple[str, float]:
    """The one parameter that was given, and its value. Raises `FitError`."""
    if fixed is None or len(fixed) != 1:
        raise FitError("these runs do not determine the servo's gain: give it as gain under [servo], or give one "
                       "parameter with --fix NAME=VALUE")
    (name, value), = fixed.items()
    return name, value


def _in_units_of_gain(rig: Rig) -> Rig:
    assert rig.servo is not None
    return structs.replace(rig, servo=structs.replace(rig.servo, gain=1.0, limit=UNLIMITED))


def _gain_finding(gain: tuple[float, float, float], rig: Rig, mechanism: Mechanism, given: str) -> Finding:
    unit = "1/rad of duty" if rig.mechanism.input == "voltage" else f"{mechanism.force_unit}/rad"
    return Finding("assumption", "servo_gain", f"the servo's gain is {gain[0]:.4g} [{gain[1]:.4g}, {gain[2]:.4g}] "
                   f"{unit}, by {given}, which was given")
