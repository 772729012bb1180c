"""A change of a rig, or the differences of sessions, as text and page: the answer, how much by effect, what would have
shown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from experiments.documents import Answer, Candidate, Cause, ChangeDocument, Differing, SessionsDocument, finite
from experiments.judge import Files, with_names
from experiments.reports.diagnosis_text import untestable_section
from experiments.reports.figures import BLUE, GREY, INK, ORANGE, ROW_IN, draw, finish, name_rows
from experiments.reports.html import Picture, Section, Table, fold
from experiments.reports.origin import write_result

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHOWN = 12
"""Smallest changes that a terminal shows; the JSON has all."""
DRAWN = 14
"""Effects in the figure, the likeliest first."""


def change_text(differing: Differing, files: Files | None = None) -> str:
    """Text after `legid diagnose --against` and `legid compare`: the verdict first. The next step names `files`."""
    first, second = differing.sides
    blocks = [with_names(differing.headline.text, files)]
    if differing.causes:
        blocks.append(f"From {first.name} to {second.name}:\n" + cause_table(differing).text)
    blocks += [*held_out_text(differing), *free_runs_text(differing)]
    if differing.candidates:
        table = detectable_table(differing, SHOWN)
        blocks += ["Smallest change that these runs would have shown with 80 % probability (the likeliest "
                   f"{len(table.rows)} of {len(differing.candidates)}):\n{table.text}", structure_text(differing)]
    blocks.append(f"Runs: {', '.join((*first.runs, *second.runs))}. ({differing.wall_s:.0f} s)")
    return "\n\n".join(blocks)


def sessions_text(document: SessionsDocument) -> str:
    """Text of a single pair; of several pairs the gravest verdict, and a table with one row a pair."""
    if len(document.pairs) == 1:
        return change_text(document.pairs[0])
    rows = [[pair.a.name, pair.b.name, pair.verdict, pair.sentence] for pair in document.pairs]
    return f"{document.headline.title}\n\n{Table(['from', 'to', 'verdict', 'difference'], rows).text}"


def cause_table(answer: Answer) -> Table:
    """One row a size of a cause."""
    return Table(["effect", "a change of", "size", "value", "95 % interval", "unit"], [
        [label(c) if not k else "", c.kind if not k else "", s.name, f"{s.value:.4g}",
         " .. ".join(f"{finite(x):.4g}" for x in s.ci95), s.unit] for c in answer.causes
        for k, s in enumerate(c.size)], {3, 4})


def detectable_table(answer: Answer, most: int | None = None) -> Table:
    """One row an effect, the likeliest first, at most so many."""
    return Table(["effect", "size", "smallest change", "unit"], [
        [label(d), d.size_name, "none" if d.smallest_detectable is None else f"{d.smallest_detectable:.2g}", d.unit]
        for d in answer.candidates[:most]], {2})


def held_out_text(answer: Answer) -> list[str]:
    """Sentence on how well the change predicts runs that it was not fitted to."""
    if answer.held_out is None:
        return []
    gains = answer.held_out.gain
    better = sum(finite(gain) > 0.0 for gain in gains)
    return [f"Fitted to the other runs, the change predicts {better} of {len(gains)} runs better than no change."]


def free_runs_text(answer: Answer) -> list[str]:
    """Sentence on how much more free runs err than left-out runs of the other session, where no change is found."""
    rise = answer.free_runs
    if rise is None or answer.verdict != "no_change":
        return []
    low, high = map(finite, rise.ci95)
    return [f"Free runs over 1 s err {rise.ratio:.2g} times [{low:.2g}, {high:.2g}] as much in {rise.column} as those "
            f"of left-out runs of the other session (p = {rise.p_value:.2g})."]


def structure_text(differing: Differing) -> str:
    """Sentence on the part of the runs that no law explains."""
    return ("Unexplained structure within a session, in standard deviations of a size estimated from one run: {:.2g} "
            "common to its runs, {:.2g} different in each run, drifts aside.".format(*differing.structure))


def label(one: Cause | Candidate) -> str:
    """The effect and where it is."""
    where = "link" if one.effect == "payload" else "joint"
    return one.effect if one.joint is None else f"{one.effect}, {where} {one.joint}"


def write_change(path: Path | str, found: ChangeDocument | SessionsDocument, files: Files | None = None) -> None:
    """Write the page; its next step names `files`. Raises `InputError` where that place cannot be written."""
    pairs = found.pairs
    first, others = pairs[0].sides[0], [pair.sides[1] for pair in pairs]
    write_result(path, found, f"From {first.name} to {', '.join(other.name for other in others)}",
                 f"{len(first.runs) + sum(len(other.runs) for other in others)} runs.",
                 [section for pair in pairs for section in change_sections(pair, len(pairs) > 1)], files)


def change_sections(found: Differing, several: bool = False) -> list[Section]:
    """Causes with the figure, noise, smallest changes, what cannot be tested, runs."""
    a, b = (side.name for side in found.sides)
    head = f"{b}: " if several else ""
    caption = ("Estimated change of each effect, all else unchanged, over the smallest detectable change: what these "
               "runs would have shown with 80 % probability. Bars are 95 % intervals.")
    pictures = [Picture(change_plot(found, f"{a} {b}"), caption, leads=not several)] if drawn_changes(found) else []
    noise = [[n.column, f"{n.ratio:.3g}", " .. ".join(f"{finite(x):.3g}" for x in n.ci95), f"{n.p_value:.2g}"]
             for n in found.noise]
    more = fold(
        Section("Noise", [f"Noise level of {b} over that of {a}, from neighbouring samples. p is over all columns."],
                [Table(["column", "ratio", "95 % interval", "p"], noise, {1, 2, 3})]) if noise else None,
        Section("Smallest changes that would have shown", [structure_text(found)], [detectable_table(found)]
                ) if found.candidates else None,
        untestable_section(found.not_testable),
        Section("Runs", tables=[Table(["session", "runs"], [[s.name, ", ".join(s.runs)] for s in found.sides])]))
    return [Section(f"From {a} to {b}", [found.sentence] if several else [],
                    [cause_table(found)] if found.causes else [], pictures,
                    [*held_out_text(found), *free_runs_text(found)]),
            *(replace(s, title=head + s.title) for s in more)]


def drawn_changes(answer: Answer) -> list[Candidate]:
    """Those that the figure has."""
    return [d for d in answer.candidates if d.smallest_detectable][:DRAWN]


def change_plot(answer: Answer, name: str) -> str:
    """The likeliest changes with intervals, in units of the smallest change that would have shown; `name` is that of
    the pair."""
    some = drawn_changes(answer)

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
    for colour, what, there in ((BLUE, "change", ~beyond), (ORANGE, "larger change", beyond)):
        axes.scatter(share[there], rows[there], s=20.0, c=colour, zorder=3, label=what if there.any() else None)
    if np.abs(share).max(initial=0.0) > 5.0:
        axes.set_xscale("symlog", linthresh=1.0)
        axes.xaxis.set_major_formatter("{x:g}")
    name_rows(axes, [f"{label(d)}{f' {d.size_name}' if d.effect == 'parameter' else ''}".replace("_", " ")
                     for d in some])
