"""`chain`: the open chain of Fig. 1, of any number of links."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimator.model.bodies import formula
from estimator.model.mechanism import (
    VELOCITY_SCALE,
    Mechanism,
    Speeds,
    extra_parameters,
    friction_parameters,
    tree_parameters,
)


def chain(links: int, *, gravity_mps2: float = 9.81, actuated: tuple[int, ...] | None = None,
          rotor_inertia: tuple[int, ...] = (), torque_offset: tuple[int, ...] = (),
          velocity_scale: Speeds = VELOCITY_SCALE) -> Mechanism:
    """An open chain of `links` links hanging from a pivot, each angle relative to the link before (Fig. 1)."""
    pairs = [(i, i) for i in range(links)] + [(i, j) for i in range(links) for j in range(i + 1, links)]
    names = [f"p{i + 1}{j + 1}" for i, j in pairs] + [f"g{i + 1}" for i in range(links)]
    rigid = tree_parameters(pairs, list(range(links)), names)
    friction = friction_parameters(list(range(links)), [f"joint {j + 1}" for j in range(links)], len(rigid) + 1)
    driven = tuple(range(1, links)) if actuated is None else actuated
    bare = Mechanism("chain", np.tril(np.ones((links, links))),
                     tuple(rigid + friction + extra_parameters(rotor_inertia, torque_offset)),
                     gravity_mps2, driven, gravity_mps2=gravity_mps2, velocity_scale=velocity_scale)
    meant = [p._replace(meaning=f"{p.meaning} = {formula(bare, k)}") if p.rigid else p
             for k, p in enumerate(bare.parameters)]
    return replace(bare, parameters=tuple(meant))
