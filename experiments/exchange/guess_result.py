"""A guessed map of columns, with the reasons."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from daq import Column, Dataset, FloatArray


@dataclass(frozen=True)
class GuessedMap:
    """Columns with the reasons."""

    columns: dict[str, Column]
    notes: dict[str, str]
    """Why, by column of the contract."""
    warnings: list[str]
    unexplained: list[str]
    """What no unit and sign makes fit; with any, the guess is not to be used as it is."""
    curves: Mapping[str, tuple[FloatArray, FloatArray]] = field(default_factory=dict)
    """Title -> what was measured and what physics makes of the other columns, both (n,) on the grid of `run`."""


@dataclass(frozen=True, kw_only=True)
class Guess(GuessedMap):
    """Guessed map of a file."""

    run: Dataset
    """The file as it reads by the guess."""
