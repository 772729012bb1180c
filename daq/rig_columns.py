"""`[columns]` of rig.toml: where a column of a run is in files of other programs, and how its numbers are meant."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from daq.rig_types import Table


class Column(Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Place of a contract column in files of other programs: value = sign * scale * unit * reading + offset."""

    name: str
    """As the file calls it."""
    unit: str = ""
    """Of the file; empty: the contract's own."""
    minus: str = ""
    """Another column of the file that is taken off the reading: an absolute angle becomes a relative one."""
    scale: float = 1.0
    """On top of the unit, a torque constant for one."""
    sign: Literal[1, -1] = 1
    offset: float = 0.0
    """Added at the end, in the contract's unit."""
    delay: float = 0.0
    """How late the reading is stamped [s]."""
    bits: Literal[0, 8, 16, 32] = 0
    """The reading is a register of so many bits that was logged without its sign (two's complement); 0: a number."""
    sign_bit: Annotated[int, Meta(ge=-1, le=31)] = -1
    """The reading is a register whose bit of this number is the sign, the bits below it the magnitude; -1: a number."""
