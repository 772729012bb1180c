"""`Chart`: curves over time as data for a page's script, which lets a reader zoom in and read values off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from markupsafe import Markup

from daq import FloatArray

MOST_SAMPLES = 6000
"""Of one curve in a page: a minute at 100 Hz. Longer segments end there, and their captions say so."""
DIGITS = 5


@dataclass(frozen=True)
class Line:
    """One curve (n,) over time, and how it looks."""

    label: str
    values: FloatArray
    colour: str
    width: float = 1.2
    dashed: bool = False
    below: bool = False
    """In a browser, on axes of its own below the others: errors under what they are errors of."""


@dataclass(frozen=True)
class Chart:
    """Curves that share `time_s` (n,) [s]; all charts of one `group` on a page are zoomed together."""

    time_s: FloatArray
    lines: Sequence[Line]
    y_label: str
    group: str = "run"
    below: str = ""
    """What the lines below are, with their unit."""

    @property
    def json(self) -> Markup:
        """Its document; NaN is null, and no `<` can end the element that it stands in."""
        part = slice(0, MOST_SAMPLES)
        lines = [{"label": line.label, "colour": line.colour, "width": line.width, "dashed": line.dashed,
                  "below": line.below, "values": _numbers(line.values[part])} for line in self.lines]
        document = {"x": "time [s]", "y": self.y_label, "group": self.group, "below": self.below,
                    "lines": lines, "time": np.round(self.time_s[part], 6).tolist()}
        return Markup(msgspec.json.encode(document).decode().replace("<", "\\u003c"))


def _numbers(values: FloatArray) -> list[float | None]:
    return [float(f"{v:.{DIGITS}g}") if np.isfinite(v) else None for v in values]
