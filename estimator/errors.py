"""Errors of the estimator: data that do not answer the question."""

from __future__ import annotations


class FitError(Exception):
    """The fit cannot be done on this data; the message says what is missing in one line."""


class ScaleError(FitError):
    """The data do not determine the scale of the masses."""


class GapError(FitError):
    """Every segment of the data without a gap is too short."""
