"""Outcome of a calibration: words for a person, values for rig.toml."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from daq import Rig, load_rig, set_values, write_file
from estimator import TWO_SIDED
from estimator.score import default_tolerances
from experiments.models import Model, values_of

DIGITS = 6


@dataclass(frozen=True)
class Outcome:
    """One step's result."""

    text: str
    values: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    """Table of rig.toml -> key -> value."""
    warnings: Sequence[str] = ()
    tolerances: Mapping[str, float] = field(default_factory=dict)
    """Effect, or effect.joint, to the standard deviation of what the calibration leaves, the same for all its sizes."""

    def tables(self, rig: Rig) -> dict[str, Mapping[str, object]]:
        """Table of rig.toml -> key -> value: `values`, and tolerances.

        A rig without tolerances (`none = true`) keeps none. What is stated for all joints stays, and with several IMUs
        what would be said of all of them is not.
        """
        own = {} if rig.tolerance.get("none") else {
            name: self._sizes(name) for name, sigma in self.tolerances.items()
            if sigma > 0.0 and not _for_all_joints(rig.tolerance, name) and ("." in name or len(rig.imus) == 1)}
        return {**self.values, **({"tolerance": own} if own else {})}

    def _sizes(self, name: str) -> float | list[float]:
        sigma = rounded(self.tolerances[name])
        count = len(default_tolerances()[name.partition(".")[0]])
        return sigma if count == 1 else [sigma] * count


def rounded(value: float) -> float:
    """`value` with the digits that go into rig.toml."""
    return float(f"{value:.{DIGITS}g}")


def left_by_gravity(rig: Rig) -> float:
    """Standard deviation [rad] of an angle at rest that the accelerometer tells, by the tolerance of its bias."""
    bias = rig.tolerances.get("accelerometer_bias", default_tolerances()["accelerometer_bias"])
    return max(bias, default=0.0) / rig.mechanism.gravity_mps2


def store(outcome: Outcome, rig_path: str, dry_run: bool) -> str:
    """Write the values into the rig file, or with `dry_run` not; returns what was done. Raises `InputError`."""
    tables = outcome.tables(load_rig(rig_path))
    named = [(f"[{table}]", key, value) for table, values in tables.items() for key, value in values.items()]
    if not named:
        return f"{rig_path} left as it is: nothing to write"
    if dry_run:
        return "\n".join([f"{rig_path} left as it is; it would say:",
                          *[f"  {table} {key} = {value}" for table, key, value in named]])
    text = Path(rig_path).read_text(encoding="utf-8")
    write_file(rig_path, set_values(text, tables, rig_path).encode(), changed=True)
    return f"{rig_path}: {', '.join(f'{table} {key}' for table, key, _ in named)} written"


def _for_all_joints(stated: Mapping[str, object], name: str) -> bool:
    effect, _, joint = name.partition(".")
    return bool(joint) and effect in stated and not isinstance(stated[effect], dict)


def friction_of(model: Model) -> dict[str, float]:
    """beta4, beta5 [kg m] and beta8, beta9 [N m] of a leg's model, friction at the upper end of its interval."""
    values = values_of(model)
    found = {name: values[name][0] for name in ("beta4", "beta5")}
    return found | {name: max(values[name][0], 0.0) + TWO_SIDED * values[name][1] for name in ("beta8", "beta9")}
