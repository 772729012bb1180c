"""`legid init --from RUN.csv`: the mechanism that a run's columns belong to."""

from __future__ import annotations

import re
from pathlib import Path

from daq import InputError
from daq.runs import IMU, SUFFIXES, VOLTAGE, commanded, read_csv
from experiments.rig.writer import RigFacts


def is_run(path: Path) -> bool:
    """A CSV by its name."""
    return path.name.lower().endswith(SUFFIXES)


def facts_of_run(path: Path) -> RigFacts:
    """Model, links and driven joints by the columns of a run as CSV; a rig for files alone.

    A joint with a torque, a force or a command is driven. Joints that have a command alone follow it (`servo`). Raises
    `InputError`, for a run without an angle too.
    """
    names = list(read_csv(path).columns)
    angles = {int(m[1]) for name in names if (m := re.fullmatch(r"q(\d+)_(?:rad|m)", name))}
    if not angles:
        raise InputError(str(path), "has no angle of a joint, such as q1_rad",
                         "import it first: legid import FILE --out runs/")
    follows = commanded(names)
    torques = {int(m[1]) for name in names if (m := re.fullmatch(r"tau(\d+)_nm?", name))}
    volts = bool({"duty", VOLTAGE} & set(names))
    links = max(max(angles), 2 if set(IMU) <= set(names) else 1)
    driven = tuple(sorted({*torques, *follows, *((1,) if volts and links == 1 else ())}))
    leg = links == 2 and driven != (1,)  # its pivot has no motor
    model = "joint1" if links == 1 else "leg2" if leg else "chain"
    return RigFacts(model=model, links=links, actuated=driven, records=False, servo=bool(follows),
                    voltage=volts and links == 1,
                    known=frozenset({"model", "links", *(() if set(IMU) & set(names) else ("lever_arm_m",))}))
