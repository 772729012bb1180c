"""Watched runs for a terminal: a line a run."""

from __future__ import annotations

from experiments.documents import Block, WatchDocument, WatchedRun

WATCH_SCHEMA = "legid.watch/1"
MOST_H = 1e6
"""Longer times between false alarms are not told apart."""


def watch_text(found: WatchDocument) -> str:
    """Text after `legid watch`."""
    return "\n".join([*map(line_text, found.watched), watch_summary(found)])


def line_text(one: WatchedRun) -> str:
    """State of one run, the likeliest change, and how often chance alone would give as much."""
    worst = one.worst
    if one.failed:
        return f"{one.run}: not tested: {one.failed}"
    if worst is None:
        return f"{one.run}: not tested: it has no motion"
    text = f"{one.run}: {'ALARM' if one.alarm else one.state}"
    text += f" after {worst.end_s:.1f} s" if one.alarm else ""
    text += f"; {one.seconds:.0f} s; likeliest change {label_of(worst)}, by chance {often(worst.per_hour)}"
    if one.change is not None:
        runs = one.change.sides[1].runs
        return f"{text}\n  {len(runs)} runs since {runs[0]}: {one.change.sentence}"
    return text + ("\n  The next run names the change" if one.alarm else "")


def label_of(block: Block) -> str:
    """The likeliest change and where it is."""
    where = "link" if block.effect == "payload" else "joint"
    return block.effect if block.joint is None else f"{block.effect} ({where} {block.joint})"


def often(per_hour: float) -> str:
    """False alarms per hour of motion in words."""
    if per_hour >= 1.0:
        return f"{per_hour:.0f} times an hour"
    return f"once in {1.0 / per_hour:.3g} h" if per_hour * MOST_H > 1.0 else f"less than once in {MOST_H:.0e} h"


def watch_summary(found: WatchDocument) -> str:
    """Sentence over all runs."""
    tested = [one for one in found.watched if not one.failed]
    alarms = [one.run for one in tested if one.alarm is not None]
    hours = sum(one.seconds for one in tested) / 3600.0
    told = (f"{len(tested)} runs, {hours:.2g} h of motion, at most {found.false_alarms_per_hour:g} false alarms an "
            "hour: ")
    return told + (f"{len(alarms)} with an alarm, first {alarms[0]}" if alarms else "no alarm")
