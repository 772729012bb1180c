"""`model_of_robot`: the links of a robot file as a model that legid simulates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq import InputError
from experiments.models import EffectValue, MechanismSettings, Model, ParameterValue, Provenance, build_mechanism
from experiments.simulators.robot import Link

OFF = 0.02
"""Share of a link's length by which it may miss the downward line at zero angles."""
REACH_RAD = 6.3


def model_of_robot(links: Sequence[Link], settings: MechanismSettings, hold: str, where: str) -> Model:
    """The chain as a model of the rig's mechanism, without uncertainty. Springs and rotors are effects.

    With c, l and I of each link along the downward line: p_ii = I_i + m_i c_i^2 + l_i^2 sum m_k, p_ij = l_i (m_j c_j +
    l_j sum m_k), g_i = m_i c_i + l_i sum m_k, sums over the links beyond. Raises `InputError` for another mechanism.
    """
    mechanism = build_mechanism(settings)
    if len(links) != mechanism.n or settings.prismatic or settings.input == "voltage":
        raise InputError(where, f"has {len(links)} hinges, the rig's {settings.model} {mechanism.n} joints",
                         "give the robot file of this rig")
    lengths = [float(-link.at[2]) for link in links[1:]]
    _require_hanging(links, where)
    masses, centres = np.array([link.mass for link in links]), np.array([-float(link.centre[2]) for link in links])
    inertias = [float(link.axis @ link.inertia @ link.axis) for link in links]
    beyond = [float(masses[i + 1 :].sum()) for i in range(len(links))]
    reach = [*lengths, 0.0]
    known: dict[tuple[str, tuple[int, ...]], float] = {}
    for i, link in enumerate(links):
        moment = masses[i] * centres[i] + beyond[i] * reach[i]
        known["gravity", (i,)] = float(moment)
        known["inertia", (i, i)] = float(inertias[i] + masses[i] * centres[i] ** 2 + beyond[i] * reach[i] ** 2)
        known |= {("inertia", (k, i)): float(reach[k] * moment) for k in range(i)}
        known |= {("viscous", (i,)): link.viscous, ("coulomb", (i,)): link.coulomb, ("rotor", (i,)): link.armature}
    terms = {(p.term, p.at) for p in mechanism.parameters}
    effects = _effects(links, terms)
    count = mechanism.p + sum(len(e.sizes) for e in effects)
    return Model(
        schema="legid.model/1", mechanism=settings, noise={}, hold=hold, effects=effects,
        parameters=tuple(ParameterValue(name=p.name, meaning=p.meaning, unit=p.unit,
                                        value=known.get((p.term, p.at), 0.0)) for p in mechanism.parameters),
        covariance=((None,) * count,) * count, reach=((-REACH_RAD, REACH_RAD),) * mechanism.n,
        provenance=Provenance(runs=(), method="file", sensors="encoder", date="", version=""))


def _effects(links: Sequence[Link], terms: set[tuple[str, tuple[int, ...]]]) -> tuple[EffectValue, ...]:
    """Springs, and the rotors that the mechanism has no parameter for."""
    found = [EffectValue(name="rotor_inertia", joint=j, sizes={"inertia": link.armature})
             for j, link in enumerate(links, 1) if link.armature and ("rotor", (j - 1,)) not in terms]
    found += [EffectValue(name="joint_stiffness", joint=j,
                          sizes={"stiffness": link.stiffness, "preload": link.stiffness * link.rest_rad})
              for j, link in enumerate(links, 1) if link.stiffness]
    return tuple(found)


def _require_hanging(links: Sequence[Link], where: str) -> None:
    """Raises `InputError` where zero angles are not those of a hanging leg."""
    for k, link in enumerate(links):
        end = links[k + 1].at if k + 1 < len(links) else link.centre
        across = end - (end @ link.axis) * link.axis
        length = float(np.linalg.norm(across))
        if length and float(np.linalg.norm(across - np.array([0.0, 0.0, across[2]]))) > OFF * length:
            raise InputError(where, f"at zero angles {link.name} does not hang along -z",
                             "turn its base, or its joints' zeros, so that the leg hangs")
        if length and across[2] > 0.0:
            raise InputError(where, f"at zero angles {link.name} stands upright", "turn its base so that the leg hangs")
