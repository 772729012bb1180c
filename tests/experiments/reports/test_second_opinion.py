"""What a second estimator says, as the first line, a terminal, the JSON and a page say it."""

from dataclasses import replace

import numpy as np
import pytest

from estimator import FitResult
from estimator.methods import ResultMethod
from estimator.result import HeldOut, SecondOpinion
from experiments.judge import fit_trust
from tests.support.fits import document_of, page_of, synthetic_fit, text_of


def with_opinion(times: float, held_out: HeldOut | None = None, reported: ResultMethod = "mle") -> FitResult:
    """A fit whose beta2 lies so many half widths from another method's; beta9 is not compared."""
    plain = synthetic_fit()
    half = 1.5 * plain.half_width
    apart = np.zeros(plain.mechanism.p)
    apart[1], apart[8] = times, np.nan
    other = plain.beta.copy()
    other[1] += times * np.hypot(half[1], plain.half_width[1])
    method: ResultMethod = "shooting" if reported == "mle" else "mle"
    return replace(plain, method=reported, second_opinion=SecondOpinion(method, other, half, apart, held_out))


def test_estimators_that_agree_take_a_line_and_no_warning() -> None:
    found = with_opinion(1.23)
    assert fit_trust(found).sentence == fit_trust(replace(found, second_opinion=None)).sentence
    assert ("second opinion, by multiple shooting: largest disagreement 1.2 half widths, in beta2; not compared: beta9"
            in text_of(found).splitlines())


@pytest.mark.parametrize(("held_out", "told"), [
    (None, "too little data to let held-out data decide"),
    (HeldOut(0.1, (-0.2, 0.3), 40), "held-out seconds do not decide (shooting's error is 10 % lower [-20, 30])"),
    (HeldOut(-0.5, (-0.7, -0.3), 40), "shooting's error on held-out seconds is 50 % higher [30, 70]")])
def test_the_first_line_says_that_mle_is_contradicted(held_out: HeldOut | None, told: str) -> None:
    trust = fit_trust(with_opinion(4.5, held_out))
    assert trust.level == "bad"
    assert trust.sentence == "DO NOT TRUST the parameters: two estimators disagree."
    assert trust.reasons[0].startswith("Two estimators disagree: beta2 is ")
    assert "4.5 half widths apart" in trust.reasons[0] and told in trust.reasons[0]


def test_the_first_line_says_that_shooting_is_reported() -> None:
    found = with_opinion(36.0, HeldOut(0.6, (0.4, 0.7), 40), "shooting")
    trust = fit_trust(found)
    assert (trust.level, trust.sentence) == ("bad", "DO NOT TRUST the parameters: two estimators disagree.")
    assert trust.reasons[0].startswith("Two estimators disagree: beta2 is ")
    assert "by maximum likelihood, 36.0 half widths apart" in trust.reasons[0]
    assert trust.reasons[0].endswith("shooting is reported, its error on held-out seconds is 60 % lower [40, 70].")


def test_json_and_page_have_both_estimates() -> None:
    found = with_opinion(36.0, HeldOut(0.6, (0.4, 0.7), 40), "shooting")
    document = document_of(found).document
    opinion = document["second_opinion"]
    assert (document["method"], opinion["method"], opinion["reported"]) == ("shooting", "mle", "shooting")
    assert opinion["disagreement"] == 36.0 and opinion["not_compared"] == ["beta9"]
    assert opinion["held_out"] == {"gain": 0.6, "ci95": [0.4, 0.7], "segments": 40}
    row = opinion["parameters"][1]
    assert row["name"] == "beta2" and row["disagreement"] == 36.0 and len(opinion["parameters"]) == 8
    assert found.second_opinion is not None and row["value"] == found.second_opinion.beta[1]
    assert document_of(synthetic_fit()).document["second_opinion"] is None
    page = page_of(found)
    assert "Second opinion" in page and "maximum likelihood" in page
