"""Watched runs as text and page: a line a run, the test over the runs, and what the last alarm's runs changed by."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from experiments.documents import Block, WatchDocument, WatchedRun
from experiments.reports.change import change_sections
from experiments.reports.figures import BLUE, INK, ORANGE, draw, finish
from experiments.reports.html import Picture, Section, Table
from experiments.reports.origin import write_result

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_H = 1e6
"""Longer times between false alarms are not told apart."""
LEAST = 1e-9
"""False alarms per hour below which the figure ends."""
MOST_TICKS = 12


def watch_text(found: WatchDocument) -> str:
    """The answer, and a line a run."""
    return "\n".join([f"{found.headline.title}: {found.summary}", *map(line_text, found.watched)])


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


def write_watch(path: Path | str, found: WatchDocument) -> None:
    """Write the page. Raises `InputError` where that place cannot be written."""
    caption = ("Each point is a block of motion. The axis shows how often chance alone gives as strong a change as the "
               "likeliest one of that block. Below the line is an alarm.")
    rows = [[one.run, one.state, f"{one.seconds:.0f}", "" if one.alarm is None else f"{one.alarm.end_s:.1f}",
             *(("", "") if one.worst is None else (label_of(one.worst), often(one.worst.per_hour)))]
            for one in found.watched]
    table = Table(["run", "state", "motion [s]", "alarm after [s]", "likeliest change", "by chance"], rows, {2, 3})
    write_result(path, found, "Watch", "", [
        Section("The test over the runs", (), [table],
                [Picture(draw("watch", 2.6, lambda axes: paint_watch(axes, found)), caption, leads=True)]),
        *(change_sections(found.change) if found.change else ())])


def paint_watch(axes: Axes, found: WatchDocument) -> None:
    """False alarms per hour that each block just reaches, over the runs, and the threshold."""
    lines, threshold = found.watched, found.false_alarms_per_hour
    points = [(k + (j + 0.5) / len(one.blocks), block.per_hour) for k, one in enumerate(lines)
              for j, block in enumerate(one.blocks)]
    x, y = np.array(points, dtype=float).reshape(-1, 2).T
    low = y < threshold
    for which, colour, label in ((~low, BLUE, "block"), (low, ORANGE, "alarm")):
        axes.scatter(x[which], np.maximum(y[which], LEAST), s=14.0, c=colour, label=label, zorder=3)
    axes.axhline(threshold, color=INK, linestyle="--", linewidth=1.0, label="threshold")
    axes.set_yscale("log")
    axes.set_xlim(0.0, max(len(lines), 1))
    step = -(-len(lines) // MOST_TICKS) or 1
    axes.set_xticks(np.arange(0, len(lines), step) + 0.5, [str(k + 1) for k in range(0, len(lines), step)])
    finish(axes, 3, "run", "false alarms per hour")
