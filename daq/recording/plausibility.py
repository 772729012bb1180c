"""`Plausibility`: whether what the devices say can be true. A frame that arrives proves nothing; what it says may.

Each check gives the time for which it has failed without a break [s]; the supervisor holds that against the check's own
time-out in `[limits]`. Everything is fed from the commanding thread, in order.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.rig import Calibration
from daq.rig_limits import Limits
from daq.si_units import joint_torque
from drivers import Hello, Telemetry

TICK_SLACK = 0.1
"""How far a tick may be off the telemetry period, as a share of it: the protocol says exactly, a late latch is not."""
CLOCK_DRIFT = 0.02
"""How slow the controller's clock may run against the host's; an RC oscillator is within 0.01, a crystal 1e-4."""
ECHO_NM = 1e-3
"""How far the echo of a command may be off it [N m]: both are whole counts of 1e-6 N m, on CAN of 1e-4 or less."""
ECHO_SHARE = 0.4
"""Share of the allowed staleness that a command and its echo may take together."""
FAST_S, SLOW_S = 0.02, 0.25
"""Memory of the two comparisons of torque [s]: a wrong drive shows in the fast one, a dead shunt under a gentle plan in
the slow one."""
STUCK_SHARE = 0.5
"""Share of the band by which the command, or the joint's other angle, moves while a stuck reading stays the same."""
STUCK_STEPS = 1.5
"""An angle that changes by steps may stay the same for one of either sensor's, and a little for noise."""
WINDOW_S = 0.25
"""Two sensors of one joint are compared by how far they say that it turned within this [s]: zeros cancel."""
SCALE_ERROR = 0.05
"""How far their scales may differ."""
ZERO_BANDS = 4.0
"""Since the start they may differ by so many bands, however slowly."""
STUCK_SAMPLES = 10
"""A sensor with noise does not repeat itself so often by chance, whatever the rate."""
GYRO_BIAS, LEAST_BIAS_S = 0.6, 0.5
"""Largest bias of a gyro that nobody has calibrated [rad/s] (the datasheet's typical is 30 dps), and the least time
from which it is told [s]."""
NEAR_S = 0.02
"""Readings of two devices are compared when they are no further apart [s]."""
APART_S = 0.015
"""How far apart in time two readings that came together may have been taken [s], before more is known: a serial
adapter's 16 ms."""
RAIL = 32_700
"""Counts of 16 bits from which on a reading is at its rail."""


class SuspectTimes(NamedTuple):
    """Times for which each check has failed [s]; None: nothing to check it by."""

    controller_age_s: float
    """Since tick and sequence last advanced as the telemetry's period says, or how late the newest frame is."""
    echo_s: float
    torque_s: float
    encoder_s: float
    imu_stuck_s: float | None = None
    imu_rail_s: float | None = None
    pivot_s: float | None = None


class Lasting:
    """Duration for which a condition has held without a break."""

    def __init__(self) -> None:
        self._since_s: float | None = None
        self.lasted_s = 0.0

    def see(self, wrong: bool, time_s: float, begun: bool = False) -> None:
        """Note at `time_s` [s] whether the check fails. A failure counts from the time at which it had `begun`."""
        self._since_s = None if not (wrong or begun) else time_s if self._since_s is None else self._since_s
        self.lasted_s = time_s - self._since_s if wrong and self._since_s is not None else 0.0


class Progress:
    """Liveness of the controller: sequence and tick advance together, and keep up with the host's clock."""

    def __init__(self, telemetry_hz: float, now_ns: int, polled: bool = False) -> None:
        """`polled`: the host asks for each sample and times it, so that only answers that stay away show."""
        self._period_us, self._polled = 1e6 / telemetry_hz, polled
        self._last: Telemetry | None = None
        self._advanced_ns = now_ns
        self._local_us = 0.0
        self._least_us = math.inf
        self.late_s = 0.0
        """How much later than the least late one the newest frame has come [s], by its tick."""

    def see(self, frame: Telemetry, host_ns: int) -> bool:
        """Whether this frame is one that the period makes possible after those before."""
        last, self._last = self._last, frame
        if last is None:
            self._advanced_ns = host_ns
            return True
        ahead, ticks_us = (frame.seq - last.seq) % 65536, (frame.tick_us - last.tick_us) % 2**32
        if not 0 < ahead < 32768:
            self._last = last  # repeated, or overtaken by a later one
            return False
        off_us = abs(ticks_us - ahead * self._period_us)
        if off_us > TICK_SLACK * self._period_us + 1.0 and not self._polled:
            return False
        self._advanced_ns = host_ns
        self._local_us += ticks_us
        late_us = host_ns * 1e-3 - self._local_us
        self._least_us = min(late_us, self._least_us + CLOCK_DRIFT * ticks_us)
        self.late_s = (late_us - self._least_us) * 1e-6
        return True

    def age_s(self, now_ns: int) -> float:
        """Age of what is known of the leg [s]."""
        return max((now_ns - self._advanced_ns) * 1e-9, self.late_s)


class Echo:
    """The torque that the drive says it was asked for is one that it was asked for, of late."""

    def __init__(self, window_s: float) -> None:
        self._window_ns = round(window_s * 1e9)
        self._sent: deque[tuple[int, float]] = deque([(0, 0.0)])
        self.wrong = Lasting()

    def commanded(self, host_ns: int, torque_nm: float) -> None:
        """A torque [N m] went out."""
        self._sent.append((host_ns, torque_nm))

    def see(self, frame: Telemetry, host_ns: int) -> None:
        while len(self._sent) > 1 and self._sent[1][0] < host_ns - self._window_ns:
            self._sent.popleft()  # the one before the window was still asked for when it began
        known = any(abs(frame.torque_cmd_nm - torque) <= ECHO_NM for _, torque in self._sent)
        self.wrong.see(not known, host_ns * 1e-9)


class TorqueAgreement:
    """The shunt sees the torque that the drive was asked for, within a band; see FAST_S."""

    def __init__(self, limits: Limits, calibration: Calibration, telemetry_hz: float) -> None:
        self._band, self._share, self._calibration = limits.torque_band_nm, limits.torque_share, calibration
        self._keep = np.exp(-1.0 / (telemetry_hz * np.array([FAST_S, SLOW_S])))
        self._means = np.zeros((3, 2))
        """Of asked², error² and measured times asked, each over FAST_S and SLOW_S."""
        self._before = self._current = self._asked_then = 0.0
        self.wrong = Lasting()

    def see(self, frame: Telemetry, host_ns: int) -> None:
        measured = joint_torque(frame.current_a, self._calibration)
        asked, self._before = 0.5 * (frame.torque_cmd_nm + self._before), frame.torque_cmd_nm
        if math.isnan(measured):
            return  # trips as a reading that failed
        new = np.array([[asked**2], [(measured - asked) ** 2], [measured * asked]])
        self._means += (1.0 - self._keep) * (new - self._means)
        (asked2, slow2), (error2, _), (_, product) = self._means.tolist()
        apart = math.sqrt(error2) > self._band + self._share * math.sqrt(asked2)
        gain = product / slow2 if slow2 > self._band**2 else 1.0
        if frame.current_a != self._current:  # noise moves the last digit of a shunt that lives
            self._current, self._asked_then = frame.current_a, asked
        stuck = abs(asked - self._asked_then) > STUCK_SHARE * self._band
        self.wrong.see(bool(apart or stuck or abs(gain - 1.0) > self._share), host_ns * 1e-9)


class TwoAngles:
    """Two sensors of one joint say that it turned alike."""

    def __init__(self, band_rad: float, drifts: bool = False) -> None:
        """`drifts`: one of them is added up, and its zero means nothing after a while."""
        self._band, self._drifts = band_rad, drifts
        self._seen: deque[tuple[float, float, float]] = deque()
        self._zero: float | None = None
        self._changed = [(math.nan, 0.0), (math.nan, 0.0)]
        """Each reading, and the other one when it became that."""
        self._step = [math.inf, math.inf]
        """The least by which each has changed; one that never did may be a coarse one."""
        self.wrong = Lasting()

    def forget(self) -> None:
        """One of them has jumped, and is known to have."""
        self._seen.clear()
        self._changed = [(math.nan, 0.0), (math.nan, 0.0)]
        self._zero = None
        self.wrong.see(False, 0.0)

    def see(self, time_s: float, first_rad: float, second_rad: float, slack_rad: float = 0.0) -> None:
        """Both angles at `time_s` [s], which may differ by `slack_rad` more; one that is NaN says nothing."""
        if math.isnan(first_rad) or math.isnan(second_rad):
            return
        self._zero = second_rad - first_rad if self._zero is None else self._zero
        self._seen.append((time_s, first_rad, second_rad))
        while self._seen[0][0] < time_s - WINDOW_S:
            self._seen.popleft()
        _, first, second = self._seen[0]
        turned, other = first_rad - first, second_rad - second
        short = abs(turned - other) - SCALE_ERROR * max(abs(turned), abs(other)) > self._band + slack_rad
        alone, steps = self._alone((first_rad, second_rad)) - slack_rad, STUCK_STEPS * max(self._step)
        stuck = alone > max(STUCK_SHARE * self._band, steps)
        far = abs(second_rad - first_rad - self._zero) > ZERO_BANDS * self._band + SCALE_ERROR * abs(first_rad)
        self.wrong.see(short or stuck or (far and not self._drifts), time_s, alone > steps)

    def look(self, first_rad: float, second_rad: float) -> None:
        """Learn the angles' steps from readings before a comparison is possible."""
        for k, (one, other) in enumerate(((first_rad, second_rad), (second_rad, first_rad))):
            if one == self._changed[k][0] or math.isnan(one):
                continue
            if not math.isnan(self._changed[k][0]):
                self._step[k] = min(self._step[k], abs(one - self._changed[k][0]))
            self._changed[k] = one, other

    def _alone(self, both_rad: tuple[float, float]) -> float:
        """Angle that one has turned since the other last changed [rad]."""
        self.look(*both_rad)
        return max(abs(both_rad[1 - k] - self._changed[k][1]) for k in (0, 1))


class ImuHealth:
    """A gyro and an accelerometer that live: their noise moves the last digit, and they are not at their rails."""

    def __init__(self, rate_hz: float) -> None:
        self._period_s = 1.0 / rate_hz
        self._last: list[tuple[int, ...]] = [(), ()]
        self._same = [0, 0]
        self._railed = 0

    @property
    def stuck_s(self) -> float:
        """Time for which gyro or accelerometer have repeated one reading of all their axes [s]."""
        most = max(self._same)
        return most * self._period_s if most >= STUCK_SAMPLES else 0.0

    @property
    def rail_s(self) -> float:
        """Time for which an axis has been at its rail [s]."""
        return self._railed * self._period_s

    def see(self, raw: NDArray[np.int16]) -> None:
        """Samples (n, 6), oldest first."""
        for row in raw.tolist():
            for k, now in enumerate((tuple(row[:3]), tuple(row[3:]))):
                self._same[k] = self._same[k] + 1 if now == self._last[k] else 0
                self._last[k] = now
            self._railed = self._railed + 1 if max(map(abs, row)) >= RAIL else 0


class Plausibility:
    """All checks of one recording. `imu_hz`: the IMU's nominal rate; None without one."""

    def __init__(self, limits: Limits, calibration: Calibration, hello: Hello, imu_hz: float | None,
                 now_ns: int, polled: bool = False) -> None:
        self._progress = Progress(hello.telemetry_hz, now_ns, polled)
        self._echo = Echo(ECHO_SHARE * limits.staleness_s)
        self._torque = TorqueAgreement(limits, calibration, hello.telemetry_hz)
        self._encoder = TwoAngles(limits.encoder_band_rad)
        self._imu = ImuHealth(imu_hz) if imu_hz else None
        self._pivot = TwoAngles(limits.pivot_band_rad, drifts=True)
        self._trip_s = APART_S
        self._periods_s = 1.0 / hello.telemetry_hz + (1.0 / imu_hz if imu_hz else 0.0)
        self._halls: deque[tuple[int, float]] = deque(maxlen=64)
        self._own_pivot = False
        self._armed = False
        self._bias = 0.0
        self._turned: tuple[int, float] | None = None
        self._speeds: deque[tuple[float, float]] = deque()
        self._bias_from: tuple[float, float] | None = None

    def commanded(self, host_ns: int, torque_nm: float) -> None:
        """A torque [N m] was asked for."""
        self._echo.commanded(host_ns, torque_nm)

    def frame(self, frame: Telemetry, host_ns: int) -> None:
        """Telemetry as it came; what is no progress is not looked at further."""
        if not self._progress.see(frame, host_ns):
            return
        self._echo.see(frame, host_ns)
        self._torque.see(frame, host_ns)
        self._encoder.see(host_ns * 1e-9, frame.knee_rad, frame.knee_hall_rad)
        if not self._own_pivot:
            self._halls.append((host_ns, frame.pivot_hall_rad))

    def pivot(self, host_ns: int, angle_rad: float) -> None:
        """The angle of a pivot sensor [rad], which from now on stands for the controller's Hall angle."""
        if not self._own_pivot:
            self._own_pivot = True
            self._halls.clear()
            self._bias_from = None
        self._halls.append((host_ns, angle_rad))

    def batch(self, raw: NDArray[np.int16], turned_rad: float, host_ns: int, gap: bool) -> None:
        """Samples (n, 6) of the IMU, behind a gap or not, and the angle by which its gyro says that link 1 has turned
        until then [rad]."""
        assert self._imu is not None
        self._imu.see(raw)
        if gap:
            self._pivot.forget()
        if not self._halls:
            return
        if self._turned is not None and host_ns > self._turned[0]:
            speed = abs(turned_rad - self._turned[1]) / (host_ns - self._turned[0]) * 1e9
            self._speeds.append((host_ns * 1e-9, speed))
        self._turned = host_ns, turned_rad
        near_ns, hall = min(self._halls, key=lambda seen: abs(seen[0] - host_ns))
        if math.isnan(hall) or abs(near_ns - host_ns) > NEAR_S * 1e9:
            return
        apart, time_s = turned_rad - hall, host_ns * 1e-9
        since_s, then = self._bias_from = self._bias_from or (time_s, apart)
        if not self._armed:  # the gyro's bias, as the pivot's Hall angle shows it while the motor waits
            span_s = time_s - since_s
            bias = (apart - then) / span_s if span_s > LEAST_BIAS_S else 0.0
            self._pivot.look(turned_rad, hall)
            self._bias = max(-GYRO_BIAS, min(GYRO_BIAS, bias))
            return
        turned_rad -= self._bias * (time_s - since_s)
        apart_s = min(APART_S, self._trip_s + self._progress.late_s)
        self._pivot.see(time_s, turned_rad, hall, apart_s * self._fastest(time_s))

    def _fastest(self, time_s: float) -> float:
        """Highest speed of the pivot over the window, by the gyro [rad/s]."""
        while self._speeds and self._speeds[0][0] < time_s - WINDOW_S:
            self._speeds.popleft()
        return max((speed for _, speed in self._speeds), default=0.0)

    def arm(self, trip_s: float = APART_S) -> None:
        """Start the checks of a driven motor; `trip_s`: the link's shortest round trip [s].

        No frame without delay takes longer.
        """
        self._armed = True
        self._pivot.forget()
        self._trip_s = trip_s + self._periods_s

    def suspects(self, now_ns: int) -> SuspectTimes:
        """Time for which each check has failed."""
        times = SuspectTimes(self._progress.age_s(now_ns), self._echo.wrong.lasted_s, self._torque.wrong.lasted_s,
                       self._encoder.wrong.lasted_s)
        if self._imu is None:
            return times
        return times._replace(imu_stuck_s=self._imu.stuck_s, imu_rail_s=self._imu.rail_s,
                              pivot_s=self._pivot.wrong.lasted_s)
