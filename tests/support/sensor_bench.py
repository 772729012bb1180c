"""An emulated rig on virtual time and recordings of it; with a sensor at the pivot and a second shunt, too."""

from pathlib import Path
from typing import Any

import pytest

from daq import WorkError
from daq.recording import Plan, RecordReport, Sensors
from daq.runs import RawRun, read_run
from drivers import As5600, CurrentShunt, State
from drivers.mock import FirmwareSettings, PivotSettings, ShuntSettings
from tests.support.recordings import RIG, sine
from tests.support.virtual_rig import VirtualRig

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


class RigBench(VirtualRig):
    """Its devices are open; without `imu` it has none."""

    tables = "[limits]\n"
    sensors: Sensors | None = None

    def __init__(self, path: Path, plant: Any = None, imu: bool = True, chips: dict[str, Any] | None = None,
                 **firmware: Any) -> None:
        super().__init__(plant, firmware=FirmwareSettings(**firmware), seed=2, **chips or {})
        self.path, self.has_imu = path, imu
        self.controller.open()
        if imu:
            self.imu.open()

    def record(self, plan: Plan | None = None, limits: str = "", on_progress: Any = None) -> RecordReport:
        return self.save(self.path, RIG.replace("[limits]\n", self.tables) + limits, plan or sine(0.8),
                         imu=self.imu if self.has_imu else None, progress=on_progress, sensors=self.sensors)

    def fails(self, plan: Plan | None = None, limits: str = "", on_progress: Any = None) -> tuple[str, RawRun]:
        """One line of the failure with the motor off, and the run that was kept."""
        with pytest.raises(WorkError) as caught:
            self.record(plan, limits, on_progress)
        line = str(caught.value)
        assert "\n" not in line and str(self.path) in line
        self.controller.close()  # brings what is still on the wire
        self.clock.sleep(0.2)
        self.firmware.transmit(self.clock.now_ns())
        assert self.firmware.drive.torque_nm == 0.0 and self.firmware.drive.state != State.ARMED
        return line, read_run(self.path)


class SensorBench(RigBench):
    """With a sensor at the pivot and a second shunt."""

    tables = TABLES

    def __init__(self, path: Path, plant: Any = None, imu: bool = True, shunt: ShuntSettings | None = None,
                 magnet: PivotSettings = MAGNET, **firmware: Any) -> None:
        chips = {"pivot": magnet, "shunt": shunt or ShuntSettings(), "shunt_kind": "ina228"}
        super().__init__(path, plant, imu, chips, **firmware)
        pivot = As5600(self.mock.bus, **self.times)
        current = CurrentShunt(self.mock.bus, "ina228", 0.01, 200.0, **self.times)
        pivot.open()
        current.open()
        self.sensors = Sensors(pivot, current)
