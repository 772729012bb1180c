"""From [mechanism] and [terms] of a rig file to the estimator's mechanism."""

from __future__ import annotations

from msgspec import structs

from daq import Rig, joint_count
from estimator.model import VELOCITY_SCALE, Mechanism, biped3, chain, joint1, leg2
from experiments.models.schema import MechanismSettings


def mechanism_settings(rig: Rig, prismatic: bool = False) -> MechanismSettings:
    """The rig's mechanism as it goes into a model file."""
    m, terms = rig.mechanism, rig.terms
    return MechanismSettings(
        model=m.model, actuated=m.actuated, gravity_mps2=m.gravity_mps2, links=joint_count(m), input=m.input,
        prismatic=prismatic, lever_arm_m=rig.imu.lever_arm_m, rotor_inertia=terms.rotor_inertia or (),
        torque_offset=terms.torque_offset or (),
        friction_velocity_radps=terms.friction_velocity_radps or VELOCITY_SCALE)


def fitted_settings(settings: MechanismSettings, mechanism: Mechanism) -> MechanismSettings:
    """`settings` with the speeds over which a fit rounded friction's sign off."""
    speeds = mechanism.velocity_scale
    if isinstance(speeds, tuple) and len(set(speeds)) == 1:
        speeds = speeds[0]
    return structs.replace(settings, friction_velocity_radps=speeds)


def build_mechanism(s: MechanismSettings) -> Mechanism:
    """The estimator's mechanism, joints counted from 0 there. Raises ValueError for settings it cannot have."""
    actuated, rotors, offsets = (tuple(j - 1 for j in joints)
                                 for joints in (s.actuated, s.rotor_inertia, s.torque_offset))
    n = {"leg2": 2, "biped3": 3, "joint1": 1}.get(s.model, s.links)
    if any(j >= n for j in (*actuated, *rotors, *offsets)):
        raise ValueError(f"a joint above {n} is named, {s.model} has {n}")
    speeds = s.friction_velocity_radps
    if isinstance(speeds, tuple) and len(speeds) != n:
        raise ValueError(f"terms.friction_velocity_radps has {len(speeds)} speeds, {s.model} has {n} joints")
    if s.input == "voltage" and s.model != "joint1":
        raise ValueError(f'input = "voltage" is for joint1, not {s.model}')
    if s.model == "leg2":
        return leg2(gravity_mps2=s.gravity_mps2, lever_arm=s.lever_arm_m, actuated=actuated,
                               rotor_inertia=rotors, torque_offset=offsets,
                               velocity_scale=speeds)
    if s.model == "chain":
        return chain(s.links, gravity_mps2=s.gravity_mps2, actuated=actuated, rotor_inertia=rotors,
                                torque_offset=offsets, velocity_scale=speeds)
    if rotors:
        raise ValueError(f"terms.rotor_inertia cannot be told from the inertia of {s.model}")
    if s.model == "biped3":
        if offsets:
            raise ValueError("terms.torque_offset is not part of biped3")
        return biped3(actuated=actuated, gravity_mps2=s.gravity_mps2)
    return joint1(gravity_mps2=s.gravity_mps2, prismatic=s.prismatic, actuated=actuated,
                             torque_offset=offsets, velocity_scale=speeds,
                             voltage=s.input == "voltage", lever_arm=s.lever_arm_m)
