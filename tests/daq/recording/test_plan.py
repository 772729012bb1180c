"""Plans: read, written, refused."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from daq import InputError, parse_rig
from daq.recording import Plan, read_plan, write_plan
from daq.recording.plan import check_gyro, check_plan
from drivers import Hello, ImuConfig, Lsm9ds1


def test_a_plan_reads_back(tmp_path: Path) -> None:
    plan = Plan(np.arange(5.0) * 0.02, np.array([0.0, 0.5, -1.25, 1 / 3, 0.0]))
    write_plan(plan, tmp_path / "p.csv")
    text = (tmp_path / "p.csv").read_text().splitlines()
    assert text[:3] == ["time_s,tau2_cmd_nm", "0.000000000,0", "0.020000000,0.5"]
    again = read_plan(tmp_path / "p.csv")
    np.testing.assert_allclose(again.torque_nm, plan.torque_nm, rtol=1e-9)
    assert again.duration_s == pytest.approx(0.1) and again.peak_nm == 1.25


def test_commands_are_due_from_the_first_on() -> None:
    assert Plan(np.array([3.0, 3.01, 3.5]), np.zeros(3)).offset_ns == [0, 10_000_000, 500_000_000]


@pytest.mark.parametrize("text, said", [
    ("time_s,torque\n0,1\n1,2\n", "column tau2_cmd_nm is missing"),
    ("tau2_cmd_nm\n1\n2\n", "column time_s is missing"),
    ("time_s,tau2_cmd_nm\n0,1\n1,much\n", "line 3, column tau2_cmd_nm: 'much' is not a number"),
    ("time_s,tau2_cmd_nm\n0,1\n0,2\n", "line 3, column time_s: time repeats"),
    ("time_s,tau2_cmd_nm\n0,1\n", "holds 1 samples, at least 2"),
])
def test_a_faulty_plan_is_refused_like_a_run(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "p.csv").write_text(text)
    with pytest.raises(InputError, match=said):
        read_plan(tmp_path / "p.csv")


@pytest.mark.parametrize("time_s, torque", [([0.0], [1.0]), ([0, 1], [1.0]), ([1, 0], [1, 1]),
                                                ([0, 1], [1, np.nan]), ([0, np.inf], [1, 1])])
def test_a_plan_made_in_code_is_checked_too(time_s: list[float], torque: list[float]) -> None:
    with pytest.raises(ValueError):
        Plan(np.array(time_s, float), np.array(torque, float))


RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[limits]\n'


CONTROLLER: Any = SimpleNamespace(hello=Hello(1, 1, 500, 50.0, 2.0, 1000))
"""As far as a plan's check looks."""


@pytest.mark.parametrize("time_s, torque, said", [
    (np.arange(0, 1, 0.01), np.where(np.arange(100) % 20 < 10, 2.0, -2.0), r"changes by 400 N m/s, limits\.slew_nmps"),
    (np.arange(0, 1, 0.5), np.array([1.8, 0.0]), r"changes by 180 N m/s"),  # from zero at the start
    (np.arange(0, 0.1, 0.001), np.minimum(0.4 * np.arange(100), 1.9), r"changes by 190 N m/s"),  # steep, in 1 ms steps
    (np.array([0.0, 55 * 3600.0]), np.array([0.5, 0.5]), r"lasts 396000 s, limits\.duration_s of the rig is 1800 s")])
def test_jumps_and_days_of_torque_are_refused(time_s: np.ndarray, torque: np.ndarray, said: str) -> None:
    with pytest.raises(InputError, match=said):
        check_plan(Plan(time_s, torque), parse_rig(RIG), CONTROLLER)
    check_plan(Plan(time_s, torque), parse_rig(RIG + "slew_nmps = 500.0\nduration_s = 1e6\n"), CONTROLLER)


def test_a_fast_smooth_plan_has_its_own_slope() -> None:
    t = np.arange(0, 2, 0.001)
    plan = Plan(t, 2.0 * np.sin(2 * np.pi * 10 * t))
    assert plan.slew_nmps == pytest.approx(2.0 * 2 * np.pi * 10, rel=0.02)
    check_plan(plan, parse_rig(RIG), CONTROLLER)


def test_a_gyro_that_cannot_show_the_speed_limit_is_refused() -> None:
    def imu(dps: int) -> Lsm9ds1:
        bus: Any = None
        return Lsm9ds1(bus, config=ImuConfig(238.0, 4, dps))

    fast = parse_rig(RIG + "q1_speed_radps = 15.0\n")
    with pytest.raises(InputError, match=r"limits\.q1_speed_radps is 15 rad/s, a gyro of 500 dps shows up to 8\.73"):
        check_gyro(fast, imu(500))
    check_gyro(fast, imu(2000))
    check_gyro(parse_rig(RIG), imu(500))
    check_gyro(fast, None)
