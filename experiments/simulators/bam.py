"""`bam_parameters`: what a model knows of a servo, as BAM's parameter file names it.

BAM (Better Actuator Models, Duclusaud et al., "Extended friction models for the physics simulation of servo actuators",
2024) has, of a servo's motor, kt and R. A model of torques does not know those: they stay as BAM bundles them.
"""

from __future__ import annotations

from daq import InputError
from experiments.models import EffectValue
from experiments.simulators.parts import Parts

SERVOS = ("mx64", "mx106", "xl320", "xl330", "erob80_50", "erob80_100")
"""Actuators of which BAM bundles parameters."""


def bam_parameters(parts: Parts, servo: str) -> dict[str, str | float]:
    """BAM's names to values [N m, rad, s, kg m^2] for the driven joint.

    m1 has Coulomb and viscous friction, m2 Stribeck's, m3 friction by load, m4 both. m5 has friction by the torques of
    motor and load apart: (k + ks exp(-(v/vs)^2)) |(1 - s) tau_m - s tau_e| is k (1 - s), k s and ks (1 - s), ks s in
    BAM's names. Raises `InputError` for a servo that BAM does not bundle, and for friction that no m5 has.
    """
    if servo not in SERVOS:
        raise InputError("--servo", f"{servo!r} is none that BAM bundles", f"name one of {', '.join(SERVOS)}")
    number, joint = next((k, joint) for k, joint in enumerate(parts.joints, 1) if joint.driven)
    effects = {effect.name: effect for effect in parts.model.effects if effect.joint in (None, number)}
    stribeck, load = effects.get("stribeck_friction"), effects.get("load_dependent_friction")
    directional = effects.get("directional_load_friction")
    variant = "m5" if directional is not None else {
        (False, False): "m1", (True, False): "m2", (False, True): "m3", (True, True): "m4"}[
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
    return found | ({} if directional is None else _by_side(directional, stribeck, load))


def _by_side(effect: EffectValue, stribeck: EffectValue | None, load: EffectValue | None
             ) -> dict[str, str | float]:
    """What m5 has beyond m1 and m2."""
    k, near, share = (effect.sizes["load_coefficient"], effect.sizes["coefficient_near_rest"],
                      effect.shapes["load_share"])
    if load is not None or (stribeck is not None and near):
        two = "load_dependent_friction" if load is not None else "stribeck_friction"
        raise InputError("--servo", f"BAM's m5 cannot hold directional_load_friction together with {two}: it has one "
                         "law of load and one Stribeck velocity", "leave out --servo, or one of both effects")
    own = {"friction_stribeck": 0.0, "dtheta_stribeck": effect.shapes["stribeck_velocity"], "alpha": 2.0}
    return {**(own if stribeck is None else {}), "load_friction_motor": k * (1.0 - share),
            "load_friction_external": k * share, "load_friction_motor_stribeck": near * (1.0 - share),
            "load_friction_external_stribeck": near * share}
