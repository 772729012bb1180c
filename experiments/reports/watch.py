"""Watched runs for a terminal and as JSON: a line a run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from estimator.change import Block
from experiments.judge import Watched
from experiments.reports.change import change_document
from experiments.reports.origin import Source

WATCH_SCHEMA = "legid.watch/1"
MOST_H = 1e6
"""Longer times between false alarms are not told apart."""


def line_text(one: Watched) -> str:
    """State of one run, the likeliest change, and how often chance alone would give as much."""
    found, worst = one.found, one.found.alarm or one.found.worst
    if found.failed:
        return f"{found.run}: not tested: {found.failed}"
    if worst is None:
        return f"{found.run}: not tested: it has no motion"
    text = f"{found.run}: {'ALARM' if found.alarm else one.state}"
    text += f" after {worst.end_s:.1f} s" if found.alarm else ""
    text += f"; {found.seconds:.0f} s; likeliest change {label_of(worst)}, by chance {often(worst.per_hour)}"
    if one.change is not None:
        count = len(one.change.test)
        return f"{text}\n  {count} runs since {one.change.test[0]}: {one.change.sentence}"
    return text + ("\n  The next run names the change" if found.alarm else "")


def label_of(block: Block) -> str:
    """The likeliest change and where it is."""
    where = "link" if block.effect == "payload" else "joint"
    return block.effect if block.joint is None else f"{block.effect} ({where} {block.joint})"


def often(per_hour: float) -> str:
    """False alarms per hour of motion in words."""
    if per_hour >= 1.0:
        return f"{per_hour:.0f} times an hour"
    return f"once in {1.0 / per_hour:.3g} h" if per_hour * MOST_H > 1.0 else f"less than once in {MOST_H:.0e} h"


def watch_summary(lines: Sequence[Watched], false_alarms: float) -> str:
    """Sentence over all runs."""
    tested = [one for one in lines if not one.found.failed]
    alarms = [one.found.run for one in tested if one.found.alarm is not None]
    hours = sum(one.found.seconds for one in tested) / 3600.0
    told = f"{len(tested)} runs, {hours:.2g} h of motion, at most {false_alarms:g} false alarms an hour: "
    return told + (f"{len(alarms)} with an alarm, first {alarms[0]}" if alarms else "no alarm")


def watch_document(lines: Sequence[Watched], false_alarms: float, reference: Sequence[str],
                   sources: Sequence[Source] = ()) -> dict[str, Any]:
    """`legid.watch/1`; see docs/formats.md."""
    return {"schema": WATCH_SCHEMA, "false_alarms_per_hour": false_alarms,
            "reference": {"runs": list(reference), "sources": [{"file": s.file, "sha256": s.sha256} for s in sources]},
            "watched": [{"run": one.found.run, "state": one.state,
                         "recorded": None if one.recorded is None else one.recorded.isoformat(),
                         "seconds": one.found.seconds,
                         "alarm": None if one.found.alarm is None else _block(one.found.alarm),
                         "blocks": [_block(b) for b in one.found.blocks], "failed": one.found.failed or None,
                         "change": None if one.change is None else change_document(one.change)} for one in lines]}


def _block(b: Block) -> dict[str, Any]:
    return {"end_s": b.end_s, "seconds": b.seconds, "per_hour": b.per_hour, "effect": b.effect, "joint": b.joint,
            "since_s": b.since_s}
