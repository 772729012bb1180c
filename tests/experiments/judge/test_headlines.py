"""No two lines of one result disagree: every combination of findings is generated, and its lines are read."""

import re
from collections.abc import Iterator
from dataclasses import replace
from itertools import cycle, product

import numpy as np
import pytest
from msgspec import structs

from estimator import Combination, Finding, FitResult, Method, RunAgreement, Use
from estimator.result import Budget, BudgetPart, OmittedEffect
from experiments.documents import FitDocument
from experiments.judge import Headline, Trust, all_uses, fit_trust, with_fit_trust
from experiments.judge.headline import counted
from experiments.models import TrustValues
from experiments.reports import fit_sections, whole_fit_text
from experiments.reports.html import render_page
from tests.support.fits import document_of, synthetic_fit, with_slow_gyro

PLAIN = synthetic_fit()
METHODS: tuple[Method, ...] = ("mle", "wls")
NOISE = Finding("warning", "noise_share", "40 % of the torque's spread counts as noise")
RIG = Finding("doubt", "rig_contradiction", "the rig file contradicts a run: r was recorded with x = 1")
AGAINST = {
    r"TRUST the parameters within":
        r"missing something|are too narrow|is not known|model lacks|[Nn]ot to be|do not determine",
    r"DO NOT TRUST": r"is known to|(?<!NOT )TRUST",
    r"^NOT TO BE USED": r"is known to|TRUST|good for",
    r"do not determine": r"good for|determines every|TRUST the parameters within",
    r"too little to widen": r"disagree about|allow for",
    r"disagree about": r"too little to widen|agree within",
    r"on held-out data": r"NOT TO BE USED|NOT TESTED",
}
"""What a line says -> what no other line of the same result may say."""


def agreement(kind: str) -> RunAgreement | None:
    """Of three runs: none asked, in agreement, in disagreement too small to widen an interval, or about beta9."""
    p, std = PLAIN.mechanism.p, PLAIN.std
    if kind == "none":
        return None
    if kind == "agree":
        return RunAgreement(("a", "b", "c"), 0.3, std)
    quantile, seen = np.full(p, 1.959964), np.zeros(p, dtype=bool)
    if kind == "beta9":
        quantile[8], seen[8] = 4.303, True
    by_run = np.tile(PLAIN.beta, (3, 1))
    return RunAgreement(("a", "b", "c"), 1e-5, std, True, quantile, by_run.mean(axis=0), 0.02 * std, by_run, seen)


def fits() -> Iterator[FitResult]:
    """One for every combination of what a fit may find."""
    path, = PLAIN.trajectories
    slow = with_slow_gyro(path)
    rough = replace(path, tau_measured=path.tau_measured + 0.3 * np.random.default_rng(2).normal(size=path.tau.shape))
    parts = (BudgetPart("noise", np.diag(PLAIN.std)), BudgetPart("torque_gain", 0.02 * PLAIN.beta[None, :], (0.02,)))
    budget = Budget(parts, np.zeros(PLAIN.mechanism.p), {})
    one = (Combination((("beta3", 1.0), ("beta8", -0.5))),)
    uses = cycle([(), (Use("simulation", True, 0.031, horizon_s=19.97, ci95=(0.02, 0.05)),
                       Use("feedforward", False, 0.2, ci95=(0.1, 0.4))),
                  (Use("feedforward", True, 0.05, ci95=(0.04, 0.06)), Use("simulation", False, 0.2, horizon_s=1.0)),
                  (Use("simulation", False, 0.4, horizon_s=1.0, ci95=(0.2, 0.8)),),
                  (Use("simulation", True, 0.02, horizon_s=1.0, ci95=(0.01, 0.04)),
                   Use("feedforward", True, 0.05, ci95=(0.04, 0.06)))])
    for agree, motion, open_, known, told, omitted, method in product(
            ("none", "agree", "little", "beta9"), (path, slow, rough), ((), one), (None, budget),
            ((), (NOISE,), (RIG,), (Finding("fault", "columns", "the columns cannot be right"),)),
            ((), (OmittedEffect("gyro_scale", 1e-20, "beta1", 5.8),)), METHODS):
        yield replace(PLAIN, agreement=agreement(agree), trajectories=(motion,), undetermined=open_, budget=known,
                      findings=told, omitted=omitted, method=method, converged=True,
                      uses=next(uses) if method == "mle" else ())
    yield replace(PLAIN, converged=False)


def lines_of(fit: FitDocument) -> list[str]:
    """What text and page of a fit say in sentences."""
    quick = structs.replace(fit, budget=None)  # whose figure takes a second
    page = [line for section in fit_sections(quick, None) for line in (*section.paragraphs, *section.notes)]
    texts = [line.removesuffix(".") for line in (*whole_fit_text(fit).splitlines(), *fit.headline.told, *page)]
    return [line for line in dict.fromkeys(texts) if line]


def test_no_two_lines_of_a_fit_disagree() -> None:
    results = list(fits())
    assert len(results) == 769
    for result in results:
        lines = lines_of(document_of(result))
        for said, never in AGAINST.items():
            for line in filter(re.compile(said).search, lines):
                wrong = [other for other in lines if other != line and re.search(never, other)]
                assert not wrong, f"{line!r} and {wrong[0]!r}"
        head = fit_trust(result).headline
        assert sum(bool(re.search(r"(TRUST|NOT TO BE|NOT TESTED)", line)) for line in head.told) == 1
        best = next((use for use in all_uses(result) if use.supported and use.measured_on == "held_out"), None)
        assert best is None or RIG not in result.findings
        assert ("held-out" in head.title) <= (best is not None)
        assert ("DO NOT" in head.title) <= (head.level == ("caution" if best is not None else "bad"))
        assert head.action and not [line for line in head.reasons if "legid " in line]
        assert len(head.title) <= 120


@pytest.mark.parametrize(("sentence", "level", "told"), [
    ("TRUST for simulation over 15 s: fit 97 % at worst.", "good",
     "TRUST for simulation over 15 s, not the parameters: fit 97 % at worst."),
    ("TRUST for predictions of 1 s, not for simulation over 10 s.", "caution",
     "TRUST for predictions of 1 s, not for simulation over 10 s.")])
def test_a_validation_has_one_answer_where_the_fit_was_not_trusted(sentence: str, level: str, told: str) -> None:
    """"DO NOT TRUST the parameters, as their fit said. Free runs: TRUST for simulation over 15 s"."""
    found = with_fit_trust(Trust(level, sentence), TrustValues(level="bad", reasons=(), sentence=(  # type: ignore[arg-type]
        "DO NOT TRUST the parameters: two estimators disagree.")))
    assert found.sentence == told and found.level == "caution"
    assert not [line for line in found.reasons if "TRUST" in line]


def test_a_warning_of_several_runs_stands_once() -> None:
    alike = [f"r{k}.csv tau2_nm stands at exactly +-1.2 N m in {k + 9.4} % of the samples" for k in range(1, 9)]
    other = "r1.csv q2_rad stands at exactly +-1.2 N m in 9.4 % of the samples"
    told = counted([*alike, other, other])
    assert told == [f"{alike[0]}. Likewise in 7 more: {', '.join(f'r{k}.csv' for k in range(2, 9))}", other]


def test_a_head_has_two_lines_below_its_title_and_then_the_next_step() -> None:
    head = Headline("bad", "DO NOT TRUST", [f"reason {k}" for k in range(9)], ["w"], "Look: legid diagnose r.csv")
    page = render_page("t", "s", [], verdict=head)
    box = page[page.index('<div class="verdict"'):page.index("<main>")]
    shown, folded = box.split("<details>")
    assert "reason 1" in shown and "reason 2" not in shown and shown.index("reason 1") < shown.index("Next step: Look")
    assert "<code>legid diagnose r.csv</code>" in shown and "reason 8" in folded and "Warning: w" in folded
