"""Model files from a parameter vector."""

from pathlib import Path
from typing import Any

from experiments.models import MechanismSettings, Model, ParameterValue, Provenance, build_mechanism, save_model


def write_model(path: Path, beta: list[float], settings: dict[str, Any]) -> Path:
    mechanism_settings = MechanismSettings(**settings)
    parameters = build_mechanism(mechanism_settings).parameters
    assert len(parameters) == len(beta)
    save_model(Model(schema="legid.model/1", mechanism=mechanism_settings, hold="zero", noise={},
                     parameters=tuple(ParameterValue(name=p.name, meaning=p.meaning, unit=p.unit, value=float(b))
                                      for p, b in zip(parameters, beta)),
                     covariance=tuple((0.0,) * len(beta) for _ in beta),
                     provenance=Provenance(runs=(), method="mle", sensors="imu", date="2026-01-01", version="0")), path)
    return path


LEG = {"model": "leg2", "actuated": (2,), "lever_arm_m": 0.2}
LEG_RIG = """[mechanism]
model = "leg2"
actuated = [2]
[imu]
lever_arm_m = 0.2
[limits]
torque_nm = 1.5
speed_radps = 12.0
q1_rad = {q1}
q2_rad = 2.0
"""
"""Its rig file, with limits and a place for that of q1."""
