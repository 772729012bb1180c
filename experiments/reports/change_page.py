"""A change, or the difference of sessions, as a page: the answer, how much by effect, what would have shown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from experiments.documents import Answer, Candidate, Differing, finite
from experiments.judge import Files, Level, with_names
from experiments.provenance import Origin
from experiments.reports.change import (
    CAUSE_HEADER,
    DETECTABLE_HEADER,
    cause_rows,
    detectable_rows,
    free_runs_text,
    held_out_text,
    label,
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


def worst_of(pairs: Sequence[Differing]) -> Differing:
    """The one that differs most."""
    return max(pairs, key=lambda pair: list(LEVELS).index(pair.verdict))


def write_change(path: Path | str, pairs: Sequence[Differing], origin: Origin,
                 damaged: Sequence[Mapping[str, str]] = (), files: Files | None = None) -> None:
    """Write the page; its next step names `files`. Raises `InputError` where that place cannot be written."""
    first, worst = pairs[0].sides[0], worst_of(pairs)
    others = [pair.sides[1] for pair in pairs]
    lines = [pair.sentence if len(pairs) == 1 else f"{other.name} against {first.name}: {pair.sentence}"
             for pair, other in zip(pairs, others)]
    warnings = dict.fromkeys(f"Warning: {text}" for pair in pairs for text in pair.warnings)
    box = VerdictBox(LEVELS[worst.verdict], TITLES[worst.verdict], lines, list(warnings),
                     f"Next step: {with_names(worst.next_step, files)}.")
    count = len(first.runs) + sum(len(other.runs) for other in others)
    write_page(path, f"From {first.name} to {', '.join(other.name for other in others)}", f"{count} runs.",
               [*(section for pair in pairs for section in change_sections(pair, len(pairs) > 1)),
                origin_section(origin, damaged=damaged)], origin, box)


def change_sections(found: Differing, several: bool = False) -> list[Section]:
    """Causes with the figure, noise, smallest changes, what cannot be tested, runs."""
    head = f"{found.sides[1].name}: " if several else ""
    more = fold([_noise(found), _smallest(found), _untestable(found), _runs(found)])
    return [_answer(found, several), *(replace(s, title=head + s.title) for s in more)]


def _answer(found: Differing, several: bool) -> Section:
    a, b = (side.name for side in found.sides)
    causes = [Table(CAUSE_HEADER, cause_rows(found), right=frozenset({3, 4}))] if found.causes else []
    caption = ("Estimated change of each effect, all else unchanged, over the smallest detectable change: what these "
               "runs would have shown with 80 % probability. Bars are 95 % intervals.")
    drawn = drawn_changes(found)
    pictures = [Picture(change_plot(found, f"{a} {b}"), caption, leads=not several)] if drawn else []
    return Section(f"From {a} to {b}", [found.sentence] if several else [], causes, pictures,
                   [*held_out_text(found), *free_runs_text(found)])


def _noise(found: Differing) -> Section:
    a, b = (side.name for side in found.sides)
    rows = [[n.column, f"{n.ratio:.3g}", " .. ".join(f"{finite(x):.3g}" for x in n.ci95), f"{n.p_value:.2g}"]
            for n in found.noise]
    if not rows:
        return Section("Noise")
    return Section("Noise", [f"Noise level of {b} over that of {a}, from neighbouring samples. p is over all columns."],
                   [Table(["column", "ratio", "95 % interval", "p"], rows, right=frozenset({1, 2, 3}))])


def _smallest(found: Differing) -> Section:
    title = "Smallest changes that would have shown"
    if not found.candidates:
        return Section(title)
    return Section(title, [structure_text(found)],
                   [Table(DETECTABLE_HEADER, detectable_rows(found), right=frozenset({2}))])


def _untestable(found: Answer) -> Section:
    rows = [[one.effect if one.joint is None else f"{one.effect}, joint {one.joint}", one.why]
            for one in found.not_testable]
    return Section("What cannot be tested here", (), [Table(["effect", "why"], rows)] if rows else ())


def _runs(found: Differing) -> Section:
    rows = [[side.name, ", ".join(side.runs)] for side in found.sides]
    return Section("Runs", (), [Table(["session", "runs"], rows)])


def drawn_changes(found: Answer) -> list[Candidate]:
    """Those that the figure has."""
    return [d for d in found.candidates if d.smallest_detectable][:DRAWN]


def change_plot(found: Answer, name: str) -> str:
    """The likeliest changes with intervals, in units of the smallest change that would have shown; `name` is that of
    the pair."""
    some = drawn_changes(found)

    def paint(axes: Axes) -> None:
        paint_changes(axes, some)
        finish(axes, 1, "change over\nsmallest detectable change", "")  # long names leave the axes narrow

    return draw(f"change {name}", 1.05 + ROW_IN * len(some), paint)


def paint_changes(axes: Axes, some: Sequence[Candidate]) -> None:
    """A row each, its interval as a bar."""
    rows = np.arange(len(some), dtype=float)
    share, low, high = np.array([(d.change, *map(finite, d.ci95 or (None, None))) for d in some]).T / np.array(
        [finite(d.smallest_detectable) for d in some])
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
    axes.set_yticks(rows, [f"{label(d)}{f' {d.size_name}' if d.effect == 'parameter' else ''}".replace("_", " ")
                           for d in some])
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
