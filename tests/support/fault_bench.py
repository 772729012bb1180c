"""A leg on virtual time that is driven while something goes wrong, and how long its torque outlives that."""

import math
import signal
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from daq import InputError, WorkError
from daq.recording import Plan
from daq.runs import mcap_run, read_run
from drivers import DriverError, ImuConfig
from drivers.mock import VirtualClock
from experiments.emulation.plant import LegPlant
from tests.support.device_faults import FaultyDisk, FaultyI2C, FaultyWire, WireFaults
from tests.support.virtual_rig import VirtualRig

MOMENTS = ("arming", "ramp", "driving", "stopping")
RIG = """[mechanism]
model = "leg2"
actuated = [2]
[imu]
lever_arm_m = 0.2
[devices.imu]
rate_hz = 238.0
[devices.controller]
watchdog_ms = 100
"""
RAMP_AT_S, DRIVING_AT_S, STOPPING_AFTER_S = 0.06, 0.85, 0.02
AT_S = {"ramp": RAMP_AT_S, "driving": DRIVING_AT_S, "stopping": DRIVING_AT_S}
SWING_HZ, PEAK_NM = 1.3, 0.5
AFTER_S = 0.3
TIMES = np.arange(0.0, 1.5, 0.01)
PLAN = Plan(TIMES, PEAK_NM * np.sin(2 * np.pi * SWING_HZ * TIMES))


class Outcome(NamedTuple):
    """How one fault at one moment ended."""

    zero_ms: float
    """From the fault, or from the first torque where that came later, to the last that was asked of the current loop;
    0 where none was any more."""
    said: str
    kept: str
    """What is in the run file."""


class Strikes:
    """A recording on a virtual `clock` in which `fault` strikes once, at `moment`, wherever the recorder reads or
    sends."""

    clock: VirtualClock

    def strike_on(self, fault: Callable[[], None], moment: str, controller: Any, link: Any) -> None:
        """The clock of the fault runs wherever the recorder reads from `link` or arms the `controller`."""
        self.struck_ns = 0
        self._fault, self._moment = fault, moment
        self._due_ns: float = math.inf
        arm, read = controller.arm, link.read

        def on_arm(watchdog_ms: int) -> None:
            arm(watchdog_ms)
            if moment == "arming":
                self._due_ns = self.clock.now_ns()
                self._strike()

        def on_read() -> Any:
            self._strike()
            return read()

        controller.arm, link.read = on_arm, on_read

    def _strike(self) -> None:
        if not self.struck_ns and self.clock.now_ns() >= self._due_ns:
            self.struck_ns = self.clock.now_ns()
            self._fault()

    def _progress(self, now_s: float, total_s: float) -> None:
        if now_s >= AT_S.get(self._moment, math.inf) and self._due_ns == math.inf:
            self._due_ns = self.clock.now_ns()
            if self._moment == "stopping":
                signal.raise_signal(signal.SIGTERM)
                self._due_ns += STOPPING_AFTER_S * 1e9
        self._strike()


class FaultBench(VirtualRig, Strikes):
    """One recording; `fault` strikes once, at `moment`."""

    def __init__(self, fault: Callable[["FaultBench"], None], moment: str, limits: str = "") -> None:
        super().__init__(LegPlant(), seed=4, config=ImuConfig(238.0),
                         wire=FaultyWire(WireFaults(), np.random.default_rng(1)))
        self.chip = self.mock.imu
        self.imu.bus = self.bus = FaultyI2C(self.chip, {})
        self.open()
        self.path = Path()
        self.disk: Any = None
        self.plan = PLAN
        self._limits = limits
        self.strike_on(lambda: fault(self), moment, self.controller, self.link)

    def run(self, folder: Path) -> Outcome:
        """Record, then let the rig run on alone for a while."""
        self.path = folder / f"{self._moment}.mcap"
        self.path.unlink(missing_ok=True)
        said = "nothing: the plan was driven to its end"
        create = mcap_run._create

        def on_this_disk(path: Path) -> Any:
            self.disk = FaultyDisk(create(path))
            return self.disk

        mcap_run._create = on_this_disk
        try:
            self.save(self.path, RIG + "[limits]\n" + self._limits, self.plan, progress=self._progress)
        except (WorkError, DriverError, ZeroDivisionError) as error:
            said = str(error).split("; what was recorded")[0]
        finally:
            mcap_run._create = create
        with suppress(DriverError):
            self.controller.close()
        self.clock.sleep(AFTER_S)
        self.firmware.transmit(self.clock.now_ns())
        return Outcome(self._zero_ms(), said, self._kept())

    def _zero_ms(self) -> float:
        t_ns, commanded, _ = self.firmware.motor.record
        on = t_ns[commanded != 0.0]
        late = on[on >= self.struck_ns]
        if not self.struck_ns or not late.size:
            return 0.0
        first = max(self.struck_ns, int(on[0]))
        return float(late[-1] - first) * 1e-6 + 0.5

    def _kept(self) -> str:
        try:
            raw = read_run(self.path)
        except InputError:
            return "no run any more"
        times_ns = raw.streams["/leg/telemetry"]["host_ns"]
        after_ms = ((int(times_ns[-1]) if times_ns.size else 0) - self.struck_ns) * 1e-6
        return f"{'whole' if raw.complete else 'cut'}, telemetry to {after_ms:+.0f} ms of the fault"
