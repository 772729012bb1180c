"""What runs disagree about, as a terminal, a page, the JSON and the first line say it."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimator import FitResult, RunAgreement
from experiments.judge import fit_trust
from tests.support.fits import document_of, page_of, synthetic_fit, text_of

RUNS = ("a.csv", "b.csv", "c.csv")


def with_runs(**more: Any) -> FitResult:
    plain = synthetic_fit()
    return replace(plain, agreement=RunAgreement(**{"runs": RUNS, "p_value": 0.3, "own_std": plain.std, **more}))


@pytest.fixture
def disputed() -> FitResult:
    """The knee's Coulomb level is another in the third run."""
    plain = synthetic_fit()
    by_run = np.tile(plain.beta, (3, 1))
    by_run[:, 8] = 0.10, 0.11, 0.14
    seen = np.arange(plain.mechanism.p) == 8
    return with_runs(p_value=2e-5, disagree=True, quantile=np.where(seen, 4.303, 1.959964), mean=by_run.mean(axis=0),
                     scatter=np.where(seen, 0.021, 1e-6), by_run=by_run, seen=seen)


def test_one_line_about_all_and_one_for_each_parameter(disputed: FitResult) -> None:
    text = text_of(disputed)
    assert ("3 runs disagree by more than their noise (p = 2e-05): intervals allow for it, 2.2 times as wide as by "
            "noise alone\nruns disagree about beta9 (Coulomb friction, knee): 0.100 .. 0.140, scatter 0.021 about "
            "0.117; interval widened 2.2 times") in text
    low, high = disputed.ci95()[8]
    assert high - low == pytest.approx(2 * 4.303 * disputed.std[8])


def test_runs_that_agree_and_one_alone_say_so() -> None:
    assert "3 runs agree within their noise (p = 0.3)" in text_of(with_runs())
    assert "one run gives no scatter between runs" in text_of(with_runs(p_value=None, runs=RUNS[:1]))
    assert "runs" not in text_of(synthetic_fit()).replace("ran ", "")


def test_the_json_says_what_each_run_says(disputed: FitResult) -> None:
    found = document_of(disputed).document["agreement"]
    assert found["runs"] == list(RUNS) and found["disagree"] and found["p_value"] == 2e-5
    knee = found["parameters"][8]
    assert knee["name"] == "beta9" and knee["by_run"] == [0.10, 0.11, 0.14] and knee["seen"]
    assert knee["widened"] == pytest.approx(4.303 / 1.959964)
    given = replace(disputed, fixed={"beta9": 0.1})
    assert "beta9" not in [p["name"] for p in document_of(given).document["agreement"]["parameters"]]
    assert document_of(with_runs()).document["agreement"]["parameters"] == []
    assert document_of(synthetic_fit()).document["agreement"] is None


def test_the_page_has_a_column_for_each_run(disputed: FitResult) -> None:
    page = page_of(disputed)
    assert "Do the runs agree?" in page and all(run in page for run in RUNS)
    assert "Do the runs agree?" not in page_of(synthetic_fit())


def test_the_first_line_is_careful_where_runs_disagree(disputed: FitResult) -> None:
    assert fit_trust(with_runs()).level == "good"
    trust = fit_trust(disputed)
    assert trust.level == "good" and "Runs disagree about beta9; the intervals allow for it." in trust.reasons
