"""Safety limits: each trips just beyond its bound, is named, and latches."""

import math

import pytest

from daq import Limits
from daq.recording import Supervisor
from daq.recording.supervisor import Sample

LIMITS = Limits(torque_nm=2.0, speed_radps=15.0, q1_rad=1.6, q2_rad=2.6, temperature_degc=70.0, staleness_s=0.1,
                clock_bound_s=0.005)
WITHIN = Sample(torque_nm=-2.0, torque_cmd_nm=2.0, q1_speed_radps=15.0, q2_speed_radps=-15.0, q1_rad=-1.6,
                q2_rad=2.6, temperature_degc=70.0, controller_age_s=0.1, imu_age_s=0.1, clock_bound_s=0.005)
CASES = [("torque_nm", "torque_nm", 2.001), ("torque_nm", "torque_nm", -2.001), ("torque_cmd_nm", "torque_nm", -2.5),
         ("q1_speed_radps", "speed_radps", -15.1), ("q2_speed_radps", "speed_radps", 15.1), ("q1_rad", "q1_rad", -1.61),
         ("q2_rad", "q2_rad", 2.61), ("temperature_degc", "temperature_degc", 70.1),
         ("controller_age_s", "staleness_s", 0.101), ("imu_age_s", "staleness_s", 0.2),
         ("clock_bound_s", "clock_bound_s", 0.0051)]


def test_at_the_bound_nothing_trips_and_cold_is_no_danger() -> None:
    for sample in (WITHIN, WITHIN._replace(temperature_degc=-80.0)):
        assert Supervisor(LIMITS).check(sample) is None


@pytest.mark.parametrize("field, limit, value", CASES)
def test_beyond_it_the_limit_is_named(field: str, limit: str, value: float) -> None:
    trip = Supervisor(LIMITS).check(WITHIN._replace(**{field: value}))
    assert (trip.limit, trip.value, trip.bound) == (limit, value, getattr(LIMITS, limit))
    assert f"limit {limit} tripped" in str(trip)


@pytest.mark.parametrize("field", Sample._fields)
def test_a_reading_that_failed_trips_and_one_that_is_not_there_does_not(field: str) -> None:
    assert Supervisor(LIMITS).check(WITHIN._replace(**{field: math.nan})) is not None
    assert Supervisor(LIMITS).check(WITHIN._replace(**{field: None})) is None


def test_the_first_trip_latches() -> None:
    supervisor = Supervisor(LIMITS)
    first = supervisor.check(WITHIN._replace(q2_rad=3.0))
    assert supervisor.check(WITHIN) is supervisor.check(WITHIN._replace(torque_nm=9.0)) is first
