"""The law of a position loop: which fault of a reading or of the loop it shows, in runs written down by hand."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from pytest import approx, mark

from daq import Dataset, FloatArray
from estimator import Diagnosis
from estimator.change import Change, with_changed_law
from estimator.diagnosis import with_law
from estimator.effects import classes
from estimator.loops import (
    LAW_FAULTS,
    LEAST_SHARE,
    LawSizes,
    changed_law,
    check_law,
    corrected_readings,
    law_checks,
    law_runs,
)
from estimator.model import leg2

RATE_HZ, SECONDS = 100.0, 10.0
TIME = np.arange(0.0, SECONDS, 1.0 / RATE_HZ)
LEG = leg2()
Wave = Callable[[FloatArray], FloatArray]
Spoil = Callable[[dict[str, Wave]], dict[str, FloatArray]]


def waves(seed: int) -> dict[str, Wave]:
    """Command, and an angle that follows it late and falls short, as functions of time."""
    rng = np.random.default_rng(seed)
    f = rng.uniform(0.1, 2.0, 6)
    phase, size = rng.uniform(0.0, 6.0, 6), rng.uniform(0.1, 0.4, 6)

    def sines(t: FloatArray, lag: float, share: float) -> FloatArray:
        return share * np.sum(size * np.sin(2.0 * np.pi * f * (t[:, None] - lag) + phase), axis=1)

    return {"command": lambda t: sines(t, 0.0, 1.0), "angle": lambda t: sines(t, 0.05, 0.9)}


def torque(of: dict[str, Wave], t: FloatArray, gain: float = 6.0) -> FloatArray:
    return gain * (of["command"](t) - of["angle"](t))


def healthy(of: dict[str, Wave]) -> dict[str, FloatArray]:
    return {"q2_cmd_rad": of["command"](TIME), "q2_rad": of["angle"](TIME), "tau2_nm": torque(of, TIME)}


def runs(spoil: Spoil = healthy, seed: int = 1) -> list[Dataset]:
    """With an encoder of 12 bits and noise of the torque."""
    found = []
    for k in range(4):
        columns, rng = spoil(waves(10 * seed + k)), np.random.default_rng([seed, k])
        step = 2.0 * np.pi / 4096.0
        columns["q2_rad"] = np.round(columns["q2_rad"] / step) * step
        columns["tau2_nm"] = columns["tau2_nm"] + 0.005 * rng.normal(size=TIME.size) * (columns["tau2_nm"] != 0.0)
        found.append(Dataset(f"r{k + 1}", RATE_HZ, TIME, columns))
    return found


def late_torque(of: dict[str, Wave]) -> dict[str, FloatArray]:
    return {**healthy(of), "tau2_nm": torque(of, TIME - 0.02)}


def saturated(of: dict[str, Wave]) -> dict[str, FloatArray]:
    """A current that grows by the fifth power of the torque, too."""
    u = torque(of, TIME)
    return {**healthy(of), "tau2_nm": u * (1.0 + 0.3 * (u / 2.0) ** 4)}


def scaled(of: dict[str, Wave]) -> dict[str, FloatArray]:
    return {**healthy(of), "q2_rad": 1.06 * of["angle"](TIME)}


def eccentric(of: dict[str, Wave]) -> dict[str, FloatArray]:
    q = of["angle"](TIME)
    return {**healthy(of), "q2_rad": q + np.arctan2(0.08 * np.sin(q - 0.7), 1.0 + 0.08 * np.cos(q - 0.7))}


def late_command(of: dict[str, Wave]) -> dict[str, FloatArray]:
    return {**healthy(of), "tau2_nm": 6.0 * (of["command"](TIME - 0.03) - of["angle"](TIME))}


def dead(of: dict[str, Wave]) -> dict[str, FloatArray]:
    error = torque(of, TIME, 1.0)
    return {**healthy(of), "tau2_nm": 6.0 * np.sign(error) * np.maximum(np.abs(error) - 0.03, 0.0)}


def integrating(of: dict[str, Wave]) -> dict[str, FloatArray]:
    error = torque(of, TIME, 1.0)
    return {**healthy(of), "tau2_nm": 6.0 * error + 9.0 * np.cumsum(error) / RATE_HZ}


def damped(of: dict[str, Wave]) -> dict[str, FloatArray]:
    rate = (of["angle"](TIME + 1e-4) - of["angle"](TIME - 1e-4)) / 2e-4
    return {**healthy(of), "tau2_nm": torque(of, TIME) - 0.2 * rate}


FAULTS = {
    "torque_delay": (late_torque, 0.02), "torque_saturation": (saturated, None), "encoder_scale": (scaled, 0.06),
    "encoder_eccentricity": (eccentric, None), "command_delay": (late_command, 0.03),
    "command_dead_band": (dead, 0.03), "missing_integral": (integrating, 1.5)}
"""Effect to what makes it and, where it is the library's function, its size."""


@mark.parametrize("effect", FAULTS)
def test_a_fault_is_named_with_its_size(effect: str) -> None:
    spoil, size = FAULTS[effect]
    (check,) = law_checks(runs(spoil), LEG)
    (cause,) = check.causes
    assert (cause.effect, cause.joint) == (effect, 1) and cause.p_value < 0.01
    assert cause.share[0] > LEAST_SHARE and cause.share[1] < 0.5 * cause.share[0]
    if size is not None:
        assert cause.size[0] == approx(size, rel=0.08)
    assert check.after.gains == approx(np.full(4, 6.0), rel=0.05)


def test_the_faults_are_those_of_this_test_and_effects_of_the_library() -> None:
    named = {fault.effect for fault in LAW_FAULTS if not fault.of_law}
    assert named == set(FAULTS) and named <= {kind.name for kind in classes()}


@mark.parametrize("seed", range(2, 8))
def test_a_healthy_loop_has_no_fault(seed: int) -> None:
    (check,) = law_checks(runs(seed=seed), LEG)
    assert not check.causes and not check.broken and check.before.share < LEAST_SHARE


def test_damping_that_nobody_states_is_a_term_of_the_law() -> None:
    (check,) = law_checks(runs(damped), LEG)
    assert not check.causes and [fault.effect for fault, _ in check.after.faults] == ["damping"]


def test_two_faults_are_found_one_after_the_other() -> None:
    def both(of: dict[str, Wave]) -> dict[str, FloatArray]:
        return {**scaled(of), "tau2_nm": torque(of, TIME - 0.04)}

    (check,) = law_checks(runs(both), LEG)
    assert {cause.effect for cause in check.causes} == {"torque_delay", "encoder_scale"}


def test_samples_at_the_limit_and_without_power_say_nothing() -> None:
    def limited(of: dict[str, Wave]) -> dict[str, FloatArray]:
        u = np.clip(torque(of, TIME), -1.0, 1.0)
        u[700:] = 0.0
        return {**healthy(of), "tau2_nm": u}

    (run, *_) = law_runs(runs(limited), LEG, 1)
    assert not run.used[705:].any() and not run.used[np.abs(torque(waves(10), TIME)) > 1.0].any()
    assert not check_law(law_runs(runs(limited), LEG, 1), 1).causes


def test_an_input_of_another_law_is_said_and_nothing_is_named() -> None:
    def other(of: dict[str, Wave]) -> dict[str, FloatArray]:
        return {**healthy(of), "tau2_nm": np.sin(7.0 * TIME) * np.cos(3.0 * TIME)}

    checks = law_checks(runs(other), LEG)
    found = with_law(Diagnosis("none", "Nothing."), checks, LEG, 1.0)
    assert found.verdict == "none" and "is not gain x (command - angle)" in found.warnings[0]


def test_a_law_that_leaves_most_of_the_input_names_no_fault() -> None:
    """A controller of torque that feeds a plan forward, too: an eccentric encoder halves what a position loop lacks."""
    def fed_forward(of: dict[str, Wave]) -> dict[str, FloatArray]:
        spoilt = eccentric(of)
        return {**spoilt, "tau2_nm": spoilt["tau2_nm"] + 0.15 * np.sin(7.0 * TIME)}

    (check,) = law_checks(runs(fed_forward), LEG)
    assert check.broken and not check.causes and not check.after.faults


def test_an_input_that_a_law_made_says_nothing_of_the_law() -> None:
    assert law_checks([replace(run, by_law=(2,)) for run in runs()], LEG) == []
    assert law_checks([replace(run, columns={"q2_rad": run["q2_rad"]}) for run in runs()], LEG) == []


def test_corrected_readings_are_those_without_the_fault() -> None:
    spoilt, plain = runs(scaled), runs()
    (check,) = law_checks(spoilt, LEG)
    fixed = corrected_readings(spoilt, LEG, 1, check.after.faults)
    assert np.abs(fixed[0]["q2_rad"] - plain[0]["q2_rad"]).max() < 0.005
    assert fixed[0]["tau2_nm"] == approx(spoilt[0]["tau2_nm"])


def test_a_diagnosis_has_what_the_law_shows_as_its_cause_and_in_its_model() -> None:
    checks, zeros = law_checks(runs(late_torque), LEG), dict.fromkeys(LEG.names, 0.1)
    leg = Diagnosis("none", "Nothing.", nominal=zeros, nominal_std=zeros)
    found = with_law(leg, checks, LEG, 1.0)
    (cause,) = found.causes
    assert (found.verdict, cause.effect, cause.joint) == ("named", "torque_delay", None)
    low, high = cause.size[0].ci95
    assert 0.0195 < low < high < 0.0205 and "the law of the loop errs by" in found.sentence
    assert found.effects[0][1] == approx([0.02], rel=0.05)
    assert found.extended_covariance.shape == (LEG.p + 1, LEG.p + 1) and len(found.extended_beta) == LEG.p + 1
    assert with_law(replace(leg, verdict="unexplained"), checks, LEG, 1.0).verdict == "partial"


def sizes(spoil: Spoil = healthy) -> LawSizes:
    return LawSizes.of(runs(spoil), LEG)


def test_what_was_there_before_is_no_change() -> None:
    def later(of: dict[str, Wave]) -> dict[str, FloatArray]:
        return {**healthy(of), "tau2_nm": torque(of, TIME - 0.045)}

    assert changed_law(sizes(late_torque), runs(late_torque, seed=2), LEG) == []
    assert changed_law(sizes(), runs(seed=2), LEG) == []
    (change,) = changed_law(sizes(late_torque), runs(later, seed=2), LEG)
    assert change.cause.size[0] == approx(0.025, rel=0.08)
    found = with_changed_law(Change("no_change", "No change."), [change], LEG, 1.0)
    (cause,) = found.causes
    assert (found.verdict, cause.effect, cause.kind) == ("named", "torque_delay", "timing")


def test_a_diagnosis_and_a_comparison_have_an_integral_in_one_unit() -> None:
    """Of the gain of 6 N m/rad an integral of 1.5 /s is 9 N m/(rad s)."""
    zeros = dict.fromkeys(LEG.names, 0.1)
    leg = Diagnosis("none", "Nothing.", nominal=zeros, nominal_std=zeros)
    (cause,) = with_law(leg, law_checks(runs(integrating), LEG), LEG, 1.0).causes
    changes = changed_law(sizes(), runs(integrating, seed=2), LEG)
    (changed,) = with_changed_law(Change("no_change", "No change."), changes, LEG, 1.0).causes
    assert cause.effect == changed.effect == "missing_integral" and changed.size[0].unit == cause.size[0].unit
    assert [cause.size[0].value, changed.size[0].value] == approx([9.0, 9.0], rel=0.1)
