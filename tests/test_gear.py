"""A gear that twists, by the bench's own two-mass integrator: friction and encoder on the motor, twist behind them."""

from __future__ import annotations

import numpy as np

from daq.dataset import Dataset
from estimator.effects.structure import JointElasticity
from estimator.evidence import begin_afresh, fit_nominal, refit
from estimator.mechanism import leg2
from estimator.options import FitOptions
from estimator.session import open_session
from tests.blind.cases import catalogue, draw_case
from tests.blind.effects import MOTOR_INERTIA
from tests.blind.leg import stack
from tests.blind.measure import RATE_HZ, disturb, read
from tests.blind.physics import integrate

COMPLIANCE = 0.25
COUNT = 800


def test_a_soft_gear_is_found_with_the_friction_of_its_motor() -> None:
    case = next(c for c in catalogue("single", [21]) if c.effects == ("joint_elasticity",))
    drawn = draw_case(case, {"joint_elasticity": COMPLIANCE}, COMPLIANCE)
    grid, rng = np.arange(COUNT) / RATE_HZ, np.random.default_rng(21)
    torque = np.array([plan.at(grid, 0.6) for plan in drawn.torques[:4]])
    plant = {"shaft": 1.0 / COMPLIANCE, "shaft_damping": 0.003, "motor_inertia": MOTOR_INERTIA}
    motion = integrate(stack([drawn.leg] * 4), torque.T, step=1e-3, extra={k: np.full(4, v) for k, v in plant.items()})
    sensors, data = drawn.sensors, []
    for k in range(4):
        columns = read(motion, k, torque[k], {}, sensors)
        columns = disturb(columns, sensors.torque * rng.normal(size=COUNT), sensors, rng)
        time_s = columns.pop("time_s")
        data.append(Dataset(f"r{k + 1}", RATE_HZ, time_s, columns))
    session = open_session(data, leg2(lever_arm=sensors.lever), FitOptions(), sensors.gear)
    nominal = fit_nominal(session)
    gear = JointElasticity(1)
    model = refit(session, begin_afresh(session, nominal), [(gear, np.array([0.1, 0.0, 0.0]))], 40)
    ((compliance, viscous, coulomb),) = model.sizes()
    leg = drawn.leg
    assert abs(compliance - COMPLIANCE) < 0.01 * COMPLIANCE
    assert abs(viscous + model.state.beta[6] - leg.viscous2) < 0.1 * leg.viscous2
    assert abs(coulomb + model.state.beta[8] - leg.coulomb2) < 0.1 * leg.coulomb2
    assert model.state.noise.encoder[1] < sensors.count_rad  # with friction on the link: thirty times as much
