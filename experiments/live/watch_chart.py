"""The chart over weeks: what `legid watch` says of every run, over the day on which it was recorded."""

from __future__ import annotations

import html
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from math import log10
from pathlib import Path
from typing import NamedTuple

import msgspec
from msgspec import Struct

from daq import InputError, read_bytes

MOST_BYTES = 1 << 26
"""Of a document of `legid watch`."""
LEAST, MOST = 1e-9, 1e4
"""Ends of the axis [false alarms per hour]."""
WIDE, HIGH, LEFT, RIGHT, TOP, BOTTOM = 560, 240, 52, 14, 14, 50
"""Of the drawing and its margins [px]."""
APART = 92
"""Dates on the axis are at least so far apart [px]."""


class _Block(Struct):
    per_hour: float
    effect: str = ""
    joint: int | None = None


class _Tested(Struct):
    run: str
    state: str
    blocks: tuple[_Block, ...] = ()
    recorded: datetime | None = None


class _Watch(Struct, tag_field="schema", tag="legid.watch/1"):
    false_alarms_per_hour: float
    watched: tuple[_Tested, ...] = ()


class Mark(NamedTuple):
    """One run in the chart."""

    run: str
    recorded: datetime
    per_hour: float
    """False alarms per hour of a threshold that the run just reaches."""
    threshold: float
    """[false alarms per hour]"""
    state: str
    """ok, alarm or changed, as `legid watch` says it."""
    change: str
    """The likeliest change."""


def read_marks(folder: Path) -> tuple[Mark, ...]:
    """Every tested run with a date in the watch JSONs of `folder`, oldest first. Of two that test one run the newer
    counts."""
    documents: list[tuple[float, _Watch]] = []
    for path in folder.glob("*.json"):
        with suppress(msgspec.DecodeError, UnicodeDecodeError, OSError, RecursionError, InputError):
            document = msgspec.json.decode(read_bytes(path, MOST_BYTES), type=_Watch)
            documents.append((path.stat().st_mtime, document))
    marks: dict[str, Mark] = {}
    for _, document in sorted(documents, key=lambda one: one[0]):
        for one in document.watched:
            if one.blocks and one.recorded is not None and 1970 < one.recorded.year < 9999:
                worst = min(one.blocks, key=lambda block: block.per_hour)
                change = worst.effect if worst.joint is None else f"{worst.effect}@{worst.joint}"
                marks[one.run] = Mark(one.run, one.recorded.astimezone(UTC), worst.per_hour,
                                      document.false_alarms_per_hour, one.state, change)
    return tuple(sorted(marks.values(), key=lambda mark: mark.recorded))


def anchor(run: str) -> str:
    """The name within the page of the run's row in the list of runs."""
    return f"run-{run}"


def draw_marks(marks: Sequence[Mark]) -> str:
    """The chart as an `<svg>` element; colours come from the page's style. Each point is a link to its run."""
    first, last = marks[0].recorded, marks[-1].recorded
    span = max((last - first).total_seconds(), 86_400.0)  # all of one day: a day wide

    def x(when: datetime) -> float:
        return LEFT + 10 + (when - first).total_seconds() / span * (WIDE - LEFT - RIGHT - 20)

    def y(per_hour: float) -> float:
        share = (log10(MOST) - log10(min(max(per_hour, LEAST), MOST))) / (log10(MOST) - log10(LEAST))
        return TOP + share * (HIGH - TOP - BOTTOM)

    parts = [f'<svg class="watch" viewBox="0 0 {WIDE} {HIGH}" role="img" aria-label="{html.escape(_words(marks))}">']
    for power in range(round(log10(LEAST)) + 1, round(log10(MOST)) + 1, 4):
        at = y(10.0**power)
        label = f"{10.0**power:g}" if abs(power) < 4 else f"1e{power}"
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{WIDE - RIGHT}" y1="{at:.1f}" y2="{at:.1f}"/>'
                     f'<text x="{LEFT - 6}" y="{at + 4:.1f}" text-anchor="end">{label}</text>')
    shown = -float(APART)
    for mark in marks:
        if x(mark.recorded) - shown >= APART:
            shown = x(mark.recorded)
            parts.append(f'<text x="{shown:.1f}" y="{HIGH - 28}" text-anchor="middle">{mark.recorded:%Y-%m-%d}</text>')
    limit = " ".join(f"{at:.1f},{y(mark.threshold):.1f}" for mark, at in (
        (marks[0], float(LEFT)), *((mark, x(mark.recorded)) for mark in marks), (marks[-1], float(WIDE - RIGHT))))
    parts.append(f'<polyline class="limit" points="{limit}"/>')
    for mark in marks:
        parts.append(_point(mark, x(mark.recorded), y(mark.per_hour)))
    parts.append(f'<text x="{LEFT}" y="{HIGH - 8}">day of the recording (UTC)</text></svg>')
    return "".join(parts)


def _point(mark: Mark, x: float, y: float) -> str:
    """A circle; an alarm is a triangle, another shape as well as another colour."""
    words = (f"{mark.run}, {mark.recorded:%Y-%m-%d %H:%M} UTC: {mark.state}; likeliest change {mark.change}, by chance "
             f"{mark.per_hour:.2g} times an hour (threshold {mark.threshold:g})")
    shape = (f'<path class="alarm" d="M{x:.1f} {y + 7:.1f} l-7 -12 h14 z"/>' if mark.state == "alarm" else
             f'<circle class="{"changed" if mark.state == "changed" else "ok"}" cx="{x:.1f}" cy="{y:.1f}" r="4.5"/>')
    return (f'<a href="#{html.escape(anchor(mark.run))}"><title>{html.escape(words)}</title>'
            f'<circle class="reach" cx="{x:.1f}" cy="{y:.1f}" r="12"/>{shape}</a>')


def _words(marks: Sequence[Mark]) -> str:
    """The chart in one sentence."""
    alarms = [mark.run for mark in marks if mark.state == "alarm"]
    return (f"{len(marks)} runs from {marks[0].recorded:%Y-%m-%d} to {marks[-1].recorded:%Y-%m-%d}: "
            + (f"{len(alarms)} with an alarm, the last {alarms[-1]}" if alarms else "no alarm"))


def explain_marks(marks: Sequence[Mark]) -> str:
    """The chart as a sentence, and how to read it."""
    return (f"{_words(marks)}. The axis shows how often an hour of unchanged motion gives such a value by chance. A "
            "triangle below the dashed threshold is an alarm. An orange circle is a run that differs since an alarm.")
