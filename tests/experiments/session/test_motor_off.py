"""A servo that is switched off: its terminals are open, so that its back-EMF does not brake as at 0 V."""

import math

import numpy as np
import pytest

import legid
from daq import Dataset, parse_rig
from experiments.session import driven
from tests.support.runs import with_columns, without

RIG = '[mechanism]\nmodel = "joint1"\nactuated = [1]\ninput = "voltage"\n[tolerance]\nnone = true\n'
INERTIA, MOMENT, VISCOUS, COULOMB, K, R, VOLTS = 0.005, 0.05, 0.002, 0.01, 0.3, 3.0, 7.4
TRUE = R / K * np.array([INERTIA, MOMENT, VISCOUS + K**2 / R, COULOMB])
"""Parameters in volts, back-EMF in the viscous one"""


def recorded(seed: int, seconds: float = 8.0, step: float = 1e-3) -> Dataset:
    """A pendulum on a motor that is off for two seconds from 3 s on, where the register of its duty is 0."""
    rng = np.random.default_rng(seed)
    phases, count = rng.uniform(0.0, 6.0, 3), int(seconds / step)
    q, v, rows = 0.0, 0.0, []
    for k in range(count):
        t = k * step
        on = not 3.0 <= t < 5.0
        duty = 0.25 * sum(math.sin(2.0 * math.pi * f * t + p) for f, p in zip((0.4, 0.9, 1.7), phases)) if on else 0.0
        if k % 10 == 0:
            rows.append((t, q, duty, VOLTS, float(on)))
        torque = K / R * (duty * VOLTS - K * v) if on else 0.0
        v += step / INERTIA * (torque - MOMENT * 9.81 * math.sin(q) - VISCOUS * v - COULOMB * math.tanh(v / 0.01))
        q += step * v
    time, angle, *others = np.array(rows).T
    angle = angle + rng.normal(0.0, 4e-4, angle.size)
    columns = dict(zip(("q1_rad", "duty", "volts", "torque_enable"), (angle, *others)))
    return Dataset(f"run{seed}", 1.0 / (10 * step), time, columns)


def test_an_open_motor_does_not_brake() -> None:
    runs = [recorded(seed) for seed in (1, 2, 3)]
    rig = parse_rig(RIG)
    known, unknown = legid.fit(runs, rig), legid.fit([without(run, "torque_enable") for run in runs], rig)
    assert known.beta == pytest.approx(TRUE, rel=0.01)
    assert unknown.beta[3] < 0.5 * TRUE[3]  # an open motor taken for one at 0 V swings on without friction
    assert unknown.document["noise"]["torque_nm"] > 10.0 * known.document["noise"]["torque_nm"]
    assert any("run1 has its motor off for 2 s by torque_enable" in text for text in known.document["warnings"])
    assert any("run1 has duty 0 for 2 s from 3 s on while the joint moves" in text
               for text in unknown.document["warnings"])


def test_a_motor_that_is_off_has_no_voltage_and_a_command_does_nothing() -> None:
    run = recorded(1)
    run = with_columns(run, q1_cmd_rad=np.sin(run.time_s))
    off = run["torque_enable"] < 0.5
    found = driven(run, parse_rig(RIG))
    for name in ("duty", "voltage1_v", "q1_cmd_rad"):
        assert np.array_equal(np.isnan(found[name]), off)
    assert len(driven(found, parse_rig(RIG)).flags) == 1  # said once
    law = driven(without(run, "duty", "volts"), parse_rig(
        '[mechanism]\nmodel = "joint1"\nactuated = [1]\n[servo]\ngain = 4.0\n'))
    assert np.array_equal(np.isnan(law["tau1_nm"]), off)


@pytest.mark.parametrize("still", [True, False])
def test_duty_zero_is_asked_about_only_where_the_joint_moves_for_a_while(still: bool) -> None:
    time = np.arange(400) / 100.0
    duty = np.where((time > 1.0) & (time < (3.0 if still else 1.1)), 0.0, 0.2)
    angle = np.where(duty == 0.0, 0.0, np.sin(time)) if still else np.sin(5.0 * time)
    run = Dataset("run", 100.0, time, {"q1_rad": angle, "duty": duty, "volts": np.full(400, 7.4)})
    assert driven(run, parse_rig(RIG)).flags == ()
