"""An investigation for a terminal: what was believed, which experiment followed, what was believed then."""

from __future__ import annotations

from math import inf

from experiments.documents import Belief, Experiment, InvestigationDocument, Step, finite

MOST_COMPARED = 6
"""Explanations whose errors a text lists."""


def belief_text(found: Belief | None) -> str:
    """Verdict, rivals and their errors on held-out runs; one line."""
    if found is None:
        return "no diagnosis yet"
    causes = ", ".join(dict.fromkeys(c.effect if c.joint is None else f"{c.effect}@{c.joint}" for c in found.causes))
    text = found.verdict + (f" ({causes})" if causes else "")
    errors = "; ".join(f"{one.explanation} {inf if one.error is None else one.error:.2f}"
                       for one in found.compared[:MOST_COMPARED])
    if found.error is not None:
        text += f"; held-out error in units of noise alone: nominal model {finite(found.error.before):.2f}"
        text += f"; {errors}" if errors else ""
    return text


def expected_text(one: Experiment) -> str:
    """Pairs of rivals, each with the log likelihood ratio that is expected between them."""
    return ", ".join(f"{e.pair}: {finite(e.log_likelihood_ratio):.3g}" for e in one.expected)


def experiment_text(one: Experiment) -> str:
    """One line."""
    text = f"{one.run}: {one.kind}, {one.seconds:.0f} s, at most {one.peak_nm:.3g} N m"
    if one.expected:
        text += f"; expected log likelihood ratio {expected_text(one)}"
    return text + (f"; ended early: {one.ended}" if one.ended else "")


def step_text(step: Step) -> str:
    """Why, what was recorded, and what is believed after it."""
    lines = list(dict.fromkeys(one.why for one in step.experiments))
    lines += [f"  {experiment_text(one)}" for one in step.experiments]
    after = "not diagnosed" if step.after is None else belief_text(step.after)
    return "\n".join([*lines, f"  after {step.wall_s / 60.0:.1f} min: {after}"])


def investigation_text(done: InvestigationDocument) -> str:
    """The answer, the reason for the end, and the next step."""
    answer = "No diagnosis." if done.answer is None else f"{done.answer.verdict}: {done.answer.sentence}"
    return "\n".join([answer, f"{done.why} {len(done.runs)} runs in {done.wall_s / 60.0:.1f} min.",
                      f"Next step: {done.next_step}"])
