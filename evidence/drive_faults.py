"""What can go wrong on a leg whose knee a bought drive turns: the rows of the fault matrix that apply to it."""

import math
import signal
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from daq import WorkError, parse_rig
from daq.recording import record_run
from drivers import DriverError, ImuConfig, Lsm9ds1
from evidence.frame import new_folder
from experiments.emulation.plant import LegPlant
from tests.support.device_faults import FaultyI2C, FaultyLink, FaultyWire, WireFaults
from tests.support.drive_bench import DriveBench
from tests.support.fault_bench import PLAN, Strikes

RIG = """[mechanism]
model = "leg2"
actuated = [2]
[imu]
lever_arm_m = 0.2
[motor]
gear_ratio = 50.0
sign = -1
[devices.imu]
rate_hz = 238.0
[devices.controller]
watchdog_ms = 100
[calibration]
torque_constant_nm_per_a = 0.85
[limits]
unchecked = ["encoder_s"]
"""
AFTER_S = 0.4


class DriveFaultBench(DriveBench, Strikes):
    """One recording of a drive on virtual time; `fault` strikes once, at `moment`."""

    def __init__(self, kind: str, fault: "Fault", moment: str, seed: int = 4) -> None:
        super().__init__(kind, LegPlant(), seed)
        self.wire = FaultyLink(self.link, self.clock, FaultyWire(WireFaults(), np.random.default_rng(seed)))
        self.drive._link = self.wire  # type: ignore[attr-defined]
        self.bus = FaultyI2C(self.rig.imu, {})
        self.said = ""
        self.strike_on(lambda: fault(self), moment, self.drive, self.wire)

    def zero_ms(self) -> float:
        """Time [ms] from the fault, or from the first torque where that came later, to the last torque that was asked
        of the motor."""
        imu = Lsm9ds1(self.bus, config=ImuConfig(238.0), now_ns=self.clock.now_ns, sleep=self.clock.sleep)
        with new_folder() as folder:
            try:
                self.drive.open()
                imu.open()
                record_run(folder / "run.mcap", parse_rig(RIG), RIG, PLAN, imu, self.drive, self.clock.now_ns,
                           threaded=False, progress=self._progress)
                self.said = "nothing: the plan was driven to its end"
            except (WorkError, DriverError, ZeroDivisionError) as error:
                self.said = str(error).split("; what was recorded")[0]
        with suppress(DriverError):
            self.drive.close()
        self.clock.sleep(AFTER_S)
        self.far.transmit(self.clock.now_ns())
        t_ns, commanded, _ = self.far.record
        on = t_ns[commanded != 0.0]
        return 1e3 * self.zero_after(max(self.struck_ns, int(on[0]))) if self.struck_ns and on.size else 0.0


Fault = Callable[[DriveFaultBench], None]


def far(**values: Any) -> Fault:
    """An attribute of the emulator."""
    (name, value), = values.items()
    return lambda bench: setattr(bench.far, name, value)


def reads(name: str, change: Callable[[float], float]) -> Fault:
    """A reading of the emulator, changed from now on."""
    def strike(bench: DriveFaultBench) -> None:
        kind = type(bench.far)
        true = getattr(kind, name).fget
        bench.far.__class__ = type(kind.__name__, (kind,), {name: property(lambda self: change(true(self)))})
    return strike


def stuck(name: str) -> Fault:
    """A reading that stays what it was, to the digit."""
    def strike(bench: DriveFaultBench) -> None:
        held = getattr(bench.far, name)
        reads(name, lambda _: held)(bench)
    return strike


def imu_reads(change: Callable[[list[int]], list[int]]) -> Fault:
    def strike(bench: DriveFaultBench) -> None:
        push = bench.rig.imu.push
        bench.rig.imu.push = lambda raw: push(change(list(raw)))  # type: ignore[method-assign]
    return strike


def hangs(bench: DriveFaultBench) -> None:
    """Its processor stands still with the torque that it had; its own watchdog with it."""
    bench.far.alive = False


def nothing_down(bench: DriveFaultBench) -> None:
    bench.wire.write = lambda data: None  # type: ignore[method-assign]


def crash(bench: DriveFaultBench) -> None:
    def crashing() -> Any:
        raise ZeroDivisionError("crashed on purpose")
    bench.drive.poll = crashing  # type: ignore[method-assign]


def killed(bench: DriveFaultBench) -> None:
    """SIGKILL: the host is gone without a word, the bus lives."""
    bench.wire.write = lambda data: None  # type: ignore[method-assign]
    raise DriverError("the host was killed")


FAULTS: dict[str, Fault] = {
    "host killed": killed,
    "cable pulled": lambda bench: bench.wire.unplug(),
    "nothing goes down": nothing_down,
    "link stands still for 300 ms": lambda bench: bench.wire.stall(0.3),
    "drive is cut from its supply": far(powered=False),
    "drive restarts": lambda bench: bench.far.power_cycle(),
    "gate driver fault": far(driver_ok=False),
    "encoder lost": far(encoder_ok=False),
    "supply at 50 V": far(bus_v=50.0),
    "supply at 10 V": far(bus_v=10.0),
    "drive at 120 degC": far(degc=120.0),
    "current reads zero": reads("current_a", lambda i: 0.0),
    "current reversed": reads("current_a", lambda i: -i),
    "current invalid": reads("current_a", lambda i: math.nan),
    "current reads three times": reads("current_a", lambda i: 3 * i),
    "current stuck": stuck("current_a"),
    "motor gives no torque": far(stage_gain=0.0),
    "motor turns the other way": far(stage_gain=-1.0),
    "knee jumps by 3 rad": reads("turns", lambda q: q - 3.0 * 50 / math.tau),
    "knee invalid": reads("turns", lambda q: math.nan),
    "IMU constant": imu_reads(lambda raw: [5] * 6),
    "IMU silent": lambda bench: setattr(bench.rig.imu, "push", lambda raw: None),
    "I2C hangs": lambda bench: bench.rig.imu.fail(110, times=10_000),
    "host stands still for 150 ms": lambda bench: bench.clock.sleep(0.15),
    "reading the drive crashes": crash,
    "Ctrl-C": lambda bench: signal.raise_signal(signal.SIGINT),
}
"""Not here, because only the hard-wired stop ends it: a drive whose processor hangs while its power stage goes on, and
a knee's only encoder that stands still without the drive's own fault."""


def strike(kind: str, name: str, moment: str) -> tuple[float, str]:
    """(time to zero torque [ms], what was said)."""
    bench = DriveFaultBench(kind, FAULTS[name], moment)
    return bench.zero_ms(), bench.said
