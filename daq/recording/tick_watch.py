"""`TickWatch`: faults of the controller's clock while a recording goes on, each as one line for the run's events.

`daq.timing.clock_faults` finds the same in the file and says what becomes of the samples.
"""

from __future__ import annotations

from collections import deque

from drivers import Telemetry

WRAP_US = 2**32
STEP_SHARE, STEP_US = 0.5, 200.0
"""A tick is off if it differs from what the sequence says by this share of the period and so much more [us]."""
RATE_S, RATE_SHARE = 2.0, 1e-3
"""The rate over this time [s] may change by so much: a crystal that warms up changes it by 1e-5."""
SLACK_US = 300.0
APART_US, LATE_US = 2e3, 20e3
"""The least wait between a tick and its arrival may fall and rise by this within a window [us]."""
PACE_US, PACE_SHARE = 250e3, 1e-3
"""The ticks a sequence number, over this time [us], may change by this share."""
WINDOW_NS = 500_000_000
QUIET_NS = 1_000_000_000
"""One event a second: a clock that stands still is off at every sample."""


def _signed(difference: int) -> int:
    return (difference + WRAP_US // 2) % WRAP_US - WRAP_US // 2


class TickWatch:
    """Belongs to the thread that polls the controller."""

    def __init__(self, telemetry_hz: float) -> None:
        self._period_us = 1e6 / telemetry_hz
        self._last: Telemetry | None = None
        self._probes: deque[tuple[float, float, float]] = deque(maxlen=400)
        """(host time, tick, round trip) [us], the tick without wraps."""
        self._first_rate: float | None = None
        self._first_pace: float | None = None
        self._paced_us = self._late_us = 0.0
        """Since the window of the pace began: ticks that the sequence asks for, and those beyond them."""
        self._least = self._sound = float("inf")
        self._window_ns = self._said_ns = 0
        self._behind = False
        """The newest probe was before a step of the telemetry."""

    def restart(self) -> None:
        """A new boot: its clock has another zero."""
        self._last, self._first_rate, self._first_pace = None, None, None
        self._paced_us = self._late_us = 0.0
        self._probes.clear()
        self._least = self._sound = float("inf")

    def frame(self, frame: Telemetry, host_ns: int) -> str:
        """A line on the clock by this sample; empty where nothing is wrong."""
        last, self._last = self._last, frame
        if last is None:
            return ""
        ahead = (frame.seq - last.seq) % 65536
        if not 0 < ahead < 32768:
            self._last = last  # repeated, or overtaken by a later one
            return ""
        ticks = _signed(frame.tick_us - last.tick_us)
        off_us = ticks - ahead * self._period_us
        if abs(off_us) > STEP_SHARE * self._period_us + STEP_US:
            self._least, self._sound, self._behind = float("inf"), float("inf"), True
            self._paced_us = self._late_us = 0.0
            return self._say(host_ns, "its tick stands still" if ticks == 0 else
                             f"its tick stepped by {off_us * 1e-3:+.1f} ms in the telemetry")
        return self._paced(ahead * self._period_us, off_us, host_ns) or self._waited(frame, host_ns)

    def _paced(self, due_us: float, off_us: float, host_ns: int) -> str:
        """Whether the tick advances as far a sequence number as in the first window: both count by one clock."""
        self._paced_us += due_us
        self._late_us += off_us
        if self._paced_us < PACE_US:
            return ""
        pace, allowed = self._late_us / self._paced_us, PACE_SHARE + STEP_US / self._paced_us
        self._paced_us = self._late_us = 0.0
        if self._first_pace is None:
            self._first_pace = pace
            return ""
        if abs(pace - self._first_pace) <= allowed:
            return ""
        return self._say(host_ns, f"the rate of the telemetry's tick changed by "
                                  f"{1e6 * (pace - self._first_pace):+.0f} ppm")

    def _waited(self, frame: Telemetry, host_ns: int) -> str:
        """Whether the sample came as long after its tick, by the newest probe, as others did."""
        if not self._probes or self._behind:
            return ""
        host_us, tick, trip = self._probes[-1]
        rate = 1.0 if self._first_rate is None else self._first_rate
        wait = host_ns * 1e-3 - host_us - _signed(frame.tick_us - round(tick) % WRAP_US) / rate
        self._least = min(self._least, wait)
        if host_ns < self._window_ns:
            return ""
        least, self._least, self._window_ns = self._least, float("inf"), host_ns + WINDOW_NS
        if self._sound == float("inf"):
            self._sound = least
            return ""
        if not -APART_US - trip < least - self._sound < LATE_US + trip:
            return self._say(host_ns, f"telemetry and probes differ by {(least - self._sound) * 1e-3:+.1f} ms")
        return ""

    def probe(self, tx_ns: int, rx_ns: int, rx_tick: int, tx_tick: int) -> str:
        """The same of the answer to a clock probe: its times by the host [ns] and its ticks [us]."""
        turnaround, self._behind = (tx_tick - rx_tick) % WRAP_US, False
        host_us, trip = 0.5e-3 * (tx_ns + rx_ns), max((rx_ns - tx_ns) * 1e-3 - turnaround, 0.0)
        if not self._probes:
            self._probes.append((host_us, rx_tick + 0.5 * turnaround, trip))
            return ""
        before_us, before, before_trip = self._probes[-1]
        elapsed = host_us - before_us
        ticks = _signed(round(rx_tick + 0.5 * turnaround - before % WRAP_US))
        rate = self._first_rate
        off_us = ticks - elapsed * (1.0 if rate is None else rate)
        allowed = 0.5 * (trip + before_trip) + (0.02 if rate is None else RATE_SHARE) * elapsed + SLACK_US
        if abs(off_us) > allowed:
            self._probes.clear()
            self._first_rate = None
            self._least = self._sound = float("inf")
        self._probes.append((host_us, before + ticks, trip))
        if abs(off_us) > allowed:
            still = "the probes' tick stands still" if ticks == 0 else f"its tick stepped by {off_us * 1e-3:+.1f} ms"
            return self._say(rx_ns, f"{still} in the probes")
        return self._rated(rx_ns)

    def _rated(self, host_ns: int) -> str:
        """The rate over the last two seconds against the first one that was measured."""
        host_us, tick, trip = self._probes[-1]
        then = next((one for one in self._probes if host_us - one[0] <= RATE_S * 1e6 + 1.0), None)
        if then is None or host_us - then[0] < 0.8 * RATE_S * 1e6:
            return ""
        elapsed = host_us - then[0]
        rate = (tick - then[1]) / elapsed
        if self._first_rate is None:
            self._first_rate = rate
            return ""
        change = rate - self._first_rate
        if abs(change) <= RATE_SHARE + (trip + then[2] + 2.0 * SLACK_US) / elapsed:
            return ""
        self._first_rate = rate
        return self._say(host_ns, f"its rate changed by {1e6 * change:+.0f} ppm")

    def _say(self, host_ns: int, what: str) -> str:
        if host_ns - self._said_ns < QUIET_NS and self._said_ns:
            return ""
        self._said_ns = host_ns
        return f"the controller's clock failed: {what}"
