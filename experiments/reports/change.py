"""A change of a rig for a terminal, and as JSON."""

from __future__ import annotations

from math import isfinite
from typing import Any

from estimator.change import Change, ChangedCause, Detectable
from experiments.console import text_table

SHOWN = 12
"""Smallest changes that a terminal shows; the JSON has all."""


def change_text(found: Change) -> str:
    """Text after `legid diagnose --against`: the verdict first."""
    blocks = [found.sentence]
    if found.causes:
        rows = [[_label(c) if not k else "", s.name, f"{s.value:.4g}", f"{s.ci95[0]:.4g} .. {s.ci95[1]:.4g}", s.unit]
                for c in found.causes for k, s in enumerate(c.size)]
        blocks.append("Change from the reference runs to these runs:\n" + text_table(
            ["effect", "size", "value", "95 % interval", "unit"], rows, {2, 3}))
    if found.held_out is not None:
        better = sum(g > 0.0 for g in found.held_out.gain)
        blocks.append(f"Fitted to the other runs, the change predicts {better} of {len(found.held_out.gain)} runs "
                      "better than the unchanged reference.")
    if found.detectable:
        rows = [[_label(d), d.name, f"{d.size:.2g}" if isfinite(d.size) else "none", d.unit]
                for d in found.detectable[:SHOWN]]
        blocks.append("Smallest change that these runs would have shown with 80 % probability (the likeliest "
                      f"{len(rows)} of {len(found.detectable)}):\n" + text_table(
                          ["effect", "size", "smallest change", "unit"], rows, {2}))
        blocks.append("Unexplained structure of the reference runs, in standard deviations of a size estimated from "
                      "one run: {:.2g} common to all runs, {:.2g} different in each run.".format(*found.structure))
    blocks += [f"warning: {text}" for text in found.warnings]
    blocks.append(f"Runs: {', '.join((*found.reference, *found.test))}. ({found.wall_s:.0f} s)")
    return "\n\n".join(blocks)


def change_document(found: Change) -> dict[str, Any]:
    """`legid.diagnosis/1` with the key `against`; see docs/formats.md."""
    held = found.held_out
    return {
        "schema": "legid.diagnosis/1", "verdict": found.verdict, "sentence": found.sentence,
        "causes": [{"effect": c.effect, "joint": c.joint, "meaning": c.sentence, "p_value": c.p_value,
                    "size": [{"name": s.name, "unit": s.unit, "value": s.value, "ci95": list(s.ci95)} for s in c.size],
                    "confusable_with": []} for c in found.causes],
        "candidates": [{"effect": d.effect, "joint": d.joint, "size_name": d.name, "p_value": d.p_value,
                        "smallest_detectable": d.size if isfinite(d.size) else None, "unit": d.unit}
                       for d in found.detectable],
        "against": {"runs": list(found.reference), "structure": list(found.structure), "p_any": found.p_any},
        "held_out": None if held is None else {"runs": list(held.runs), "gain": list(held.gain)},
        "not_testable": [{"effect": e.partition("@")[0], "joint": int(e.partition("@")[2]) if "@" in e else None,
                          "why": why} for e, why in found.not_testable],
        "runs": {"test": list(found.test)}, "warnings": list(found.warnings), "wall_s": found.wall_s}


def _label(one: ChangedCause | Detectable) -> str:
    where = "link" if one.effect == "payload" else "joint"
    return one.effect if one.joint is None else f"{one.effect}, {where} {one.joint}"
