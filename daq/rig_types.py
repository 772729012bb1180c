"""Numbers of a rig.toml. Bounds keep out what no rig is: a slip of units or keys, infinity, NaN; they are far beyond
what any leg has."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

Positive = Annotated[float, Meta(gt=0, le=1e5)]
NonNegative = Annotated[float, Meta(ge=0, le=1e4)]
Length = Annotated[float, Meta(ge=0, le=10.0)]
Angle = Annotated[float, Meta(gt=0, le=12.6)]
"""A limit of two turns [rad]: what is beyond it is given in degrees."""
Seconds = Annotated[float, Meta(gt=0, le=10.0)]
Signed = Annotated[float, Meta(ge=-1e3, le=1e3)]
Address = Annotated[int, Meta(ge=0x08, le=0x77)]
"""On an I2C bus, 7 bits, without the reserved ones."""
Joint = Annotated[int, Meta(ge=1, le=20)]
Vector3 = tuple[Signed, Signed, Signed]
Matrix3 = tuple[Vector3, Vector3, Vector3]
Correlation = Annotated[float, Meta(ge=-1.0, le=1.0)]
IDENTITY3: Matrix3 = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class Table(Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """One table of the file."""
