"""A few cells of the fault matrix (`make faults` fills all of it), and rigs that lack a sensor on purpose."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daq.recording import Plan
from evidence.fault_list import FAULTS
from evidence.faults import TARGET_MS, strike
from tests.support.fault_bench import MOMENTS, TIMES, FaultBench, Outcome

CELLS = [
    ("telemetry repeats one frame", "driving", "limit staleness_s tripped: silence of the leg controller"),
    ("knee encoder stuck", "driving", "limit encoder_s tripped"), ("shunt reversed", "ramp", "limit torque_s tripped"),
    ("echo off by 1.5 N m", "driving", "limit echo_s tripped"),
    ("IMU constant", "driving", "limit imu_stuck_s tripped"),
    ("IMU all 0x00", "driving", "limit pivot_s tripped"), ("IMU all 0xFF", "driving", "limit pivot_s tripped"),
    ("shunt reads zero", "driving", "limit torque_s tripped"),
    ("pivot Hall angle stuck", "ramp", "limit pivot_s tripped"), ("gyro reversed", "driving", "limit pivot_s tripped"),
    ("IMU at its rail", "ramp", "limit q1_speed_radps tripped"),
    ("motor temperature invalid", "driving", "limit temperature_degc tripped: motor temperature in degC cannot be"),
    ("supply voltage invalid", "stopping", "stopped by SIGTERM"),
    ("nothing goes down", "stopping", "stopped by SIGTERM"),
    ("pivot Hall angle invalid", "driving", "limit q1_rad tripped: .* cannot be checked"),
    ("host stands still for 150 ms", "driving", "leg controller: fault latched: watchdog; check the cable .*; "
     "then legid doctor --clear-faults"),
    ("drive says a fault", "driving", "leg controller: fault latched: overcurrent; look for a joint that is blocked"),
]


@pytest.mark.parametrize("fault, moment, said", CELLS)
def test_torque_ends_in_time_and_the_fault_is_named(tmp_path: Path, fault: str, moment: str, said: str) -> None:
    outcome = strike(fault, moment, tmp_path)
    assert outcome.zero_ms <= TARGET_MS, outcome
    assert re.match(said, outcome.said), outcome
    assert outcome.kept.startswith("whole")


def test_an_angle_s_limit_is_passed_by_no_more_than_the_leg_coasts(tmp_path: Path) -> None:
    bench = FaultBench(lambda bench: None, "never", "q2_rad = 2.6\nspeed_radps = 30.0\n")
    bench.plan = Plan(TIMES, np.full(TIMES.size, 1.0))
    step, angles = bench.mock._plant.step, []

    def watched(dt_s: float, torque_nm: float):
        state = step(dt_s, torque_nm)
        angles.append(abs(state.q2))
        return state

    bench.mock._plant.step = watched
    assert bench.run(tmp_path).said.startswith("limit q2_rad tripped: knee angle after stopping")
    assert 2.5 < max(angles) < 2.7  # 2.8 where torque is cut at the limit itself, 4.0 where it begins to fall there


def test_the_matrix_has_its_cells() -> None:
    assert len(FAULTS) * len(MOMENTS) >= 150


def lacks(folder: Path, limits: str, **fields: Any) -> Outcome:
    """A healthy run on a rig whose telemetry never had these readings."""
    bench = FaultBench(lambda bench: None, "never", limits)
    bench.firmware.says = lambda truth: replace(truth, **fields)
    bench.clock.sleep(0.02)
    bench.controller.poll()  # what was under way before
    return bench.run(folder)


NAN = float("nan")


def test_a_healthy_swing_is_driven_to_its_end(tmp_path: Path) -> None:
    assert lacks(tmp_path, "").said.startswith("nothing")


def test_without_a_pivot_sensor_the_imu_keeps_the_limit(tmp_path: Path) -> None:
    for limits, said in (("", "nothing"), ("q1_rad = 0.1\n", "limit q1_rad tripped: pivot angle")):
        assert lacks(tmp_path, limits, pivot_hall_rad=NAN).said.startswith(said)


def test_a_sensor_that_the_rig_never_had_is_given_up_on_purpose_or_refused(tmp_path: Path) -> None:
    given_up = lacks(tmp_path, 'unchecked = ["temperature_degc", "bus_v"]\n', motor_degc=NAN, bus_v=NAN)
    assert given_up.said.startswith("nothing")
    refused = lacks(tmp_path, "", motor_degc=NAN)
    assert refused.said.startswith("limit temperature_degc tripped: motor temperature in degC cannot be checked")
    assert refused.zero_ms == 0.0
