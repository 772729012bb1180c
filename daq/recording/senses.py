"""`Senses`: what the recorder knows of the rig now, from both devices, and whether to believe it."""

from __future__ import annotations

import math

from daq.errors import WorkError
from daq.recording.intake import ControllerIntake, ImuIntake
from daq.recording.plausibility import Plausibility
from daq.recording.sensors import SensorIntakes
from daq.recording.supervisor import Sample, ahead
from daq.rig import Rig
from drivers import Hello, Telemetry

REACT_S = 0.01
"""Delay from a reading to less torque [s]: a turn of supervision, the link twice, the current loop."""
RATE_TOLERANCE = 0.06
"""How far the IMU's rate may be off its nominal one; beyond, somebody else reads its FIFO, or it is another chip."""
GRAVITY_TOLERANCE = 0.25
"""How far the mean acceleration before the start may be off gravity: biases of 0.09 g on each axis, uncalibrated."""


class Senses:
    """Belongs to the commanding thread."""

    def __init__(self, rig: Rig, hello: Hello, leg: ControllerIntake, imu: ImuIntake | None, imu_hz: float,
                 now_ns: int, sensors: SensorIntakes | None = None, polled: bool = False) -> None:
        self._rig, self._leg, self._imu, self._imu_hz = rig, leg, imu, imu_hz
        self._pivot, self._shunt = (sensors.pivot, sensors.shunt) if sensors else (None, None)
        self._plausible = Plausibility(rig.limits, rig.calibration, hello, imu_hz if imu else None, now_ns, polled)
        self.hall_seen = False
        """The pivot's Hall sensor has said something; until then q1 is the IMU's."""
        self.commanded = self._plausible.commanded
        """A torque was asked for: (host time [ns], [N m])."""

    def attend(self) -> None:
        """Look through what has come in."""
        while self._leg.fresh:
            self._plausible.frame(*self._leg.fresh.popleft())
        while self._pivot is not None and self._pivot.fresh:
            self._plausible.pivot(*self._pivot.fresh.popleft())
        while self._imu is not None and self._imu.fresh:
            self._plausible.batch(*self._imu.fresh.popleft())

    def arm(self) -> None:
        """The motor is about to drive. Raises `WorkError` unless everything that is there has been heard, and the
        IMU's first second is one of a leg that waits."""
        if self._leg.telemetry is None:
            raise WorkError("leg controller: shook hands but sends no telemetry; restart it")
        bound_s = self._leg.clock_bound_s()
        if bound_s is None:
            raise WorkError("leg controller: answers no clock probe; restart it")
        if self._pivot is not None and self._pivot.rad is None:
            raise WorkError("pivot sensor: no reading within a second; check its wiring")
        if self._imu is not None:
            check_imu(self._imu, self._imu_hz, self._rig.mechanism.gravity_mps2)
        self._plausible.arm(2.0 * bound_s)

    def sample(self, now_ns: int, torque_cmd_nm: float, unsaved_s: float | None) -> Sample:
        """The rig now, as the supervisor wants it: what cannot be read is NaN, unless the rig file gave it up."""
        limits, telemetry, knee = self._rig.limits, self._leg.telemetry, self._leg.knee()
        speed = self._imu.gyro_radps if self._imu and self._imu.samples else None
        suspects = self._plausible.suspects(now_ns)._asdict()
        found = Sample(
            torque_cmd_nm=torque_cmd_nm, q1_speed_radps=speed, gyro_radps=speed, unsaved_s=unsaved_s,
            imu_age_s=(now_ns - self._imu.heard_ns) * 1e-9 if self._imu else None,
            pivot_age_s=(now_ns - self._pivot.heard_ns) * 1e-9 if self._pivot else None,
            shunt_age_s=(now_ns - self._shunt.heard_ns) * 1e-9 if self._shunt else None,
            clock_bound_s=self._leg.clock_bound_s(), **suspects)
        if telemetry is None or knee is None:
            return found
        q1, (q2, q2_speed) = self._pivot_rad(telemetry), knee
        found = found._replace(
            torque_nm=self._leg.torque_nm(), q2_speed_radps=q2_speed, q1_rad=q1, q2_rad=q2,
            q1_ahead_rad=None if speed is None or q1 is None else ahead(q1, speed, limits.stop_radps2, REACT_S),
            q2_ahead_rad=None if q2_speed is None else ahead(q2, q2_speed, limits.stop_radps2, REACT_S),
            temperature_degc=telemetry.motor_degc, bus_v=telemetry.bus_v)
        given_up = [name for name in limits.unchecked if math.isnan(getattr(found, name) or 0.0)]
        return found._replace(**dict.fromkeys(given_up + ["q1_ahead_rad"] * ("q1_rad" in given_up)))

    def _pivot_rad(self, telemetry: Telemetry) -> float | None:
        """q1 [rad] by the pivot sensor where the rig has one, else by the Hall sensor, else by the IMU. NaN: it is
        lost, or none is there."""
        if self._pivot is not None:
            return self._pivot.rad
        hall = telemetry.pivot_hall_rad
        self.hall_seen = self.hall_seen or math.isfinite(hall)
        if self.hall_seen or self._imu is None:
            return hall
        return self._imu.pivot_rad if self._imu.samples else None  # without a sample the motor is not armed


def check_imu(imu: ImuIntake, nominal_hz: float, gravity_mps2: float) -> None:
    """Raises `WorkError` where the IMU's first second is none of a leg that waits."""
    if not imu.samples:
        raise WorkError("IMU: no sample within a second; power-cycle it")
    allowed = RATE_TOLERANCE + 2.0 / imu.samples  # a count is whole
    if abs(imu.measured_hz / nominal_hz - 1.0) > allowed:
        raise WorkError(f"IMU: {imu.measured_hz:.1f} samples a second, {nominal_hz:g} are set; does another program "
                        "read it?")
    if abs(imu.gravity_mps2 - gravity_mps2) > GRAVITY_TOLERANCE * gravity_mps2:
        raise WorkError(f"IMU: it measures {imu.gravity_mps2:.3g} m/s2 before the start, gravity is {gravity_mps2:g}; "
                        "let the leg hang still, check [devices.imu] accel_range_g and run legid calibrate imu")
