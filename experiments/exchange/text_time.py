"""Times that are text: a date and a time of day, or a time of day alone."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import date

import numpy as np

from daq import FloatArray

_ISO = r"(?P<year>\d{4})-(?P<month>\d{1,2})-(?P<day>\d{1,2})"
_POINTS = r"(?P<day>\d{1,2})\.(?P<month>\d{1,2})\.(?P<year>\d{4})"
_SLASHES = r"(?P<first>\d{1,2})/(?P<second>\d{1,2})/(?P<year>\d{4})"
_CLOCK = r"(?P<h>\d{1,2}):(?P<m>\d{2}):(?P<s>\d{2}(?:[.,]\d+)?)"
_ZONE = r"\s*(?P<zone>Z|UTC|[+-]\d{2}:?\d{2})?"
FORMS = (*(re.compile(rf"{day}[T\s]\s*{_CLOCK}{_ZONE}") for day in (_ISO, _POINTS, _SLASHES)), re.compile(_CLOCK))
"""A date by its mark, and a time of day; the last: a time of day alone, which may go over midnight."""
MOST_WRONG = 0.05


def read_times(cells: Sequence[str]) -> FloatArray | None:
    """(n,) seconds since the first of `cells`, NaN where one is no time; None where they are not written as times.

    A time of day alone starts again at midnight, as a counter does. A date with slashes has its month first, unless a
    number above 12 stands there.
    """
    first = next((cell.strip() for cell in cells if cell.strip()), "")
    form = next((one for one in FORMS if one.fullmatch(first)), None)
    if form is None:
        return None
    found = [form.fullmatch(cell.strip()) for cell in cells]
    if sum(one is None and bool(cell.strip()) for one, cell in zip(found, cells)) > MOST_WRONG * len(found):
        return None
    swapped = "first" in form.groupindex and any(int(one["first"]) > 12 for one in found if one)
    try:
        days, clocks = np.array([(np.nan, np.nan) if one is None else _parts(one.groupdict(), swapped)
                                 for one in found]).T
    except ValueError:  # a 13th month, a 25th hour
        return None
    if form is FORMS[-1]:
        return clocks
    first_row = int(np.flatnonzero(np.isfinite(days))[0])
    return 86400.0 * (days - days[first_row]) + (clocks - clocks[first_row])


def _parts(parts: dict[str, str | None], swapped: bool) -> tuple[float, float]:
    """Number of the day, 0 without a date, and seconds of the day: apart, since their sum has too few digits."""
    clock = 3600.0 * int(parts["h"] or 0) + 60.0 * int(parts["m"] or 0) + float((parts["s"] or "0").replace(",", "."))
    if "year" not in parts:
        return 0.0, clock
    month, day = parts.get("month"), parts.get("day")
    if "first" in parts:
        month, day = (parts["second"], parts["first"]) if swapped else (parts["first"], parts["second"])
    zone = parts.get("zone") or "Z"
    if zone not in ("Z", "UTC"):
        ahead = 3600.0 * int(zone[1:3]) + 60.0 * int(zone[-2:])
        clock -= -ahead if zone[0] == "-" else ahead
    return float(date(int(parts["year"] or 0), int(month or 0), int(day or 0)).toordinal()), clock
