"""`Document`, what all JSON documents share, and the table of its keys."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Self, get_args, get_origin, get_type_hints

import msgspec
from msgspec import UNSET, Meta, Struct, UnsetType

from daq import InputError, read_bytes
from experiments.console import write_json
from experiments.provenance import Origin

Number = float | None
"""Null in a file stands for what is not finite."""


Damaged = Annotated[tuple[dict[str, str], ...], Meta(description="damaged runs: `run` and `what` is missing")]
From = Annotated[Origin | UnsetType, Meta(description="[its files](#provenance)")]


def known(value: float) -> Number:
    """The number, None for what is not finite."""
    return float(value) if math.isfinite(value) else None


def finite(value: Number) -> float:
    """The number, NaN for null."""
    return float("nan") if value is None else value


class Document(Struct, kw_only=True):
    """A JSON document: fields are keys, unknown keys of a file are ignored, keys with a default may be missing."""

    schema: str | UnsetType = UNSET
    """Stands first in a file; a part of a document has none."""

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


def json_schema(kind: type[Struct]) -> dict[str, Any]:
    """JSON Schema of the document `kind`."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema",
            **msgspec.json.schema(kind, schema_hook=lambda other: {"description": "any value"})}


def described(kind: type[Struct]) -> Iterator[tuple[str, str, type[Struct] | None]]:
    """Key, meaning and the struct below it, if any, of the documented fields of `kind`, in their order."""
    keys = dict(zip(kind.__struct_fields__, kind.__struct_encode_fields__))
    for name, hint in get_type_hints(kind, include_extras=True).items():
        if name in keys:
            meaning = next((one.description for one in get_args(hint) if isinstance(one, Meta)), None) or ""
            yield keys[name], meaning, next(_structs(hint), None)


def _structs(hint: object) -> Iterator[type[Struct]]:
    if isinstance(hint, type) and issubclass(hint, Struct) and get_origin(hint) is None:
        yield hint
        return
    for part in get_args(hint):
        yield from _structs(part)


def keys_table(kind: type[Struct]) -> str:
    """Markdown table of the keys of `kind`; keys of structs below stand in their own rows, `runs.rmse`.

    A struct has no rows where it is told above, or where a link in the meaning leads to its keys.
    """
    told: set[type[Struct]] = set()

    def rows(one: type[Struct], before: str) -> Iterator[str]:
        for key, meaning, below in described(one):
            if meaning:
                yield f"| `{before}{key}` | {meaning.replace('](docs/', '](')} |"
            if below is not None and below not in told and "](#" not in meaning:
                told.add(below)
                yield from rows(below, f"{before}{key}.")

    return "\n".join(["| key | meaning |", "| --- | --- |", *rows(kind, "")]) + "\n"
