"""`Document`, what all JSON documents share."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Self

import msgspec
from msgspec import UNSET, Meta, Struct, UnsetType, structs

from daq import InputError, read_bytes
from estimator import Use
from experiments.console import text_table, write_json
from experiments.provenance import Origin
from experiments.session import SetAside

Number = float | None
"""Null in a file stands for what is not finite."""


Aside = Annotated[tuple[SetAside, ...], Meta(description="runs that were not used: `run`, `why`")]
Damaged = Annotated[tuple[dict[str, str], ...], Meta(description="damaged runs: `run` and `what` is missing")]
Uses = Annotated[tuple[Use, ...], Meta(description="[what the model is good for](docs/trust.md#uses), the best first: "
                                      "`use`, `supported`, `figure`, ...")]
From = Annotated[Origin | UnsetType, Meta(description="[its files](#provenance)")]


def known(value: float) -> Number:
    """The number, None for what is not finite."""
    return float(value) if math.isfinite(value) else None


def finite(value: Number) -> float:
    """The number, NaN for null."""
    return float("nan") if value is None else value


def _cell(x: Any) -> str:
    """A value, or several, as text."""
    if isinstance(x, Struct):
        x = structs.astuple(x)
    if isinstance(x, tuple):
        return ", ".join(map(_cell, x))
    return f"{x:.4g}" if isinstance(x, float) else "" if x is None or x is UNSET else str(x)


class Rows(tuple[Any, ...]):
    """Structs that print as a table."""

    def __str__(self) -> str:
        return text_table(self[0].__struct_fields__, [[*map(_cell, structs.astuple(one))] for one in self])

    __repr__ = __str__


class Document(Struct, kw_only=True):
    """A JSON document: fields are keys, unknown keys of a file are ignored, keys with a default may be missing.

    Its rows print as a table.
    """

    schema: str | UnsetType = UNSET
    """Stands first in a file; a part of a document has none."""

    def __post_init__(self) -> None:
        for name in self.__struct_fields__:
            value = getattr(self, name)
            if isinstance(value, tuple) and value and isinstance(value[0], Struct):
                setattr(self, name, Rows(value))

    @classmethod
    def read(cls, path: Path | str) -> Self:
        """The document in the file `path`. Raises `InputError` for a file that is none of this kind."""
        try:
            return msgspec.json.decode(read_bytes(path), type=cls)
        except msgspec.MsgspecError as error:
            raise InputError(str(path), f"is no such document: {error}", "give one that legid has written") from None

    @property
    def document(self) -> dict[str, Any]:
        """The JSON as a dictionary."""
        found: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(self))
        return found

    def to_json(self, path: Path | str) -> None:
        """Write the document. Raises `InputError` where that place cannot be written."""
        write_json(path, self)
