"""`prior_table`: the bodies of a URDF or MJCF file as known values for a rig file."""

from __future__ import annotations

import numpy as np

from daq import ASSUMED, comment
from experiments.simulators import Link

SHARE = 0.05
"""Standard deviation that is written for a value of the file, which gives none, as a share of it."""
OFF_LINE = 0.02
"""Distance of a centre of mass from the line between joints, as a share of its length, that is mentioned."""


def prior_table(links: list[Link], source: str) -> str:
    """The table [prior] of a rig file, with what it leaves out as comments."""
    source = comment(source)
    lines = ["", f"[prior]                          # of {source}; {ASSUMED}: standard deviations are {SHARE:.0%}"]
    across = np.eye(3) - np.outer(links[0].axis, links[0].axis)
    for i, link in enumerate(links, 1):
        name = comment(link.name)
        centre = across @ link.centre
        end = across @ links[i].at if i < len(links) else centre
        length = float(np.linalg.norm(end))
        along = end / length if length > 0.0 else end
        lc = float(centre @ along)
        values = {"m": link.mass, "lc": lc, "I": float(link.axis @ link.inertia @ link.axis)}
        values |= {"l": length} if i < len(links) else {}
        for kind, value in values.items():
            lines.append(f"{kind}{i} = [{value:.6g}, {SHARE * abs(value):.2g}]" if value else
                         f"# {kind}{i} is 0 in the file: give it with its standard deviation")
        off = float(np.linalg.norm(centre - lc * along))
        if off > OFF_LINE * max(length, 1e-9):
            lines.append(f"# the centre of mass of {name} is {off:.3g} m off the line between its joints, which "
                         "is left out")
        if length and abs(float(along[2]) + 1.0) > 1e-3:
            lines.append(f"# where the file's angles are zero, {name} points along {np.round(along, 3).tolist()}, "
                         "not down: add that angle as offset under [columns]")
    return "\n".join(lines) + "\n"
