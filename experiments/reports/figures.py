"""Line plots as SVG text for a page: colours follow the page's light or dark scheme, legends stand above the axes."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from daq import FloatArray
from experiments.reports.chart import MOST_SAMPLES, Chart, Line
from experiments.reports.html import Picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, GRID = "#010203", "#040506"
"""Stand-ins that `_themed` turns into the page's own colours."""
BLUE, ORANGE, GREEN, GREY = "#3d85c6", "#e06c1f", "#2f9e62", "#8a8f98"
WIDTH_IN, HEIGHT_IN, ROW_IN = 4.6, 2.4, 0.3
"""So narrow that its letters can be read across a phone; a row is one name's."""
UNITS = {"radps": "rad/s", "mps2": "m/s²", "nm": "N m", "degc": "°C", "v": "V"}
LETTERS, MARK = 54, 5
"""What fits into one line of a legend, and what an entry's mark takes of it."""
STYLE: dict[Any, Any] = {
    "svg.fonttype": "none", "font.family": "sans-serif", "font.size": 10.0, "axes.edgecolor": INK,
    "axes.labelcolor": INK, "text.color": INK, "xtick.color": INK, "ytick.color": INK, "axes.grid": True,
    "grid.color": GRID, "grid.linewidth": 0.6, "axes.spines.top": False, "axes.spines.right": False,
    "path.simplify_threshold": 0.4,
}


def picture_lines(time_s: FloatArray, lines: Sequence[Line], y_label: str, caption: str, seconds: float,
                  group: str = "run", leads: bool = False) -> Picture:
    """Curves over time (n,) [s]: their first `seconds` as a picture, all of them where a browser runs the page's
    script, as far as `MOST_SAMPLES` go."""
    whole = time_s - time_s[0]
    part = slice(0, min(window(time_s, seconds).stop, MOST_SAMPLES))
    shown = [replace(line, values=line.values[part]) for line in lines]
    if whole.size > MOST_SAMPLES:
        caption += f" The first {whole[MOST_SAMPLES - 1]:.0f} of {whole[-1]:.0f} s."
    return Picture(plot_lines(whole[part], shown, y_label), caption,
                   Chart(whole, lines, y_label, group=group), leads, on_paper(seconds, float(whole[-1])))


def on_paper(seconds: float, whole_s: float) -> str:
    """Sentence on a picture that shows less than a browser does; empty where it shows all."""
    return f"The first {seconds:.0f} of {whole_s:.0f} s." if seconds < whole_s - 0.5 else ""


@contextmanager
def blank_figure(name: str, height_in: float = HEIGHT_IN) -> Iterator[Figure]:
    """A figure in the style of a page; `name` keeps its identifiers apart from those of other figures.

    matplotlib is imported here: a command that draws nothing does not wait for it.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({**STYLE, "svg.hashsalt": name}):
        yield Figure(figsize=(WIDTH_IN, height_in), layout="constrained")


def plot_lines(time_s: FloatArray, lines: Sequence[Line], y_label: str, x_label: str = "time [s]") -> str:
    """Curves over time (n,) [s] as an `<svg>` element; NaN leaves a hole."""
    with blank_figure(y_label) as figure:
        axes = figure.add_subplot()
        for line in lines:
            axes.plot(time_s, line.values, label=line.label, color=line.colour, linewidth=line.width,
                      linestyle="--" if line.dashed else "-", zorder=3 if line.dashed else 2)
        finish(axes, len(lines), x_label, y_label)
        axes.set_xlim(float(time_s[0]), float(time_s[-1]))
        return to_svg(figure)


def draw(name: str, height_in: float, paint: Callable[[Axes], None]) -> str:
    """One set of axes as an `<svg>` element; `name` keeps its identifiers apart from those of other figures."""
    with blank_figure(name, height_in) as figure:
        paint(figure.add_subplot())
        return to_svg(figure)


def axis_label(column: str) -> str:
    """`q2 [rad]` of `q2_rad`."""
    name, _, unit = column.rpartition("_")
    return f"{name} [{UNITS.get(unit, unit)}]" if name else column


def name_rows(axes: Axes, names: Sequence[str]) -> None:
    """One row for each name, from the top, without lines between them."""
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")


def finish(axes: Axes, entries: int, x_label: str, y_label: str) -> None:
    """Labels, and a legend of so many entries above the axes."""
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    letters = sum(len(label) + MARK for label in axes.get_legend_handles_labels()[1])
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), frameon=False, fontsize=9.0,
                ncols=entries if entries < 4 and letters <= LETTERS else 2, borderaxespad=0.2, handlelength=1.3,
                handletextpad=0.5, columnspacing=1.1)


def to_svg(figure: Figure) -> str:
    """The figure as an `<svg>` element in the page's colours."""
    out = io.StringIO()
    figure.savefig(out, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    text = out.getvalue()
    return _themed(text[text.index("<svg"):])


def _themed(svg: str) -> str:
    """Ink and grid in the page's colours, the size left to the page, nothing that points outside."""
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r"font: ([^;\"]*)'?DejaVu Sans'?[^;\"]*", r"font: \1sans-serif", svg)
    return svg.replace(INK, "currentColor").replace(GRID, "var(--grid)")


SCHEME = ("<style>svg{color:#1b1f24;--grid:#dfe3e8;background:#ffffff}@media (prefers-color-scheme:dark)"
          "{svg{color:#e4e7eb;--grid:#343a42;background:#15181c}}</style>")


def standalone(svg: str) -> str:
    """The element as a file of its own, with the colours that a page would give it."""
    head, rest = svg.split(">", 1)
    return f'<?xml version="1.0" encoding="utf-8"?>\n{head}>{SCHEME}{rest}'


def window(time_s: FloatArray, seconds: float) -> slice:
    """The first `seconds` of a segment: what a figure can show without becoming a smear."""
    return slice(0, int(np.searchsorted(time_s, time_s[0] + seconds, side="right")))
