"""Parameters that no mechanism has are held at their bound or named; those of one are left alone."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from pytest import approx, mark

from estimator import FitOptions, Method, fit
from estimator.fitting import faults, fit_admissible
from estimator.fitting.admissibility import upper_end
from estimator.fitting.identifiability import undetermined
from estimator.model import joint1, leg2
from tests.support.prescribed import SWING_RIG, negated, swing_run, written
from tests.support.shell import Shell

ENCODER = FitOptions(sensors="encoder")


@mark.parametrize("method", ["mle", "wls"])
def test_friction_that_pushes_is_held_at_zero_and_said_so(method: Method) -> None:
    run = swing_run(viscous=-0.05, coulomb=0.2)
    free = fit([run], joint1(), ENCODER, method)
    held = fit_admissible([run], joint1(), ENCODER, method)
    k = free.mechanism.column("beta3")
    assert free.beta[k] < -0.03
    assert held.beta[k] == 0.0 and list(held.at_bound) == ["beta3"] and not held.fixed
    assert held.beta[k + 1] == approx(fit([run], joint1(), replace(ENCODER, fixed={"beta3": 0.0}),
                                                 method).beta[k + 1])
    assert "not scatter" in held.warnings[0] and "beta3" in held.warnings[0]
    assert not held.inadmissible


def test_a_level_that_is_zero_keeps_an_interval_that_holds_it() -> None:
    """Half of such fits come out below zero: their interval reaches from zero up."""
    run = swing_run(viscous=0.0, coulomb=0.0)
    free = fit([run], joint1(), ENCODER)
    held = fit_admissible([run], joint1(), ENCODER)
    below = [k for k in (2, 3) if free.beta[k] < 0.0]
    assert below  # of this seed
    for k in below:
        low, high = held.ci95()[k]
        assert low == 0.0 and high < 0.02
    first = min(below, key=lambda k: free.beta[k] / free.std[k])  # the others are held in fits that are not known here
    assert held.ci95()[first, 1] == approx(upper_end(float(free.beta[first]), float(free.std[first])))
    assert not any("not scatter" in text for text in held.warnings)
    good = swing_run(viscous=0.05, coulomb=0.1)
    plain, same = fit([good], joint1(), ENCODER), fit_admissible([good], joint1(), ENCODER)
    assert np.array_equal(plain.beta, same.beta) and not same.at_bound and not same.warnings


def test_the_interval_of_a_level_below_zero_holds_what_it_says_and_is_never_nothing() -> None:
    """Of levels drawn evenly that give such an estimate, 95 % lie below the end; so far out that no normal probability
    is left, too."""
    rng = np.random.default_rng(3)
    for value in (-0.5, -2.0):
        truth = rng.uniform(0.0, 6.0, 2_000_000)
        seen = truth[np.abs(truth + rng.normal(size=truth.size) - value) < 0.05]
        assert np.mean(seen < upper_end(value, 1.0)) == approx(0.95, abs=4.0 * np.sqrt(0.05 * 0.95 / seen.size))
    ends = [upper_end(-far, 1.0) for far in (1.0, 5.0, 30.0, 36.0, 40.0, 300.0)]
    assert ends == sorted(ends, reverse=True) and ends[-1] > 0.0


def test_what_no_masses_can_do_is_named() -> None:
    q = np.array([[0.0, 0.0], [0.3, 1.0]])
    std = np.full(9, 1e-4)
    leg = np.array([0.1, 0.02, 0.03, 0.4, 0.1, 0.0, 0.0, 0.0, 0.0])
    assert faults(leg2(), leg, std, q) == ()
    assert "gravity acts upwards" in faults(leg2(), leg * np.array([1, 1, 1, -1, -1, 1, 1, 1, 1]), std, q)[0]
    assert "positive definite" in faults(leg2(), leg + 0.05 * (np.arange(9) == 2), std, q)[0]
    assert faults(leg2(), leg - 0.45 * (np.arange(9) == 3), std, q) == ()  # a counterweight
    assert "length of 2.5e+02 m" in faults(leg2(), leg * np.array([1e3, 1e3, 1e3, 1, 1, 1, 1, 1, 1]), std, q)[0]
    unknown = np.where(np.arange(9) == 2, np.inf, std)
    assert faults(leg2(), leg + 0.05 * (np.arange(9) == 2), unknown, q) == ()


def test_a_negated_torque_ends_with_the_remedy_and_no_model(tmp_path: Path, shell: Shell) -> None:
    run = swing_run(viscous=0.05, coulomb=0.1)
    rig, model = tmp_path / "rig.toml", tmp_path / "model.json"
    rig.write_text(SWING_RIG)
    words = ("fit", *written([negated(run, "tau1_nm")], tmp_path), "--rig", rig, "--model-out", model, "--json",
             tmp_path / "fit.json")
    shell(*words, status=1)
    said = shell.err.strip().splitlines()[-1]
    assert "no mechanism's" in said and "tau1_nm looks negated" in said and "[columns.tau1_nm]" in said
    assert not model.exists() and json.loads((tmp_path / "fit.json").read_text())["inadmissible"]
    corrected = '[columns.tau1_nm]\nname = "tau1_nm"\nsign = -1\n'
    rig.write_text(rig.read_text() + corrected)  # as the message says
    shell(*words)
    assert model.exists()


def test_a_level_that_is_all_scatter_is_no_measure_of_the_others() -> None:
    """A joint that never moves: 1e44 +- 9e44, which used to be judged by its own value and passed."""
    beta = np.array([0.1, 0.02, 0.03, 0.4, 0.1, 0.01, 3e43, 0.05, 1e44])
    covariance = np.diag([1e-6] * 5 + [1e-6, (2e44) ** 2, 1e-6, (9e44) ** 2])
    named = {name for c in undetermined(leg2(), beta, covariance, np.ones(9, dtype=bool)) for name, _ in c.amounts}
    assert named == {"beta7", "beta9"}
