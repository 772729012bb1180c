"""Units that other programs write, as factors to the contract's: those that are tried, and how else they are spelt."""

from __future__ import annotations

import difflib
import re

from daq import InputError
from estimator.calibration import DEGREE, TRIED, TURN, G

UNITS: dict[str, dict[str, float]] = {
    "s": {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0},
    "rad": {"rad": 1.0, **TRIED["rad"], "degrees": DEGREE, "°": DEGREE, "turns": TURN, "rev": TURN},
    "radps": {"rad/s": 1.0, **TRIED["radps"], "radps": 1.0, "°/s": DEGREE, "dps": DEGREE, "turns/s": TURN,
              "rev/s": TURN, "hz": TURN},
    "mps2": {"m/s2": 1.0, **TRIED["mps2"], "m/s^2": 1.0, "m/s²": 1.0, "mps2": 1.0},
    "nm": {"n m": 1.0, "nm": 1.0, "n*m": 1.0, "mn m": 1e-3, "mnm": 1e-3, "n cm": 1e-2, "ncm": 1e-2, "kg cm": 1e-2 * G,
           "a": 1.0, "ma": 1e-3, "lsb": 1.0, "counts": 1.0},
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "n": {"n": 1.0, "kn": 1e3, "a": 1.0},
    "degc": {"degc": 1.0, "°c": 1.0, "c": 1.0},
    "raw": {"raw": 1.0},
    "duty": {"": 1.0, "%": 1e-2},
    "enable": {"": 1.0},
    "volts": {"v": 1.0, "mv": 1e-3},
    "v": {"v": 1.0, "mv": 1e-3},
}
"""Ending of a contract column -> unit (small letters) -> factor. A torque in A has its constant as scale."""
BRACKETED = re.compile(r"[\[({]\s*([^\])}]+?)\s*[\])}]\s*$")


_DOTS = str.maketrans(dict.fromkeys("·⋅∙•", " "))


def plain_unit(unit: str) -> str:
    """A unit as `UNITS` has it: in small letters, a product with a blank for its dot."""
    return unit.translate(_DOTS).strip().lower()


def kind_of(column: str) -> str:
    """`radps` of `gyro_radps`: what its units are looked up by."""
    return column if column in UNITS else column.rpartition("_")[2]


def factor(unit: str, column: str, where: str) -> float:
    """The contract's unit of `column` per `unit`; 1 for an empty one. Raises `InputError` naming units it may have."""
    known = UNITS[kind_of(column)]
    if not unit:
        return 1.0
    if plain_unit(unit) not in known:
        close = difflib.get_close_matches(unit.lower(), known, 1, 0.5)
        raise InputError(where, f"{column} cannot be in {unit!r}",
                         f"did you mean {close[0]!r}?" if close else f"it may be in {', '.join(filter(None, known))}")
    return known[plain_unit(unit)]


def si_unit(column: str) -> str:
    """The contract's unit of `column`, for a person."""
    kind = kind_of(column)
    return {"nm": "N m", "n": "N", "v": "V"}.get(kind, next(iter(UNITS[kind])))


def unit_in_name(name: str, column: str) -> str:
    """The unit that a file's own name for `column` states: `knee angle [deg]`, `q2_deg`, `t (ms)`, `iq_A`; else empty.

    Of single letters only A, g and s are units; others number axes and motors.
    """
    known = UNITS[kind_of(column)]
    match = BRACKETED.search(name)
    if match:
        return match[1] if plain_unit(match[1]) in known else ""
    last = re.split(r"[_\s./]", name)[-1]
    return last if plain_unit(last) in known and (len(last) > 1 or last in "Ags") and last != name else ""
