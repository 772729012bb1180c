"""`bam_parameters`: what a model knows of a servo, as BAM's parameter file names it.

BAM (Better Actuator Models, Duclusaud et al., "Extended friction models for the physics simulation of servo actuators",
2024) has, of a servo's motor, kt and R. A model of torques does not know those: they stay as BAM bundles them.
"""

from __future__ import annotations

from daq import InputError
from experiments.simulators.parts import Parts

SERVOS = ("mx64", "mx106", "xl320", "xl330", "erob80_50", "erob80_100")
"""Actuators of which BAM bundles parameters."""


def bam_parameters(parts: Parts, servo: str) -> dict[str, str | float]:
    """BAM's names to values [N m, rad, s, kg m^2] for the driven joint: m1 with Coulomb and viscous friction, m2 with
    Stribeck's, m3 with friction by load, m4 with both. Raises `InputError` for a servo that BAM does not bundle."""
    if servo not in SERVOS:
        raise InputError("--servo", f"{servo!r} is none that BAM bundles", f"name one of {', '.join(SERVOS)}")
    number, joint = next((k, joint) for k, joint in enumerate(parts.joints, 1) if joint.driven)
    effects = {effect.name: effect for effect in parts.model.effects if effect.joint in (None, number)}
    stribeck, load = effects.get("stribeck_friction"), effects.get("load_dependent_friction")
    variant = {(False, False): "m1", (True, False): "m2", (False, True): "m3", (True, True): "m4"}[
        stribeck is not None, load is not None]
    found: dict[str, str | float] = {"model": variant, "actuator": servo, "armature": joint.armature,
                                     "friction_base": joint.coulomb, "friction_viscous": joint.viscous, "q_offset": 0.0}
    if stribeck is not None:
        found |= {"friction_stribeck": stribeck.sizes["excess_torque"],
                  "dtheta_stribeck": stribeck.shapes["stribeck_velocity"], "alpha": stribeck.shapes["exponent"]}
    if load is not None:
        found |= {"load_friction_base": load.sizes["load_coefficient"]}
        if stribeck is not None:
            found |= {"load_friction_stribeck": 0.0}
    return found
