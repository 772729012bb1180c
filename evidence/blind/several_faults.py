"""Families of plants with several faults: the servo's legs of `servo`, with two of ordinary strength, or with ten small
ones that are always there, beside which one may matter.

No real rig is without them: half a millisecond, a milliradian, a per mille of a scale. None of the ten changes a free
run by much; what is hidden beside them is one of `servo`'s effects of ordinary strength. Only that one may be called
material.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from evidence.blind.servo import MAKERS, Plant, Readings, draw, of_case, truth_of, write_plant

TEN = {"joint_stiffness": 0.02, "quadratic_drag": 0.02, "asymmetric_friction": 0.02, "torque_ripple": 0.05,
       "torque_delay": 0.04, "sensor_time_skew": 0.03, "gyro_scale": 0.04, "accelerometer_bias": 0.05,
       "imu_misalignment": 0.03, "encoder_eccentricity": 0.03}
"""Share of `servo`'s ordinary strength that is always there."""
NAMES = tuple(n for n in MAKERS if not n.startswith("outside"))
PAIRS = tuple("+".join(pair) for pair in (
    ("quadratic_drag", "gyro_scale"), ("joint_stiffness", "torque_delay"), ("stribeck_friction", "encoder_offset"),
    ("load_dependent_friction", "sensor_time_skew"), ("torque_ripple", "imu_misalignment"),
    ("friction_drift", "accelerometer_bias"), ("asymmetric_friction", "encoder_eccentricity"),
    ("torque_offset", "gyro_bias"), ("joint_stiffness", "quadratic_drag"), ("gyro_scale", "encoder_offset")))
"""Of another kind each, so that what one adds is not what the other does."""


def together(plants: Sequence[Plant]) -> Plant:
    """One plant with what is wrong with each, of which at most one has a stop, a stand, or friction that drifts."""
    def law(q: np.ndarray, v: np.ndarray, u: float, t: float) -> tuple[float, float]:
        parts = [p.law(q, v, u, t) for p in plants]
        return sum(a for a, _ in parts), sum(b for _, b in parts)

    def logged(columns: Readings) -> None:
        for p in plants:
            p.logged(columns)

    late = {name: sum(p.late_s.get(name, 0.0) for p in plants) for p in plants for name in p.late_s}
    moment = [sum(p.spring[j][0] * p.spring[j][1] for p in plants) for j in range(2)]
    stiff = [sum(p.spring[j][0] for p in plants) for j in range(2)]
    at = [m / k if k else 0.0 for m, k in zip(moment, stiff)]

    def friction_now(t: float) -> float:
        return float(np.prod([p.friction_now(t) for p in plants]))

    return Plant(spring=((stiff[0], at[0]), (stiff[1], at[1])), armature=sum(p.armature for p in plants),
                 limit=sum(p.limit for p in plants), base_n_per_m=sum(p.base_n_per_m for p in plants),
                 friction_now=friction_now, law=law, logged=logged, late_s=late)


def make_case(name: str, seed: int, out: Path, always: Mapping[str, float] = TEN) -> None:
    """As `servo.make_case`, of effects joined by a plus, together with faults that are `always` there; the truth holds
    the effects alone."""
    rng = of_case(name, seed, 7)
    strengths = {n: rng.uniform(0.85, 1.15) for n in name.split("+")}
    hidden = together([MAKERS[n](strength) for n, strength in strengths.items()])
    small = [MAKERS[n](share * rng.uniform(0.7, 1.3)) for n, share in always.items() if n != name]
    plant = together([hidden, *small])
    truth = [one for n, strength in strengths.items() for one in truth_of(n, strength)]
    write_plant(name, seed, out, plant, truth, *draw(rng), rng)
