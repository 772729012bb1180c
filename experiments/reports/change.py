"""A change of a rig, or the differences of sessions, for a terminal."""

from __future__ import annotations

from experiments.console import text_table
from experiments.documents import Answer, Candidate, Cause, Differing, SessionsDocument, finite
from experiments.judge import Files, with_names

CAUSE_HEADER = ["effect", "a change of", "size", "value", "95 % interval", "unit"]
DETECTABLE_HEADER = ["effect", "size", "smallest change", "unit"]
SHOWN = 12
"""Smallest changes that a terminal shows; the JSON has all."""


def change_text(found: Differing, files: Files | None = None) -> str:
    """Text after `legid diagnose --against` and `legid compare`: the verdict first. The next step names `files`."""
    blocks = [found.sentence]
    first, second = found.sides
    if found.causes:
        blocks.append(f"From {first.name} to {second.name}:\n" + text_table(CAUSE_HEADER, cause_rows(found), {3, 4}))
    blocks += held_out_text(found)
    blocks += free_runs_text(found)
    if found.candidates:
        rows = detectable_rows(found)[:SHOWN]
        blocks.append("Smallest change that these runs would have shown with 80 % probability (the likeliest "
                      f"{len(rows)} of {len(found.candidates)}):\n" + text_table(DETECTABLE_HEADER, rows, {2}))
        blocks.append(structure_text(found))
    blocks.append(f"Next step: {with_names(found.next_step, files)}")
    blocks += [f"warning: {text}" for text in found.warnings]
    blocks.append(f"Runs: {', '.join((*first.runs, *second.runs))}. ({found.wall_s:.0f} s)")
    return "\n\n".join(blocks)


def sessions_text(found: SessionsDocument) -> str:
    """Text of a single pair; of several pairs a table with one row a pair."""
    if len(found.pairs) == 1:
        return change_text(found.pairs[0])
    return text_table(["from", "to", "verdict", "difference"],
                      [[pair.a.name, pair.b.name, pair.verdict, pair.sentence] for pair in found.pairs], set())


def cause_rows(found: Answer) -> list[list[str]]:
    """One row a size of a cause."""
    return [[label(c) if not k else "", c.kind if not k else "", s.name, f"{s.value:.4g}",
             " .. ".join(f"{finite(x):.4g}" for x in s.ci95), s.unit] for c in found.causes
            for k, s in enumerate(c.size)]


def detectable_rows(found: Answer) -> list[list[str]]:
    """One row an effect, the likeliest first."""
    return [[label(d), d.size_name, "none" if d.smallest_detectable is None else f"{d.smallest_detectable:.2g}", d.unit]
            for d in found.candidates]


def held_out_text(found: Answer) -> list[str]:
    """Sentence on how well the change predicts runs that it was not fitted to."""
    if found.held_out is None:
        return []
    gains = found.held_out.gain
    better = sum(finite(gain) > 0.0 for gain in gains)
    return [f"Fitted to the other runs, the change predicts {better} of {len(gains)} runs better than no change."]


def free_runs_text(found: Answer) -> list[str]:
    """Sentence on how much more free runs err than left-out runs of the other session, where no change is found."""
    rise = found.free_runs
    if rise is None or found.verdict != "no_change":
        return []
    low, high = map(finite, rise.ci95)
    return [f"Free runs over 1 s err {rise.ratio:.2g} times [{low:.2g}, {high:.2g}] as much in {rise.column} as those "
            f"of left-out runs of the other session (p = {rise.p_value:.2g})."]


def structure_text(found: Differing) -> str:
    """Sentence on the part of the runs that no law explains."""
    return ("Unexplained structure within a session, in standard deviations of a size estimated from one run: {:.2g} "
            "common to its runs, {:.2g} different in each run, drifts aside.".format(*found.structure))


def label(one: Cause | Candidate) -> str:
    """The effect and where it is."""
    where = "link" if one.effect == "payload" else "joint"
    return one.effect if one.joint is None else f"{one.effect}, {where} {one.joint}"
