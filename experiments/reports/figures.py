"""Line plots as SVG text for a page: colours follow the page's light or dark scheme, legends stand above the axes."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from daq import FloatArray

INK, GRID = "#010203", "#040506"
"""Stand-ins that `_themed` turns into the page's own colours."""
BLUE, ORANGE, GREEN, GREY = "#3d85c6", "#e06c1f", "#2f9e62", "#8a8f98"
WIDTH_IN, HEIGHT_IN = 5.2, 2.5
STYLE: dict[Any, Any] = {
    "svg.fonttype": "none", "font.family": "sans-serif", "font.size": 10.0, "axes.edgecolor": INK,
    "axes.labelcolor": INK, "text.color": INK, "xtick.color": INK, "ytick.color": INK, "axes.grid": True,
    "grid.color": GRID, "grid.linewidth": 0.6, "axes.spines.top": False, "axes.spines.right": False,
    "path.simplify_threshold": 0.4,
}


@dataclass(frozen=True)
class Line:
    """One curve (n,) over time, and how it looks."""

    label: str
    values: FloatArray
    colour: str
    width: float = 1.2
    dashed: bool = False


def plot_lines(time_s: FloatArray, lines: Sequence[Line], y_label: str, x_label: str = "time [s]") -> str:
    """Curves over time (n,) [s] as an `<svg>` element; NaN leaves a hole."""
    with mpl.rc_context({**STYLE, "svg.hashsalt": y_label}):
        figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), layout="constrained")
        axes = figure.add_subplot()
        for line in lines:
            axes.plot(time_s, line.values, label=line.label, color=line.colour, linewidth=line.width,
                      linestyle="--" if line.dashed else "-", zorder=3 if line.dashed else 2)
        finish(axes, len(lines), x_label, y_label)
        axes.set_xlim(float(time_s[0]), float(time_s[-1]))
        return to_svg(figure)


def finish(axes: mpl.axes.Axes, entries: int, x_label: str, y_label: str) -> None:
    """Labels, and a legend of so many entries above the axes."""
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=entries if entries < 4 else 2, frameon=False,
                borderaxespad=0.2, handlelength=1.6, columnspacing=1.4)


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
    """The first `seconds` of a stretch: what a figure can show without becoming a smear."""
    return slice(0, int(np.searchsorted(time_s, time_s[0] + seconds, side="right")))
