"""A change of a rig, or the difference of two sessions, for a terminal and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Any

from estimator.change import Change, ChangedCause, Detectable, HeldOut, Kind, LevelChange
from experiments.console import text_table
from experiments.judge import Files, with_names
from experiments.reports.origin import Source
from experiments.session import SetAside

CAUSE_HEADER = ["effect", "a change of", "size", "value", "95 % interval", "unit"]
DETECTABLE_HEADER = ["effect", "size", "smallest change", "unit"]
REFERENCE_NAMES = ("the reference runs", "these runs")
Pair = tuple[tuple[str, str], Change]
"""Names of two sessions, and what differs."""
SHOWN = 12
"""Smallest changes that a terminal shows; the JSON has all."""


def change_text(found: Change, names: tuple[str, str] = REFERENCE_NAMES, files: Files | None = None) -> str:
    """Text after `legid diagnose --against` and `legid compare`: the verdict first. `names`: those of the sessions;
    the next step names `files`."""
    blocks = [found.sentence]
    if found.causes:
        blocks.append(f"From {names[0]} to {names[1]}:\n" + text_table(CAUSE_HEADER, cause_rows(found), {3, 4}))
    if found.held_out is not None:
        blocks.append(held_out_text(found.held_out))
    blocks += free_runs_text(found)
    if found.detectable:
        rows = detectable_rows(found)[:SHOWN]
        blocks.append("Smallest change that these runs would have shown with 80 % probability (the likeliest "
                      f"{len(rows)} of {len(found.detectable)}):\n" + text_table(DETECTABLE_HEADER, rows, {2}))
        blocks.append(structure_text(found))
    blocks.append(f"Next step: {with_names(next_of_change(found), files)}")
    blocks += [f"warning: {text}" for text in found.warnings]
    blocks.append(f"Runs: {', '.join((*found.reference, *found.test))}. ({found.wall_s:.0f} s)")
    return "\n\n".join(blocks)


def cause_rows(found: Change) -> list[list[str]]:
    """One row a size of a cause."""
    return [[label(c) if not k else "", c.kind if not k else "", s.name, f"{s.value:.4g}",
             f"{s.ci95[0]:.4g} .. {s.ci95[1]:.4g}", s.unit] for c in found.causes for k, s in enumerate(c.size)]


def detectable_rows(found: Change) -> list[list[str]]:
    """One row an effect, the likeliest first."""
    return [[label(d), d.name, f"{d.size:.2g}" if isfinite(d.size) else "none", d.unit] for d in found.detectable]


def held_out_text(held: HeldOut) -> str:
    """Sentence on how well the change predicts runs that it was not fitted to."""
    better = sum(g > 0.0 for g in held.gain)
    return f"Fitted to the other runs, the change predicts {better} of {len(held.gain)} runs better than no change."


def free_runs_text(found: Change) -> list[str]:
    """Sentence on how much more free runs err than left-out runs of the other session, where no change is found."""
    rise = found.free_runs
    if rise is None or found.verdict != "no_change":
        return []
    low, high = rise.ci95
    return [f"Free runs over 1 s err {rise.ratio:.2g} times [{low:.2g}, {high:.2g}] as much in {rise.column} as those "
            f"of left-out runs of the other session (p = {rise.p_value:.2g})."]


def structure_text(found: Change) -> str:
    """Sentence on the part of the runs that no law explains."""
    return ("Unexplained structure within a session, in standard deviations of a size estimated from one run: {:.2g} "
            "common to its runs, {:.2g} different in each run, drifts aside.".format(*found.structure))


def change_document(found: Change, set_aside: Sequence[SetAside] = (), sources: Sequence[Source] = ()
                    ) -> dict[str, Any]:
    """`legid.diagnosis/1` with the key `against`, which has the `sources` of the reference; see docs/formats.md."""
    return {"schema": "legid.diagnosis/1", **_answer(found),
            "against": {"runs": list(found.reference), "structure": list(found.structure), "p_any": found.p_any,
                        "sources": [{"file": s.file, "sha256": s.sha256} for s in sources]},
            "runs": {"test": list(found.test)}, "warnings": list(found.warnings), "next_step": next_of_change(found),
            "set_aside": [run.document for run in set_aside], "wall_s": found.wall_s}


def sessions_document(pairs: Sequence[Pair], set_aside: Sequence[SetAside] = ()) -> dict[str, Any]:
    """`legid.sessions/1` of (names of A and B, what differs); see docs/formats.md."""
    return {"schema": "legid.sessions/1", "set_aside": [run.document for run in dict.fromkeys(set_aside)], "pairs": [
        {"a": {"name": a, "runs": list(found.reference)}, "b": {"name": b, "runs": list(found.test)}, **_answer(found),
         "structure": list(found.structure), "p_any": found.p_any, "warnings": list(found.warnings),
         "next_step": next_of_change(found)} for (a, b), found in pairs]}


def sessions_text(pairs: Sequence[Pair]) -> str:
    """Text of a single pair; of several pairs a table with one row a pair."""
    if len(pairs) == 1:
        return change_text(pairs[0][1], pairs[0][0])
    return text_table(["from", "to", "verdict", "difference"],
                      [[a, b, found.verdict, found.sentence] for (a, b), found in pairs], set())


def _answer(found: Change) -> dict[str, Any]:
    held = found.held_out
    return {
        "verdict": found.verdict, "sentence": found.sentence,
        "causes": [{"effect": c.effect, "kind": c.kind, "joint": c.joint, "meaning": c.sentence, "p_value": c.p_value,
                    "size": [{"name": s.name, "unit": s.unit, "value": s.value, "ci95": list(s.ci95)} for s in c.size],
                    "confusable_with": []} for c in found.causes],
        "candidates": [{"effect": d.effect, "joint": d.joint, "size_name": d.name, "p_value": d.p_value,
                        "change": d.change, "ci95": list(d.ci95) if isfinite(d.size) else None,
                        "smallest_detectable": d.size if isfinite(d.size) else None, "unit": d.unit}
                       for d in found.detectable],
        "noise": [_level(n) for n in found.noise],
        "free_runs": None if found.free_runs is None else _level(found.free_runs),
        "held_out": None if held is None else {"runs": list(held.runs), "gain": list(held.gain)},
        "not_testable": [{"effect": e.partition("@")[0], "joint": int(e.partition("@")[2]) if "@" in e else None,
                          "why": why} for e, why in found.not_testable]}


def _level(one: LevelChange) -> dict[str, Any]:
    return {"column": one.column, "ratio": one.ratio, "ci95": list(one.ci95), "p_value": one.p_value}


FIT = "legid fit RUN... --rig RIG --model-out MODEL.json"
ACTIONS: dict[Kind, str] = {
    "parameters": f"Fit the model to the new runs: {FIT}",
    "mechanics": f"Inspect the joint. Then fit the model to the new runs: {FIT}",
    "sensors": "Check that sensor: legid doctor --rig RIG", "timing": "Check both clocks: legid doctor --rig RIG",
    "environment": "Check how the stand is fixed", "noise": "Check the cable of that sensor: legid doctor --rig RIG"}


def next_of_change(found: Change) -> str:
    """One line: what to do, and the command."""
    if found.verdict == "fit_failed":
        return "Look at each run alone: legid fit RUN... --rig RIG --each"
    if found.verdict == "no_change":
        return "Go on with the model that you have; more or longer runs show smaller changes"
    if found.verdict == "changed_unexplained":
        return "Diagnose the new runs without the reference: legid diagnose RUN... --rig RIG --html PAGE"
    if found.verdict == "one_of":
        return ("Record what tells the causes apart: legid excite --rig RIG --model MODEL.json --separate "
                "DIAGNOSIS.json --out PLAN")
    return ACTIONS[found.causes[0].kind]


def label(one: ChangedCause | Detectable) -> str:
    """The effect and where it is."""
    where = "link" if one.effect == "payload" else "joint"
    return one.effect if one.joint is None else f"{one.effect}, {where} {one.joint}"
