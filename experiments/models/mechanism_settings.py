"""The estimator's mechanism from [mechanism] and [terms] of a rig file."""

from __future__ import annotations

from msgspec import structs

from daq import Rig, joint_count
from estimator.model import VELOCITY_SCALE, ImuPlace, Mechanism, builders, settings_of
from experiments.models.schema import ImuSettings, MechanismSettings


def mechanism_settings(rig: Rig, prismatic: bool = False) -> MechanismSettings:
    """The rig's mechanism as it goes into a model file."""
    m, terms = rig.mechanism, rig.terms
    first = rig.imus[0]
    usual = len(rig.imus) == 1 and first.link == 1 and m.model in ("leg2", "joint1")
    imus = () if rig.imu is None or usual else tuple(ImuSettings(link=i.link, lever_arm_m=i.lever_arm_m)
                                                     for i in rig.imus)
    return MechanismSettings(
        model=m.model, actuated=m.actuated, gravity_mps2=m.gravity_mps2, links=joint_count(m), input=m.input,
        prismatic=prismatic, lever_arm_m=first.lever_arm_m if usual else 0.0, imus=imus,
        link_lengths_m=m.link_lengths_m, rotor_inertia=terms.rotor_inertia or (),
        torque_offset=terms.torque_offset or (), encoder_zero=terms.encoder_zero or (),
        friction_velocity_radps=terms.friction_velocity_radps or VELOCITY_SCALE, hips=rig.walker is not None)


def fitted_settings(settings: MechanismSettings, mechanism: Mechanism) -> MechanismSettings:
    """`settings` with the friction smoothing velocities of a fit."""
    speeds = mechanism.velocity_scale
    if isinstance(speeds, tuple) and len(set(speeds)) == 1:
        speeds = speeds[0]
    return structs.replace(settings, friction_velocity_radps=speeds)


def build_mechanism(s: MechanismSettings) -> Mechanism:
    """The estimator's mechanism, joints counted from 0 there. Raises ValueError for settings it cannot have."""
    mechanism = _without_imus(s)
    if not s.imus:
        return mechanism
    if s.prismatic:
        raise ValueError("an IMU on a slide shows no angle: take out the table [[imu]]")
    return mechanism.with_imus(tuple(ImuPlace(i.link - 1, i.lever_arm_m) for i in s.imus), s.link_lengths_m)


def _without_imus(s: MechanismSettings) -> Mechanism:
    """As `build_mechanism`, with the one IMU on link 1 alone.

    Of what is set by default a mechanism is told what its function takes; what somebody declared it has to take.
    """
    if s.model not in builders():
        raise ValueError(f"mechanism.model is {s.model!r}, and there are {', '.join(builders())}")
    takes, build = settings_of(s.model), builders()[s.model]
    actuated, rotors, offsets = (tuple(j - 1 for j in joints)
                                 for joints in (s.actuated, s.rotor_inertia, s.torque_offset))
    n = s.links if "links" in takes else build().n
    if any(j >= n for j in (*actuated, *rotors, *offsets)):
        raise ValueError(f"a joint above {n} is named, {s.model} has {n}")
    speeds = s.friction_velocity_radps
    if isinstance(speeds, tuple) and len(speeds) != n:
        raise ValueError(f"terms.friction_velocity_radps has {len(speeds)} speeds, {s.model} has {n} joints")
    if s.input == "voltage" and "voltage" not in takes:
        raise ValueError(f'input = "voltage" is for joint1, not {s.model}')
    for term, joints in (("rotor_inertia", rotors), ("torque_offset", offsets)):
        if joints and term not in takes:
            raise ValueError(f"terms.{term} is no term of {s.model}")
    told = {"actuated": actuated, "gravity_mps2": s.gravity_mps2, "hips": s.hips, "lever_arm": s.lever_arm_m,
            "links": s.links, "prismatic": s.prismatic, "rotor_inertia": rotors, "torque_offset": offsets,
            "velocity_scale": speeds, "voltage": s.input == "voltage"}
    mechanism = build(**{name: value for name, value in told.items() if name in takes})
    if mechanism.actuated != actuated:
        raise ValueError(f"mechanism.actuated is {list(s.actuated)}, {s.model} is driven at joints "
                         f"{[j + 1 for j in mechanism.actuated]}")
    return mechanism
