"""Names that a rig file may give its mechanism, and how many joints each has."""

from __future__ import annotations

from functools import cache

from daq.errors import InputError, did_you_mean

JOINTS = {"leg2": 2, "biped3": 3, "joint1": 1}
"""Of the usual ones, which need no look at the floor above: a recorder then loads none of its mathematics."""
CHAIN = "chain"
"""Has as many joints as the rig file says it has links."""
ENTRY_POINT = "legid.mechanisms"
"""Group of functions that give, by name, the number of joints of mechanisms: what this floor must know of the one
above, which names its function in pyproject.toml."""


@cache
def own_mechanisms() -> dict[str, int]:
    """Name to number of joints of every mechanism but a chain."""
    from importlib.metadata import entry_points

    return {name: count for point in entry_points(group=ENTRY_POINT) for name, count in point.load()().items()}


def joints_of(name: str, links: int) -> int:
    """Number of joints. Raises KeyError where there is no such mechanism."""
    if name == CHAIN:
        return links
    return JOINTS[name] if name in JOINTS else own_mechanisms()[name]


def check_mechanism(name: str, where: str) -> None:
    """Raises `InputError` naming the file `where` if there is no such mechanism."""
    if name in JOINTS or name == CHAIN or name in own_mechanisms():
        return
    known = tuple(dict.fromkeys((*JOINTS, CHAIN, *own_mechanisms())))
    raise InputError(where, f"mechanism.model is {name!r}, and there are {', '.join(known)}{did_you_mean(name, known)}",
                     "see docs/rig.md")
