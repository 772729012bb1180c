"""Gains and margins: by hand for one joint, and the loop rings exactly where its margins say."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from experiments.cli import main
from experiments.models.gains import Plant, Tolerances, gains_of, linear_plant, loop_margins
from experiments.models.model_file import load_model
from experiments.models.schema import Model
from tests.support.models import LEG, write_model
from tests.support.mujoco_leg import GRAVITY, Leg, random_leg


def leg_model(folder: Path, leg: Leg) -> Model:
    return load_model(write_model(folder / "m.json", list(leg.beta()), LEG))


def roots(plant: Plant, kp: float, kd: float, delay_s: float, order: int = 12) -> np.ndarray:
    """Poles of the closed loop (order + 4,), the delay as a chain of `order` all-pass sections (Pade's first)."""
    n = len(plant.inertia)
    inverse = np.linalg.inv(plant.inertia)
    a = np.zeros((2 * n + order, 2 * n + order))
    a[:n, n: 2 * n] = np.eye(n)
    a[n: 2 * n, :n], a[n: 2 * n, n: 2 * n] = -inverse @ plant.stiffness, -inverse @ plant.damping
    row = np.zeros(2 * n + order)  # the signal that goes into the next section
    row[plant.joint], row[n + plant.joint] = -kp, -kd
    pole = 2.0 * order / delay_s
    for k in range(order):  # z' = -p z + 2 p u, out = z - u
        a[2 * n + k] = 2.0 * pole * row
        a[2 * n + k, 2 * n + k] -= pole
        row = -row
        row[2 * n + k] += 1.0
    a[n: 2 * n] += np.outer(inverse[:, plant.joint], row)
    return np.linalg.eigvals(a)


def test_feedforward_is_the_leg_s(tmp_path: Path) -> None:
    leg = Leg()
    beta, found = leg.beta(), gains_of(leg_model(tmp_path, leg), "m", Tolerances())
    assert found.joint == 2
    assert found.ks_nm == pytest.approx(leg.coulomb[1]) and found.kv_nms_per_rad == pytest.approx(leg.viscous[1])
    assert found.kg_nm == pytest.approx(leg.m2 * leg.c2 * GRAVITY, rel=1e-6)
    p11, p22, p12 = beta[0], beta[1], beta[2]
    full = np.array([[p11 + p22 + 2 * p12, p22 + p12], [p22 + p12, p22]])
    assert found.ka_nms2_per_rad == pytest.approx(np.linalg.det(full) / full[0, 0])


def test_one_joint_by_hand(tmp_path: Path) -> None:
    """LQR of a double integrator: kP = torque / angle, kD = sqrt((torque / speed)^2 + 2 inertia kP)."""
    settings = {"model": "joint1", "actuated": (1,), "gravity_mps2": 0.0}
    path = write_model(tmp_path / "m.json", [0.02, 0.0, 0.0], settings)
    found = gains_of(load_model(path), "m", Tolerances(0.1, 2.0, 3.0, 0.0))
    assert found.kp_nm_per_rad == pytest.approx(30.0)
    assert found.kd_nms_per_rad == pytest.approx(math.sqrt(1.5**2 + 2 * 0.02 * 30.0))
    assert found.gain_margin == math.inf and found.phase_margin_deg >= 60.0  # an LQR's


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_loop_rings_where_its_margins_say(seed: int, tmp_path: Path) -> None:
    plant = linear_plant(leg_model(tmp_path, random_leg(np.random.default_rng(seed))), "m")
    found = gains_of(load_model(tmp_path / "m.json"), "m", Tolerances(delay_s=0.004))
    kp, kd, late = found.kp_nm_per_rad, found.kd_nms_per_rad, 0.004

    def stable(factor: float, delay_s: float) -> bool:
        return bool(roots(plant, factor * kp, factor * kd, delay_s).real.max() < 0)

    assert stable(1.0, late) and 1.0 < found.gain_margin < 1e3
    assert stable(0.98 * found.gain_margin, late) and not stable(1.02 * found.gain_margin, late)
    assert stable(1.0, late + 0.98 * found.delay_margin_s) and not stable(1.0, late + 1.02 * found.delay_margin_s)
    *_, crossover, _ = loop_margins(plant, kp, kd, late)
    assert math.radians(found.phase_margin_deg) <= crossover * found.delay_margin_s * 1.001


def test_the_gains_hold_the_simulated_leg(tmp_path: Path) -> None:
    """The knee goes to a quarter radian and stays, feedforward of gravity in place, the pivot free to swing."""
    leg = Leg(coulomb=(0.0, 0.0))
    model = leg_model(tmp_path, leg)
    found, plant = gains_of(model, "m", Tolerances()), linear_plant(model, "m")
    goal = np.array([0.0, 0.25])
    hold = plant.stiffness[1] @ goal

    def motion(_: float, x: np.ndarray) -> np.ndarray:
        torque = hold + found.kp_nm_per_rad * (0.25 - x[1]) - found.kd_nms_per_rad * x[3]
        load = np.array([0.0, torque]) - plant.damping @ x[2:] - plant.stiffness @ x[:2]
        return np.concatenate([x[2:], np.linalg.solve(plant.inertia, load)])

    x = solve_ivp(motion, (0.0, 3.0), np.zeros(4), rtol=1e-8, max_step=0.01).y
    assert abs(x[1, -1] - 0.25) < 0.03 and np.abs(x[1]).max() < 0.4


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_model(tmp_path / "m.json", list(Leg().beta()), LEG)
    assert main(["gains", str(path), "--json", str(tmp_path / "g.json")]) == 0
    shown = capsys.readouterr().out
    assert "N m s^2/rad" in shown and "phase margin" in shown
    document = json.loads((tmp_path / "g.json").read_text())
    assert document["schema"] == "legid.gains/1" and document["kp_nm_per_rad"] > 0
    biped = write_model(tmp_path / "b.json", [1.0] * 8, {"model": "biped3", "actuated": (2, 3)})
    for status, words in ((2, [str(biped)]), (2, [str(path), "--angle", "0"]), (2, [str(path), "--delay", "2"]),
                          (1, [str(path), "--delay", "0.5"])):
        assert main(["gains", *words]) == status
        assert capsys.readouterr().err.count("\n") == 1
