"""`tolerance_table`: the table [tolerance] of a rig file with all defaults as comments."""

from __future__ import annotations

from collections.abc import Callable

from estimator.effects import classes
from estimator.score import TORQUE_GAIN, default_tolerances, tolerance_sources


def tolerance_table(line: Callable[[str, str, str], str]) -> list[str]:
    """Lines of the file; `line` makes one of key, value and note."""
    units = {TORQUE_GAIN: "1", **{kind.name: ", ".join(size.unit for size in kind.sizes) for kind in classes()}}
    joint = {kind.name for kind in classes() if kind.per_joint}
    sources = tolerance_sources()
    found = ["[tolerance]                       # 1 sigma of what may be wrong with the rig [SI]. These are the",
             "# defaults, those with a unit of torque for torques up to 1 N m. State what you have measured.",
             "# A value for one joint: joint_stiffness.2 = [0.01, 0.005]. No others: none = true"]
    for name, sizes in default_tolerances().items():
        value = f"{sizes[0]:g}" if len(sizes) == 1 else f"[{', '.join(f'{one:g}' for one in sizes)}]"
        each = ", each joint" if name in joint else ""
        found.append("# " + line(name, value, f"[{units[name]}{each}] {sources[name]}"))
    return found
