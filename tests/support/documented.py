"""The documented JSON documents: their JSON Schema, and the table of their keys."""

from collections.abc import Iterator
from typing import Any, get_args, get_origin, get_type_hints

import msgspec
from msgspec import Meta, Struct

from experiments.documents import (
    ChangeDocument,
    ComparisonDocument,
    DiagnosisDocument,
    Document,
    FitDocument,
    SessionsDocument,
    TuningDocument,
    ValidationDocument,
)

DOCUMENTED: dict[str, type[Document]] = {
    "fit": FitDocument, "diagnosis": DiagnosisDocument, "validation": ValidationDocument,
    "comparison": ComparisonDocument, "change": ChangeDocument, "sessions": SessionsDocument,
    "tuning": TuningDocument}
"""By the name of the verb's result."""


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
