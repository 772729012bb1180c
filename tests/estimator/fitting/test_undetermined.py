"""What a record cannot determine is named by the command, and no number is printed for it."""

import json
from pathlib import Path

import numpy as np
from numpy.random import default_rng
from pytest import approx, mark
from scipy.integrate import solve_ivp

from daq import Dataset
from daq.runs import write_csv
from estimator import FitOptions, Method, fit
from estimator.fitting import weighted_least_squares
from estimator.fitting.fit import estimate
from estimator.fitting.identifiability import name_directions, undetermined
from estimator.model import leg2
from legid.cli import main
from tests.support.mujoco_leg import Leg, record
from tests.support.prescribed import BETA, arm_run
from tests.support.shell import Shell

LEG, G, N = Leg(), 9.81, 600
TIME = np.arange(N) / 100.0
COUNT = 2 * np.pi / 8192
LEG_RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[imu]\nlever_arm_m = 0.2\n'
JOINT_RIG = '[mechanism]\nmodel = "joint1"\nactuated = [1]\n'
WAYS = [("mle", "imu"), ("mle", "encoder"), ("wls", "imu"), ("wls", "encoder"), ("rls", "encoder"), ("hekf", "imu")]
NAMES = [f"beta{k}" for k in range(1, 10)]


def leg_columns(q: np.ndarray, v: np.ndarray, a: np.ndarray, knee_torque: np.ndarray) -> dict[str, np.ndarray]:
    """A leg whose knee stays at zero, its pivot at q, seen by noisy sensors."""
    rng = default_rng(7)
    return {"q1_rad": COUNT * np.round(q / COUNT + 0.3 * rng.normal(size=N)), "q2_rad": np.zeros(N),
            "tau2_nm": knee_torque + 0.02 * rng.normal(size=N), "gyro_radps": v + 0.005 * rng.normal(size=N),
            "accel_x_mps2": LEG.lever * a + G * np.sin(q) + 0.05 * rng.normal(size=N),
            "accel_y_mps2": -LEG.lever * v**2 - G * np.cos(q) + 0.05 * rng.normal(size=N)}


def at_rest() -> dict[str, np.ndarray]:
    return leg_columns(*(np.zeros(N) for _ in range(4)))


def knee_locked() -> dict[str, np.ndarray]:
    """A compound pendulum that swings out; the knee's motor carries what keeps it straight."""
    b = LEG.beta()
    inertia, moment = b[0] + b[1] + 2 * b[2], G * (b[3] + b[4])

    def rate(_: float, y: np.ndarray) -> list[float]:
        return [y[1], -(moment * np.sin(y[0]) + b[5] * y[1] + b[7] * np.tanh(y[1] / 3e-3)) / inertia]

    q, v = solve_ivp(rate, (0, TIME[-1]), [0.9, 0.0], t_eval=TIME, rtol=1e-8, atol=1e-9, max_step=5e-3).y
    a = np.array([rate(0.0, np.array(y))[1] for y in zip(q, v)])
    return leg_columns(q, v, a, (b[1] + b[2]) * a + G * b[4] * np.sin(q))


def pure_sine() -> dict[str, np.ndarray]:
    """A small sine: acceleration and gravity's torque are the same function of time but for (0.05 rad)^2 / 24."""
    rng, w = default_rng(8), 5.0
    q = 0.05 * np.sin(w * TIME)
    torque = -0.1 * w**2 * q + 0.4 * G * np.sin(q) + 0.05 * 0.05 * w * np.cos(w * TIME)
    return {"q1_rad": q + 1e-5 * rng.normal(size=N), "tau1_nm": torque + 0.01 * rng.normal(size=N)}


def run_fit(tmp_path: Path, columns: dict[str, np.ndarray], rig: str, *options: str) -> tuple[int, dict | None]:
    run, rig_file, js = tmp_path / "run.csv", tmp_path / "rig.toml", tmp_path / "fit.json"
    write_csv(Dataset("run", 100.0, TIME, columns), run)
    rig_file.write_text(rig)
    status = main(["fit", str(run), "--rig", str(rig_file), "--json", str(js), *options])
    return status, json.loads(js.read_text()) if js.exists() else None


def rows_with_numbers(out: str) -> list[str]:
    """Parameters that the printed table gives a number for."""
    rows = [line.split() for line in out.splitlines() if line.startswith("beta")]
    return [row[0] for row in rows if row[0].isalnum() and row[1] != "not"]  # a sentence may begin with a name


@mark.parametrize("method, sensors", WAYS)
def test_a_record_at_rest_determines_nothing(method: Method, sensors: str, tmp_path: Path,
                                             shell: Shell) -> None:
    status, document = run_fit(tmp_path, at_rest(), LEG_RIG, "--method", method, "--sensors", sensors)
    printed = shell.read()
    assert status == 1
    said = printed.err.strip().splitlines()[-1]
    assert "does not determine" in said
    assert all(name in said for name in NAMES)
    assert rows_with_numbers(printed.out) == []
    assert document is None or all(p["value"] is None for p in document["parameters"])


@mark.parametrize("method, sensors", WAYS)
def test_a_knee_that_never_moves(method: Method, sensors: str, tmp_path: Path,
                                 shell: Shell) -> None:
    """Its friction is not seen; its inertia is not told from the upper link's; the passive row has no scale."""
    run_fit(tmp_path, knee_locked(), LEG_RIG, "--method", method, "--sensors", sensors)
    printed = shell.read()
    said = printed.out + printed.err
    for name in ("beta7", "beta9"):
        assert f"not determined by this data: {name}\n" in said or f", {name}" in said
    assert {"beta1", "beta2", "beta3", "beta4", "beta7", "beta9"}.isdisjoint(rows_with_numbers(printed.out))
    combination = next(text for text in said.replace("determine ", ", ").replace("data: ", ", ").replace("\n", ", ")
                       .split(", ") if "beta2" in text and "beta3" in text and "beta1" in text)
    amounts = amounts_of(combination)  # changing so leaves beta2 + beta3 and beta1 + beta2 + 2 beta3 as they are
    scale = amounts["beta2"]
    assert amounts["beta1"] / scale == approx(1.0, abs=0.1)
    assert amounts["beta3"] / scale == approx(-1.0, abs=0.1)


def amounts_of(name: str) -> dict[str, float]:
    lead, *others = name.split()
    parts = [other.partition("*") for other in others]
    return {lead: 1.0, **{parameter: float(amount) for amount, _, parameter in parts}}


@mark.parametrize("method", ["mle", "wls", "rls", "hekf"])
def test_two_collinear_columns(method: Method, tmp_path: Path, shell: Shell) -> None:
    _, document = run_fit(tmp_path, pure_sine(), JOINT_RIG, "--method", method)
    printed = shell.read()
    assert rows_with_numbers(printed.out) == ["beta3", "beta4"]
    assert document is not None
    (combination,) = document["undetermined"]
    assert combination in printed.out
    amounts = amounts_of(combination)
    assert amounts["beta2"] / amounts["beta1"] == approx(5.0**2 / G, rel=0.05)  # -w^2 q against g sin(q)
    assert [p["value"] is None for p in document["parameters"]] == [True, True, False, False]


def test_a_given_parameter_frees_the_other(tmp_path: Path) -> None:
    status, document = run_fit(tmp_path, pure_sine(), JOINT_RIG, "--method", "wls", "--fix", "beta2=0.4")
    assert status == 0
    assert document is not None and document["undetermined"] == []
    assert document["parameters"][0]["value"] == approx(0.1, rel=0.1)


def test_no_model_is_written_with_values_that_mean_nothing(tmp_path: Path, shell: Shell) -> None:
    model = tmp_path / "model.json"
    status, _ = run_fit(tmp_path, knee_locked(), LEG_RIG, "--method", "wls", "--model-out", str(model))
    assert status == 1
    assert not model.exists()
    assert "no model was written: this data does not determine" in shell.err


@mark.parametrize("method, sensors", WAYS[2:])
def test_a_good_record_is_not_accused(method: Method, sensors: str) -> None:
    run = record(LEG, default_rng(5), seconds=4.0)
    assert fit([run], leg2(lever_arm=LEG.lever), FitOptions(sensors=sensors), method).undetermined == ()


def test_names_do_not_depend_on_the_basis_of_the_space() -> None:
    names, scale = ("a", "b", "c"), np.array([1.0, 2.0, 1.0])
    space = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    transposed = space @ np.array([[0.8, -0.6], [0.6, 0.8]])
    for directions in (space, transposed, np.hstack([space, transposed])):
        found = name_directions(names, directions / np.linalg.norm(directions, axis=0), scale)
        assert set(map(str, found)) in ({"a +2*b", "c"}, {"b +0.5*a", "c"})


def test_what_takes_part_and_is_known_all_the_same_keeps_its_value() -> None:
    """Friction that is not seen moves the inertias with it, by coefficients of 0.002, less than their intervals."""
    beta = np.array([0.1, 0.02, 0.03, 0.4, 0.1, 0.02, 0.03, 0.05, 0.04])
    along = np.zeros(9)
    along[[8, 0, 1, 2]] = 1.0, 0.02, -0.02, 0.015  # +- 1 N m of Coulomb friction, and 0.02 kg m^2
    small = np.diag(1e-6 * beta**2)
    found = undetermined(leg2(), beta, small + np.outer(along, along), np.ones(9, dtype=bool))
    assert [str(c) for c in found] == ["beta9"]
    both = undetermined(leg2(), beta, small + 100.0 * np.outer(along, along), np.ones(9, dtype=bool))
    assert {name for c in both for name, _ in c.amounts} == {"beta9", "beta1", "beta2", "beta3"}


def test_a_gravity_term_is_determined_with_inertias_that_are_not() -> None:
    run = arm_run(1, seconds=6.0, torque=1.0, knee=0.2)
    found = estimate([run], leg2(actuated=(0, 1)), FitOptions(sensors="encoder"), "wls")
    assert {"beta1", "beta2", "beta3", "beta7"} == found.open_parameters
    low, high = found.ci95()[3]
    assert low < BETA[3] < high < 2.0 * BETA[3] and low > 0.0


@mark.parametrize("rows", [6, 256, 257, 700, 70_000])
def test_least_squares_piece_by_piece_is_that_of_the_whole(rows: int) -> None:
    rng = default_rng(rows)
    z, beta = rng.normal(size=(rows, 1, 4)), np.array([1.0, -2.0, 0.5, 3.0])
    tau = z @ beta + rng.normal(0.0, 0.1, (rows, 1))
    found, _, sigma = weighted_least_squares(z, tau, np.ones(4, dtype=bool), np.zeros(4), 1.0)
    plain = np.linalg.lstsq(z[:, 0], tau[:, 0], rcond=None)[0]
    assert found == approx(plain, rel=1e-10)
    assert sigma[0] == approx(np.sqrt(np.mean((tau[:, 0] - z[:, 0] @ plain) ** 2)), rel=1e-10)
