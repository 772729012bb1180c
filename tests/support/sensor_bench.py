"""An emulated rig on virtual time and recordings of it; with a sensor at the pivot and a second shunt, too."""

from pathlib import Path
from typing import Any

import pytest

from daq import WorkError, parse_rig
from daq.recording import Plan, RecordReport, Sensors, record_run
from daq.runs import RawRun, read_run
from drivers import As5600, CurrentShunt, LegController, Lsm9ds1, State
from drivers.mock import EmulatorLink, FirmwareSettings, MockRig, PivotSettings, ShuntSettings, VirtualClock
from tests.support.recordings import RIG, sine
from tests.support.still_plant import StillPlant

TABLES = """[devices.pivot]
sign = -1
[devices.shunt]
shunt_ohm = 0.01
kind = "ina228"
[calibration]
pivot_zero_rad = 0.4
[limits]
"""
MAGNET = PivotSettings(zero_rad=-0.4, sign=-1)


class RigBench:
    """Its devices are open; without `imu` it has none."""

    tables = "[limits]\n"
    sensors: Sensors | None = None

    def __init__(self, path: Path, plant: Any = None, imu: bool = True, chips: dict[str, Any] | None = None,
                 **firmware: Any) -> None:
        self.path, self.clock = path, VirtualClock()
        self.mock = MockRig(plant or StillPlant(), self.clock, firmware=FirmwareSettings(**firmware), seed=2,
                            **chips or {})
        self.link = EmulatorLink(self.mock.firmware, self.clock)
        self.controller = LegController(self.link, self.clock.now_ns)
        self.controller.open()
        self.times: dict[str, Any] = {"now_ns": self.clock.now_ns, "sleep": self.clock.sleep}
        self.imu = Lsm9ds1(self.mock.bus, **self.times) if imu else None
        if self.imu is not None:
            self.imu.open()

    def record(self, plan: Plan | None = None, limits: str = "", on_progress: Any = None) -> RecordReport:
        text = RIG.replace("[limits]\n", self.tables) + limits
        return record_run(self.path, parse_rig(text), text, plan or sine(0.8), self.imu, self.controller,
                          self.clock.now_ns, threaded=False, progress=on_progress, sensors=self.sensors)

    def fails(self, plan: Plan | None = None, limits: str = "", on_progress: Any = None) -> tuple[str, RawRun]:
        """One line of the failure with the motor off, and the run that was kept."""
        with pytest.raises(WorkError) as caught:
            self.record(plan, limits, on_progress)
        line = str(caught.value)
        assert "\n" not in line and str(self.path) in line
        self.controller.close()  # brings what is still on the wire
        self.clock.sleep(0.2)
        self.mock.firmware.transmit(self.clock.now_ns())
        assert self.mock.firmware.drive.torque_nm == 0.0
        assert self.mock.firmware.drive.state != State.ARMED
        return line, read_run(self.path)


class SensorBench(RigBench):
    """With a sensor at the pivot and a second shunt."""

    tables = TABLES

    def __init__(self, path: Path, plant: Any = None, imu: bool = True, shunt: ShuntSettings | None = None,
                 magnet: PivotSettings = MAGNET, **firmware: Any) -> None:
        chips = {"pivot": magnet, "shunt": shunt or ShuntSettings(), "shunt_kind": "ina228"}
        super().__init__(path, plant, imu, chips, **firmware)
        self.pivot = As5600(self.mock.bus, **self.times)
        self.shunt = CurrentShunt(self.mock.bus, "ina228", 0.01, 200.0, **self.times)
        self.pivot.open()
        self.shunt.open()
        self.sensors = Sensors(self.pivot, self.shunt)
