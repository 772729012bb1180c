"""Prior knowledge of a fit, and the next value to measure, as text and as a section of a page."""

from __future__ import annotations

from experiments.documents import FitDocument
from experiments.judge import number
from experiments.reports.html import Section, Table


def prior_sentence(fit: FitDocument) -> str:
    """Sentence on the prior of a fit; empty without one."""
    if not fit.prior:
        return ""
    names = ", ".join(f"{one.name} = {one.value:.4g} +- {one.std:.2g}" for one in fit.prior)
    return f"Maximum a posteriori: the fit used what [prior] says ({names}), together with the runs."


def prior_table(fit: FitDocument) -> Table:
    """One row a known value."""
    return Table(["known before", "value", "std", "after the fit", "std after"], [
        [one.name, number(one.value, one.std), number(one.std, one.std), number(one.fitted, one.fitted_std),
         number(one.fitted_std, one.fitted_std)] for one in fit.prior], range(1, 5))


def knowledge_section(fit: FitDocument) -> Section:
    """Section on the prior and the next value to measure; empty without either."""
    advice = "" if fit.measure_next is None else fit.measure_next.text
    return Section("What was known before, and what to measure next", [*filter(None, [prior_sentence(fit), advice])],
                   [prior_table(fit)] if fit.prior else [])
