"""Units in which a column of a motion is tried, and the words for a reading of another unit, sign or place."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

DEGREE, TURN, G = float(np.pi / 180.0), float(2.0 * np.pi), 9.80665
TRIED = {
    "rad": {"": 1.0, "deg": DEGREE, "turn": TURN, "mrad": 1e-3},
    "radps": {"": 1.0, "deg/s": DEGREE, "turn/s": TURN, "rpm": TURN / 60.0, "mdps": 1e-3 * DEGREE, "mrad/s": 1e-3},
    "mps2": {"": 1.0, "g": G, "mg": 1e-3 * G, "mm/s2": 1e-3},
}
"""Ending of a contract column -> unit -> factor to the contract's own, which comes first and has no name."""
WORDS = {"deg": "degrees", "turn": "turns", "deg/s": "degrees a second", "turn/s": "turns a second"}
TWICE = 1.0 / DEGREE


def tried(column: str) -> dict[str, float]:
    """Unit -> factor of the units that are tried for `column`, by its ending."""
    return TRIED.get(column.rpartition("_")[2], {"": 1.0})


def correction(factors: Mapping[str, float], sources: Mapping[str, str] | None = None) -> tuple[str, str]:
    """Two sentences on columns whose readings need these factors: what looks wrong, and what to write into rig.toml.

    `sources` are the columns that they are read from, each from itself without.
    """
    looks: dict[str, list[str]] = {}
    writes = []
    for column, factor in factors.items():
        source = (sources or {}).get(column, column)
        if (source, factor) == (column, 1.0):
            continue
        minus, size = factor < 0.0, abs(factor)
        words = ["negated"] * minus if source == column else [f"like {'minus ' * minus}{source}"]
        unit = next((unit for unit, scale in tried(column).items() if scale == size), None)
        scale = f"{1.0 / size:.3g} times too large" if size < 1.0 else f"{size:.3g} times too small"
        if unit is None:
            words.append("converted from degrees twice" if size == TWICE else scale)
        elif unit:
            words.append(f"in {WORDS.get(unit, unit)}")
        entries = [f'name = "{source}"', *["sign = -1"] * minus,
                   *([f"scale = {size:.6g}"] if unit is None else [f'unit = "{unit}"'] * bool(unit))]
        looks.setdefault(" and ".join(words), []).append(column)
        writes.append(f"{' and '.join(entries)} under [columns.{column}]")
    what = [f"{' and '.join(some)} {'look' if len(some) > 1 else 'looks'} {how}" for how, some in looks.items()]
    return " and ".join(what), f"set {' and '.join(writes)}"
