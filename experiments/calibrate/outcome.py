"""Outcome of a calibration: words for a person, values for rig.toml."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from daq import set_values, write_file
from estimator import TWO_SIDED
from experiments.models import Model, values_of

DIGITS = 6


@dataclass(frozen=True)
class Outcome:
    """One step's result."""

    text: str
    values: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    """Table of rig.toml -> key -> value."""
    warnings: Sequence[str] = ()


def rounded(value: float) -> float:
    """`value` with the digits that go into rig.toml."""
    return float(f"{value:.{DIGITS}g}")


def store(outcome: Outcome, rig_path: str, dry_run: bool) -> str:
    """Write the values into the rig file, or with `dry_run` not; returns what was done. Raises `InputError`."""
    named = [(f"[{table}]", key, value) for table, values in outcome.values.items() for key, value in values.items()]
    if not named:
        return f"{rig_path} left as it is: nothing to write"
    if dry_run:
        return "\n".join([f"{rig_path} left as it is; it would say:",
                          *[f"  {table} {key} = {value}" for table, key, value in named]])
    text = Path(rig_path).read_text(encoding="utf-8")
    write_file(rig_path, set_values(text, outcome.values, rig_path).encode(), changed=True)
    return f"{rig_path}: {', '.join(f'{table} {key}' for table, key, _ in named)} written"


def friction_of(model: Model) -> dict[str, float]:
    """beta4, beta5 [kg m] and beta8, beta9 [N m] of a leg's model, friction at the upper end of its interval."""
    values = values_of(model)
    found = {name: values[name][0] for name in ("beta4", "beta5")}
    return found | {name: max(values[name][0], 0.0) + TWO_SIDED * values[name][1] for name in ("beta8", "beta9")}
