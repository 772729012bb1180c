"""Watched runs as a page: the test over the runs, a line a run, and what the last alarm's runs changed by."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from experiments.documents import WatchDocument
from experiments.provenance import Origin
from experiments.reports.change_page import change_sections
from experiments.reports.diagnosis_figures import draw
from experiments.reports.figures import BLUE, INK, ORANGE, finish
from experiments.reports.html import Picture, Section, Table, VerdictBox, write_page
from experiments.reports.origin import origin_section
from experiments.reports.watch import label_of, often, watch_summary

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LEAST = 1e-9
"""False alarms per hour below which the figure ends."""
HEADER = ["run", "state", "motion [s]", "alarm after [s]", "likeliest change", "by chance"]


def write_watch(path: Path | str, found: WatchDocument, origin: Origin) -> None:
    """Write the page. Raises `InputError` where that place cannot be written."""
    lines = found.watched
    alarms = [one for one in lines if one.alarm is not None]
    named = [one.change for one in lines if one.change is not None]
    box = VerdictBox("bad" if alarms else "good", "The rig changed" if alarms else "No alarm",
                     [watch_summary(found), *([named[-1].sentence] if named else [])],
                     [f"{one.run} was not tested: {one.failed}" for one in lines if one.failed])
    caption = ("Each point is a block of motion. The axis shows how often chance alone gives as strong a change as the "
               "likeliest one of that block. Below the line is an alarm.")
    rows = [[one.run, one.state, f"{one.seconds:.0f}", "" if one.alarm is None else f"{one.alarm.end_s:.1f}",
             *(("", "") if one.worst is None else (label_of(one.worst), often(one.worst.per_hour)))] for one in lines]
    sections = [Section("The test over the runs", (), [Table(HEADER, rows, right=frozenset({2, 3}))],
                        [Picture(draw("watch", 2.6, lambda axes: paint_watch(axes, found)), caption)])]
    if named:
        sections += change_sections(named[-1])
    write_page(path, "Watch", f"{len(lines)} runs.", [*sections, origin_section(origin)], origin, box)


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
    finish(axes, 3, "run", "false alarms per hour")
