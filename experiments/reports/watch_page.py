"""Watched runs as a page: the test over the runs, a line a run, and what the last alarm's runs changed by."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from experiments.judge import Watched
from experiments.provenance import Origin
from experiments.reports.change import REFERENCE_NAMES
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


def write_watch(path: Path | str, lines: Sequence[Watched], false_alarms: float, origin: Origin) -> None:
    """Write the page. Raises `InputError` where that place cannot be written."""
    summary = watch_summary(lines, false_alarms)
    alarms = [one for one in lines if one.found.alarm is not None]
    named = [one.change for one in lines if one.change is not None]
    box = VerdictBox("bad" if alarms else "good", "The rig changed" if alarms else "No alarm",
                     [summary, *([named[-1].sentence] if named else [])],
                     [f"{one.found.run} was not tested: {one.found.failed}" for one in lines if one.found.failed])
    caption = ("Each point is a block of motion. The axis shows how often chance alone gives as strong a change as the "
               "likeliest one of that block. Below the line is an alarm.")
    rows = [[one.found.run, one.state, f"{one.found.seconds:.0f}",
             "" if one.found.alarm is None else f"{one.found.alarm.end_s:.1f}",
             "" if worst is None else label_of(worst), "" if worst is None else often(worst.per_hour)]
            for one in lines for worst in [one.found.alarm or one.found.worst]]
    sections = [Section("The test over the runs", (), [Table(HEADER, rows, right=frozenset({2, 3}))],
                        [Picture(watch_plot(lines, false_alarms), caption)])]
    if named:
        sections += change_sections((REFERENCE_NAMES, named[-1]))
    write_page(path, "Watch", f"{len(lines)} runs.", [*sections, origin_section(origin)], origin, box)


def watch_plot(lines: Sequence[Watched], false_alarms: float) -> str:
    """`paint_watch` as an `<svg>` element."""
    return draw("watch", 2.6, lambda axes: paint_watch(axes, lines, false_alarms))


def paint_watch(axes: Axes, lines: Sequence[Watched], false_alarms: float) -> None:
    """False alarms per hour that each block just reaches, over the runs, and the threshold."""
    points = [(k + (j + 0.5) / len(one.found.blocks), block.per_hour) for k, one in enumerate(lines)
              for j, block in enumerate(one.found.blocks)]
    x, y = np.array(points, dtype=float).reshape(-1, 2).T
    low = y < false_alarms
    for which, colour, label in ((~low, BLUE, "block"), (low, ORANGE, "alarm")):
        axes.scatter(x[which], np.maximum(y[which], LEAST), s=14.0, c=colour, label=label, zorder=3)
    axes.axhline(false_alarms, color=INK, linestyle="--", linewidth=1.0, label="threshold")
    axes.set_yscale("log")
    axes.set_xlim(0.0, max(len(lines), 1))
    finish(axes, 3, "run", "false alarms per hour")
