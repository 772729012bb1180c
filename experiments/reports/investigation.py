"""An investigation for a terminal and as JSON: what was believed, which experiment followed, what was believed then."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from estimator.diagnosis import Diagnosis
from experiments.documents import contract_joint, split_key
from experiments.judge import Experiment, Investigation, Step

SCHEMA = "legid.investigation/1"
MOST_COMPARED = 6
"""Explanations whose errors a text lists."""


def explanation(keys: Sequence[str]) -> str:
    """Effects of one explanation as a text has them."""
    places = [(effect, contract_joint(effect, joint)) for effect, joint in map(split_key, keys)]
    return " with ".join(effect if joint is None else f"{effect}@{joint}" for effect, joint in places)


def belief_text(found: Diagnosis | None) -> str:
    """Verdict, rivals and their errors on held-out runs; one line."""
    if found is None:
        return "no diagnosis yet"
    causes = ", ".join(dict.fromkeys(explanation([c.effect if c.joint is None else f"{c.effect}@{c.joint}"])
                                     for c in found.causes))
    text = found.verdict + (f" ({causes})" if causes else "")
    errors = "; ".join(f"{explanation(keys)} {error:.2f}" for keys, error in found.compared[:MOST_COMPARED])
    if found.error is not None:
        text += f"; held-out error in units of noise alone: nominal model {found.error[0]:.2f}"
        text += f"; {errors}" if errors else ""
    return text


def experiment_text(one: Experiment) -> str:
    """One line."""
    text = f"{one.run}: {one.kind}, {one.seconds:.0f} s, at most {one.peak_nm:.3g} N m"
    if one.expected:
        text += "; expected log likelihood ratio " + ", ".join(f"{pair}: {value:.3g}" for pair, value in one.expected)
    return text + (f"; ended early: {one.ended}" if one.ended else "")


def step_text(step: Step) -> str:
    """Why, what was recorded, and what is believed after it."""
    lines = list(dict.fromkeys(one.why for one in step.experiments))
    lines += [f"  {experiment_text(one)}" for one in step.experiments]
    after = "not diagnosed" if step.found is None else belief_text(step.found)
    return "\n".join([*lines, f"  after {step.wall_s / 60.0:.1f} min: {after}"])


def investigation_text(done: Investigation) -> str:
    """The answer, the reason for the end, and the next step."""
    answer = "No diagnosis." if done.found is None else f"{done.found.verdict}: {done.found.sentence}"
    return "\n".join([answer, f"{done.why} {len(done.runs)} runs in {done.wall_s / 60.0:.1f} min.",
                      f"Next step: {done.next_step}"])


def investigation_document(done: Investigation) -> dict[str, Any]:
    """`legid.investigation/1`; see docs/formats.md."""
    beliefs = [step.found for step in done.steps]
    before = [None, *beliefs[:-1]]
    return {
        "schema": SCHEMA, "ending": done.ending, "why": done.why, "next_step": done.next_step,
        "answer": _belief(done.found), "diagnosed": list(done.diagnosed), "budget_s": done.budget_s,
        "wall_s": done.wall_s,
        "steps": [{"before": _belief(earlier), "after": _belief(step.found), "wall_s": step.wall_s,
                   "experiments": [{
                       "run": one.run, "kind": one.kind, "why": one.why, "seconds": one.seconds,
                       "peak_nm": one.peak_nm, "ended": one.ended or None,
                       "expected": [{"pair": pair, "log_likelihood_ratio": value} for pair, value in one.expected]}
                       for one in step.experiments]}
                  for earlier, step in zip(before, done.steps)]}


def _belief(found: Diagnosis | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {"verdict": found.verdict, "sentence": found.sentence,
            "causes": [{"effect": c.effect, "joint": contract_joint(c.effect, c.joint)} for c in found.causes],
            "error": None if found.error is None else {"before": found.error[0], "after": found.error[1]},
            "compared": [{"explanation": explanation(keys), "error": error if np.isfinite(error) else None}
                         for keys, error in found.compared]}
