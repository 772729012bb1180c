"""What a caller is told when data cannot answer the question put to it."""

from __future__ import annotations


class FitError(Exception):
    """The fit cannot be done on this data; the message says what is missing in one line."""


class ScaleError(FitError):
    """Nothing tells how heavy the mechanism is."""


class GapError(FitError):
    """Every stretch of the data without a gap is too short."""
