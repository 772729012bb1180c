"""Parts of `legid.diagnosis/1`: names of effects and their joints."""

from __future__ import annotations

WHOLE_RIG = frozenset({"rotor_inertia"})
"""Effects that the library places at a joint and the contract does not."""


def contract_joint(effect: str, joint: int | None) -> int | None:
    """The joint as the contract counts it: null for what belongs to the whole rig."""
    return None if effect in WHOLE_RIG else joint


def split_key(key: str) -> tuple[str, int | None]:
    """(effect, joint from 1 or None) of the estimator's key `effect@joint`."""
    name, _, joint = key.partition("@")
    return name, int(joint) if joint else None
