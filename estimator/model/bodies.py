"""Rigid parameters as sums of products of body values: of link i its mass m, the distance lc from its joint to its
centre of mass, its inertia I about that, and its length l from joint to joint.

    p_ii = I_i + m_i lc_i^2 + l_i^2 sum_k m_k,  p_ij = m_j l_i lc_j + l_i l_j sum_k m_k,  g_i = m_i lc_i + l_i sum_k m_k

The first and the last sum go over the links k that link i carries, the middle one over those that link j carries.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from itertools import groupby

import numpy as np

from daq import FloatArray
from estimator.model.mechanism import Mechanism, Parameter

KNOWN = ("leg2", "biped3", "joint1", "chain")
"""Mechanisms whose links are such bodies."""
MOST_MASSES = 3
"""Masses that a formula adds up in full."""
Product = tuple[str, ...]
"""Body values that are multiplied."""


def carried(mechanism: Mechanism, link: int) -> tuple[int, ...]:
    """0-based links that hang from the end of a link, directly or not."""
    return tuple(sorted(p.at[1] for p in mechanism.parameters
                        if p.term == "inertia" and p.at[0] == link and p.at[1] > link))


def parent_of(mechanism: Mechanism, link: int) -> int | None:
    """0-based link from whose end a link hangs; None from the pivot."""
    return max((i for i in range(link) if link in carried(mechanism, i)), default=None)


def has_bodies(mechanism: Mechanism) -> bool:
    """Whether its rigid parameters are those of bodies, in units of mass."""
    return mechanism.name in KNOWN and mechanism.length_unit == "rad" and mechanism.force_unit == "N m"


def products(mechanism: Mechanism, k: int) -> tuple[Product, ...]:
    """The products whose sum is rigid parameter `k`, as the formula has them; without the g that some have."""
    term, at = mechanism.parameters[k].term, mechanism.parameters[k].at
    i, j = at[0], at[-1]
    masses = [f"m{x + 1}" for x in carried(mechanism, j)]
    if term == "gravity":
        return ((f"m{i + 1}", f"lc{i + 1}"), *((m, f"l{i + 1}") for m in masses))
    if i == j:
        return ((f"I{i + 1}",), (f"m{i + 1}", f"lc{i + 1}", f"lc{i + 1}"),
                *((m, f"l{i + 1}", f"l{i + 1}") for m in masses))
    return ((f"m{j + 1}", f"l{i + 1}", f"lc{j + 1}"), *((m, f"l{i + 1}", f"l{j + 1}") for m in masses))


def formula(mechanism: Mechanism, k: int) -> str:
    """Rigid parameter `k` in body values: "I1 + m1*lc1^2 + m2*l1^2"."""
    found, text = products(mechanism, k), []
    for tail, group in groupby(found, key=lambda product: product[1:]):
        heads = [product[0] for product in group]
        head = heads[0] if len(heads) == 1 else \
            f"({' + '.join(heads if len(heads) <= MOST_MASSES else [heads[0], '...', heads[-1]])})"
        text.append("*".join([head, *(name + ("" if (count := len(list(same))) == 1 else f"^{count}")
                                      for name, same in groupby(tail))]))
    whole = " + ".join(text)
    return f"g*({whole})" if _in_torque(mechanism.parameters[k]) else whole


def _in_torque(parameter: Parameter) -> bool:
    """Whether g is inside a gravity parameter."""
    return parameter.term == "gravity" and parameter.unit == "N m"


@cache
def body_names(links: int) -> tuple[str, ...]:
    """m1, lc1, I1, l1, m2, ... of so many links."""
    return tuple(f"{kind}{i + 1}" for i in range(links) for kind in ("m", "lc", "I", "l"))


def body_values(mechanism: Mechanism) -> tuple[str, ...]:
    """Names of the body values on which the rigid parameters depend; empty where there are none."""
    if not has_bodies(mechanism):
        return ()
    used = {name for k, p in enumerate(mechanism.parameters) if p.rigid
            for product in products(mechanism, k) for name in product}
    return tuple(name for name in body_names(mechanism.n) if name in used)


def rigid_parameters(mechanism: Mechanism, bodies: Mapping[str, float]) -> tuple[FloatArray, FloatArray]:
    """(r,) rigid parameters of a mechanism in its order, and (r, q) their derivatives by the `bodies`, in their order.
    """
    names = list(bodies)
    rigid = [k for k, p in enumerate(mechanism.parameters) if p.rigid]
    value, slope = np.zeros(len(rigid)), np.zeros((len(rigid), len(names)))
    for row, k in enumerate(rigid):
        factor = mechanism.gravity_mps2 if _in_torque(mechanism.parameters[k]) else 1.0
        for product in products(mechanism, k):
            value[row] += factor * float(np.prod([bodies[name] for name in product]))
            for place, name in enumerate(product):
                others = [bodies[other] for at, other in enumerate(product) if at != place]
                slope[row, names.index(name)] += factor * float(np.prod(others))
    return value, slope
