"""The effects that a diagnosis can name, the library's own and those of installed packages, as a document and text."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any, get_args

from daq import InputError
from estimator.effects import ENTRY_POINT, UNTESTABLE, Effect, PlanKind, Shape, classes

SCHEMA = "legid.effects/1"


def known_effects() -> dict[str, type[Effect]]:
    """Name -> class, in the library's order. Raises `InputError` for a package whose effect cannot be used."""
    try:
        found = classes()
    except (ImportError, AttributeError, SyntaxError) as error:
        raise InputError(f"entry point group {ENTRY_POINT}", f"an installed effect does not load: {error}",
                         "fix or uninstall the package that names it") from None
    known: dict[str, type[Effect]] = {}
    for kind in found:
        if not (isinstance(kind, type) and issubclass(kind, Effect)):
            raise InputError(f"entry point group {ENTRY_POINT}", f"{kind!r} is not an Effect class",
                             "name a class that derives from estimator.effects.Effect")
        if kind.name in known:
            raise InputError(f"entry point group {ENTRY_POINT}", f"two effects are called {kind.name}",
                             "give yours a name of its own")
        strange = set(kind.plans or ()) - set(get_args(PlanKind))
        if strange:
            raise InputError(f"entry point group {ENTRY_POINT}", f"{kind.name} asks for plans of the kind "
                             f"{min(strange)!r}", f"`plans` are of {', '.join(get_args(PlanKind))}")
        known[kind.name] = kind
    return known


def effects_document() -> dict[str, Any]:
    """`legid.effects/1`."""
    return {
        "schema": SCHEMA,
        "effects": [{
            "effect": name, "by_joint": kind.per_joint, "by_motor": kind.per_motor, "meaning": kind.sentence,
            "sizes": [{"name": s.name, "unit": s.unit} for s in kind.sizes],
            "shapes": _shapes(kind.shapes), "behind_a_loop": _shapes(kind.loop_shapes),
            "reference": kind.reference, "experiment": kind.experiment} for name, kind in known_effects().items()],
        "not_testable": [{"effect": name, "why": why} for name, why in UNTESTABLE.items()],
    }


def _shapes(shapes: Sequence[Shape]) -> list[dict[str, Any]]:
    return [{"name": s.name, "unit": s.unit, "tried": list(s.grid)} for s in shapes]


def effects_text() -> str:
    """The same for a terminal."""
    blocks = []
    for name, kind in known_effects().items():
        parts = [(s.name, s.unit) for s in kind.sizes] + [(s.name, s.unit) for s in kind.shapes]
        sizes = ", ".join(f"{part} [{unit}]" for part, unit in parts)
        behind = ", ".join(f"{s.name}, {' or '.join(f'{x:g}' for x in s.grid)}" for s in kind.loop_shapes)
        rows = [("meaning", kind.sentence), ("sizes", sizes), ("behind a loop", behind), ("after", kind.reference),
                ("best shown by", kind.experiment)]
        where = "by joint" if kind.per_joint else "by motor" if kind.per_motor else "whole rig"
        blocks.append("\n".join([f"{name} ({where})", *(_row(label, text) for label, text in rows if text)]))
    untestable = [f"{name}\n{_row('why not', why)}" for name, why in UNTESTABLE.items()]
    return "\n\n".join([*blocks, "Not testable on any rig of this kind:", *untestable])


def _row(label: str, text: str) -> str:
    return textwrap.fill(text, 110, initial_indent=f"  {label + ':':15}", subsequent_indent=" " * 17,
                         break_on_hyphens=False, break_long_words=False)
