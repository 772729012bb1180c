"""Whether later runs are predicted as well as left-out reference runs, whatever the list of changes says."""

from dataclasses import replace

import numpy as np
from pytest import approx, raises, skip

from daq import Dataset, load_rig
from estimator import FitError, FitOptions
from estimator.change import Change, LogLevels, detect_change, learn_reference
from estimator.change.free_runs import _without, free_run_errors, larger_error
from estimator.change.scores import fit_reference, score_run
from estimator.change.verdict import AGAINST, with_errors
from estimator.model import leg2
from evidence.blind.records import RECORDS, RIGS
from evidence.what_changed import runs_of, spoilt
from experiments.documents import ChangeDocument
from experiments.reports import change_text
from experiments.session import prepare
from tests.support.mujoco_leg import Leg, multisine, record
from tests.support.paths import REAL


def test_only_a_rise_beyond_the_scatter_of_runs_counts() -> None:
    reference = LogLevels(4, {"q1_rad": (0.0, 0.04), "q2_rad": (0.0, 0.04)})
    risen = larger_error(LogLevels(3, {"q1_rad": (0.1, 0.04), "q2_rad": (1.4, 0.04)}), reference)
    assert (risen.column, risen.ratio) == ("q2_rad", approx(np.exp(1.4)))
    assert risen.p_value < 0.001 and risen.ci95[0] > 2.5
    alike = larger_error(LogLevels(3, {"q1_rad": (0.1, 0.04), "q2_rad": (-0.1, 0.04)}), reference)
    assert alike.p_value > 0.2
    assert larger_error(LogLevels(3, {"q1_rad": (-2.0, 0.04)}), reference) is None
    paired = larger_error(LogLevels(3, {"q2_rad": (1.4, 0.04)}), reference, comparisons=10)
    alone = larger_error(LogLevels(3, {"q2_rad": (1.4, 0.04)}), reference)
    assert paired.p_value == approx(10 * alone.p_value)


def test_free_runs_that_cannot_be_compared_give_a_warning() -> None:
    nothing = LogLevels(3, {})
    with raises(FitError, match="cannot be compared"):
        larger_error(nothing, nothing)
    found = with_errors(Change("no_change", AGAINST.same), lambda: larger_error(nothing, nothing), AGAINST)
    assert found.verdict == "no_change" and "cannot be compared" in found.warnings[0]


def test_no_change_says_how_much_more_free_runs_err() -> None:
    """Three runs against three: an error four times as large need not be significant."""
    rise = larger_error(LogLevels(3, {"q2_rad": (np.log(4.0), 0.6)}), LogLevels(3, {"q2_rad": (0.0, 0.6)}))
    assert rise is not None and rise.p_value > 0.01
    found = with_errors(Change("no_change", AGAINST.same), lambda: rise, AGAINST)
    assert found.verdict == "no_change" and found.free_runs == rise
    assert "Free runs over 1 s err 4 times" in change_text(ChangeDocument.of(found))
    told = ChangeDocument.of(found).free_runs
    assert told.ratio == approx(4.0)
    smaller = with_errors(found, lambda: replace(rise, ratio=2.0, p_value=1.0), AGAINST)
    assert smaller.free_runs == rise


LEG = Leg()
MECHANISM = leg2(lever_arm=LEG.lever)


def swung(seed: int, count: int) -> list[Dataset]:
    rng, time = np.random.default_rng(seed), np.arange(600) / 100.0
    return [record(LEG, rng, seconds=6.0, tau=multisine(rng, time, 1.2), name=f"run{k}") for k in range(count)]


def test_a_reference_without_errors_of_free_runs_is_told_to_the_user() -> None:
    runs = swung(7, 6)
    reference = learn_reference(runs[:4], MECHANISM, FitOptions())
    assert set(reference.errors.levels) == {"q2_rad", "gyro_radps"}
    whole, older = (detect_change(runs[4:], known) for known in
                    (reference, replace(reference, errors=LogLevels(4, {}))))
    assert (whole.verdict, older.verdict) == ("no_change", "no_change")
    assert not whole.warnings and "cannot be compared" in older.warnings[0]


def test_the_fit_without_a_run_is_one_step_away() -> None:
    runs = swung(4, 4)
    fit = fit_reference(runs, MECHANISM, FitOptions(), 1.0)
    scores = [score_run(fit, run) for run in runs]
    left = _without(fit, scores, 0)
    fitted = fit_reference(runs[1:], MECHANISM, FitOptions(), 1.0).model.beta
    p = fit.model.beta.size
    std = np.sqrt(np.diag(scores[0].along(np.eye(scores[0].score.size)[:, :p]).covariance()))
    assert np.abs(left - fit.model.beta).max() > 0.0
    assert (np.abs(left - fitted) < 0.3 * std).all()
    own, others = (free_run_errors(fit, runs[0], beta) for beta in (fit.model.beta, left))
    assert set(own) == set(others) == {"q2_rad", "gyro_radps"} and all(others[name] < 2.0 * own[name] for name in own)


def test_an_error_that_no_listed_change_takes_is_no_change_no_longer() -> None:
    """The motors of a real arm give less than their currents say, by a law that is not the library's."""
    if not (REAL / RECORDS["c0"].folder).exists():
        skip("needs the real records next to the checkout")
    reference = (3, 4, 5, 6)
    every = runs_of("c0")
    test = spoilt([run for k, run in enumerate(every) if k not in reference], "c0", "torque_saturation", 0.76)
    setup = prepare([*(every[k] for k in reference), *test], load_rig(RIGS / RECORDS["c0"].rig)).setup
    known, test = setup.datasets[:len(reference)], list(setup.datasets[len(reference):])
    found = detect_change(test, learn_reference(known, setup.mechanism, setup.options))
    assert found.verdict == "changed_unexplained" and "free runs err" in found.sentence
