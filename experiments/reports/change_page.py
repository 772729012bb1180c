"""A change, or the difference of sessions, as a page: the answer, how much by effect, what would have shown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from daq import Dataset
from estimator.change import Change, Detectable
from experiments.judge import Files, Level, with_names
from experiments.provenance import Origin
from experiments.reports.change import (
    CAUSE_HEADER,
    DETECTABLE_HEADER,
    Pair,
    cause_rows,
    detectable_rows,
    free_runs_text,
    held_out_text,
    label,
    next_of_change,
    structure_text,
)
from experiments.reports.diagnosis_figures import ROW_IN, draw
from experiments.reports.figures import BLUE, GREY, INK, ORANGE, finish
from experiments.reports.html import Picture, Section, Table, VerdictBox, fold, write_page
from experiments.reports.origin import origin_section

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DRAWN = 14
"""Effects in the figure, the likeliest first."""
LEVELS: dict[str, Level] = {"no_change": "good", "named": "caution", "partial": "caution",
                                      "one_of": "caution", "changed_unexplained": "bad", "fit_failed": "bad"}
TITLES: dict[str, str] = {"no_change": "No difference", "named": "Different: the cause is named",
                                    "partial": "Different: part of the cause is named",
                                    "one_of": "Different, by one of several causes",
                                    "changed_unexplained": "Different, and no listed cause explains it",
                                    "fit_failed": "No comparison is possible"}


def write_change(path: Path | str, pairs: Sequence[Pair], origin: Origin, runs: Sequence[Dataset] = (),
                 files: Files | None = None) -> None:
    """Write the page; its next step names `files`. Raises `InputError` where that place cannot be written."""
    names, first = pairs[0]
    worst = max((found for _, found in pairs), key=lambda f: list(LEVELS).index(f.verdict))
    lines = [found.sentence if len(pairs) == 1 else f"{b} against {a}: {found.sentence}" for (a, b), found in pairs]
    warnings = dict.fromkeys(f"Warning: {text}" for _, found in pairs for text in found.warnings)
    box = VerdictBox(LEVELS[worst.verdict], TITLES[worst.verdict], lines, list(warnings),
                     f"Next step: {with_names(next_of_change(worst), files)}.")
    count = len(first.reference) + sum(len(found.test) for _, found in pairs)
    write_page(path, f"From {names[0]} to {', '.join(b for (_, b), _ in pairs)}", f"{count} runs.",
               [*(section for pair in pairs for section in change_sections(pair, len(pairs) > 1)),
                origin_section(origin, runs)], origin, box)


def change_sections(pair: Pair, several: bool = False) -> list[Section]:
    """Causes with the figure, noise, smallest changes, what cannot be tested, runs."""
    head = f"{pair[0][1]}: " if several else ""
    more = fold([_noise(pair), _smallest(pair[1]), _untestable(pair[1]), _runs(pair)])
    return [_answer(pair, several), *(replace(s, title=head + s.title) for s in more)]


def _answer(pair: Pair, several: bool) -> Section:
    (a, b), found = pair
    causes = [Table(CAUSE_HEADER, cause_rows(found), right=frozenset({3, 4}))] if found.causes else []
    caption = ("Estimated change of each effect, all else unchanged, over the smallest detectable change: what these "
               "runs would have shown with 80 % probability. Bars are 95 % intervals.")
    drawn = drawn_changes(found.detectable)
    pictures = [Picture(change_plot(found.detectable, f"{a} {b}"), caption, leads=not several)] if drawn else []
    return Section(f"From {a} to {b}", [found.sentence] if several else [], causes, pictures,
                   [*([] if found.held_out is None else [held_out_text(found.held_out)]),
                    *free_runs_text(found)])


def _noise(pair: Pair) -> Section:
    (a, b), found = pair
    rows = [[n.column, f"{n.ratio:.3g}", f"{n.ci95[0]:.3g} .. {n.ci95[1]:.3g}", f"{n.p_value:.2g}"]
            for n in found.noise]
    if not rows:
        return Section("Noise")
    return Section("Noise", [f"Noise level of {b} over that of {a}, from neighbouring samples. p is over all columns."],
                   [Table(["column", "ratio", "95 % interval", "p"], rows, right=frozenset({1, 2, 3}))])


def _smallest(found: Change) -> Section:
    title = "Smallest changes that would have shown"
    if not found.detectable:
        return Section(title)
    return Section(title, [structure_text(found)],
                   [Table(DETECTABLE_HEADER, detectable_rows(found), right=frozenset({2}))])


def _untestable(found: Change) -> Section:
    rows = [[effect.replace("@", ", joint "), why] for effect, why in found.not_testable]
    return Section("What cannot be tested here", (), [Table(["effect", "why"], rows)] if rows else ())


def _runs(pair: Pair) -> Section:
    (a, b), found = pair
    return Section("Runs", (), [Table(["session", "runs"],
                                      [[a, ", ".join(found.reference)], [b, ", ".join(found.test)]])])


def drawn_changes(detectable: Sequence[Detectable]) -> list[Detectable]:
    """Those that the figure has."""
    return [d for d in detectable if isfinite(d.size) and d.size > 0.0][:DRAWN]


def change_plot(detectable: Sequence[Detectable], name: str) -> str:
    """The likeliest changes with intervals, in units of the smallest change that would have shown; `name` is that of
    the pair."""
    some = drawn_changes(detectable)

    def paint(axes: Axes) -> None:
        paint_changes(axes, some)
        finish(axes, 1, "change over\nsmallest detectable change", "")  # long names leave the axes narrow

    return draw(f"change {name}", 1.05 + ROW_IN * len(some), paint)


def paint_changes(axes: Axes, some: Sequence[Detectable]) -> None:
    """A row each, its interval as a bar."""
    rows = np.arange(len(some), dtype=float)
    share = np.array([d.change / d.size for d in some])
    low, high = (np.array([d.ci95[k] / d.size for d in some]) for k in (0, 1))
    axes.axvline(0.0, color=INK, linewidth=0.6)
    for side in (-1.0, 1.0):
        axes.axvline(side, color=GREY, linestyle="--", linewidth=1.0,
                     label="smallest detectable" if side > 0.0 else None)
    beyond = np.abs(share) > 1.0
    axes.errorbar(share, rows, xerr=[share - low, high - share], fmt="none", ecolor=GREY, elinewidth=1.4, zorder=2)
    axes.scatter(share, rows, s=20.0, c=[ORANGE if far else BLUE for far in beyond], zorder=3)
    axes.scatter([], [], s=20.0, c=BLUE, label="change")
    if np.abs(share).max(initial=0.0) > 5.0:
        axes.set_xscale("symlog", linthresh=1.0)
        axes.xaxis.set_major_formatter("{x:g}")
    axes.set_yticks(rows, [f"{label(d)}{f' {d.name}' if d.effect == 'parameter' else ''}".replace("_", " ")
                           for d in some])
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
