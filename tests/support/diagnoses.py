"""A diagnosis made up, with everything that a report may show."""

import numpy as np

from estimator import Diagnosis, TorqueError, Use
from estimator.diagnosis import (
    BudgetRow,
    CandidateScore,
    Cause,
    Remainder,
    Rotation,
    SensorGain,
    Signature,
    Trace,
)
from estimator.verdicts import SizeEstimate

NAMES = tuple(f"beta{k}" for k in range(1, 10))


def signature(title: str, height: float) -> Signature:
    x = np.linspace(-2.0, 2.0, 24)
    curve = height * np.exp(-((x / 0.4) ** 2)) * np.sign(x)
    return Signature(title, "velocity of joint 2 [rad/s]", "torque of joint 2 [N m]", x, curve + 0.002,
                     np.full(24, 0.003), curve, np.full(24, 0.001))


def synthetic() -> Diagnosis:
    """A named cause with everything that a report may show."""
    t = np.arange(2000) / 100.0
    measured = {"q1_rad": 0.3 * np.sin(2 * t), "q2_rad": np.sin(3 * t)}
    before = {name: values + 0.05 * np.sin(t) for name, values in measured.items()}
    after = {name: values + 0.01 * np.sin(t) for name, values in measured.items()}
    ranked = (CandidateScore("stribeck_friction", 2, 9.1, 1e-9, 0.05, 0.01, "N m"),
              CandidateScore("presliding_friction", 2, 5.0, 0.02, 0.02, 0.015, "N m"),
              CandidateScore("rotor_inertia", 2, 1.2, 1.0, 1e-4, 2e-4, "kg m^2"),
              CandidateScore("torque_offset", None, 0.3, 1.0, 1e-3, 0.006, "N m"))
    keys = ("stribeck_friction@2", "presliding_friction@2", "rotor_inertia@2", "torque_offset")
    cosines = np.array([[1.0, 0.82, 0.1, 0.0], [0.82, 1.0, -0.4, 0.0], [0.1, -0.4, 1.0, 0.2], [0.0, 0.0, 0.2, 1.0]])
    return Diagnosis(
        "named", "Friction is higher near standstill: excess torque 0.05 N m [0.04, 0.06].",
        (Cause("stribeck_friction", 2, "friction is higher near standstill than in motion (Stribeck)",
               (SizeEstimate("excess_torque", "N m", 0.05, (0.04, 0.06)),
                SizeEstimate("stribeck_velocity", "rad/s", 0.2, (0.15, 0.25))), 0.004, 83.0,
               ("presliding_friction", "presliding_friction@1")),),
        ranked, ("r4.csv", "r8.csv"),
        {"q1_rad": SensorGain(0.04, 0.01, 0.009), "q2_rad": SensorGain(0.05, 0.02, 0.015)},
        ((0.01, 0.05), (0.01, 0.02)), 0.9, (0.8, 0.97), dict.fromkeys(NAMES, 0.1), dict.fromkeys(NAMES, 0.001),
        dict.fromkeys(NAMES, 0.11), dict.fromkeys(NAMES, 0.002),
        {"torque_gain": "it scales every parameter", "rotor_inertia@1": "no motor", "backlash@1": "no torque"},
        {"fit": ("r1.csv", "r3.csv"), "screen": ("r2.csv",), "confirm": ("r4.csv", "r8.csv")}, ("few runs",),
        "Slow reversals.", (keys, cosines), (signature("stribeck_friction@2", 0.05),
                                             signature("presliding_friction@2", 0.03)),
        (Trace("r4.csv", t, measured, before, after),), wall_s=20.0,
        budget=(BudgetRow("nominal", 1.0, (1.0, 1.0), None, None, 1.0, (1.0, 1.0)),
                BudgetRow("cause", 0.9, (0.8, 0.97), "stribeck_friction", 2, 0.8, (0.7, 0.87)),
                BudgetRow("remainder", 0.1, (0.03, 0.2), None, None, 0.08, (0.02, 0.17)),
                BudgetRow("noise", 0.125, (0.1, 0.2), None, None, 0.12, (0.08, 0.17))),
        uses=(Use("simulation", True, 0.03, horizon_s=20.0, ci95=(0.02, 0.05)),
              Use("feedforward", False, 0.12, ci95=(0.1, 0.15),
                  by_speed=(TorqueError(2, "rest", 0.02, "N m", (0.01, 0.03)),))),
        error=(3.0, 1.2), remainder=Remainder(1, "torque1", "q v"),
        immaterial=(Cause("sensor_time_skew", None, "the IMU is late against encoder and torque",
                          (SizeEstimate("skew", "s", 1e-4, (8e-5, 1.2e-4)),), 1e-9, 40.0, ()),),
        rotations=(Rotation(("r4.csv", "r8.csv"), {"stribeck_friction@2.excess_torque": 0.05}, True),
                   Rotation(("r1.csv", "r3.csv"), {"stribeck_friction@2.excess_torque": 0.0471}, True),
                   Rotation(("r2.csv",), {"stribeck_friction@2.excess_torque": 0.0522}, False)))
