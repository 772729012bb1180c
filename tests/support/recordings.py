"""A recording of an emulated leg that stands still, on the real clock."""

from pathlib import Path
from typing import Any

import numpy as np

from daq.recording.plan import Plan
from daq.recording.record import record_run
from daq.recording.recorder import RecordReport
from daq.rig import parse_rig
from drivers.leg_controller import LegController
from drivers.lsm9ds1 import ImuConfig, Lsm9ds1
from drivers.mock.plant import StillPlant
from drivers.mock.pty_server import PtyServer
from drivers.mock.rig import MockRig
from drivers.serial_link import SerialLink

RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[devices.controller]\nwatchdog_ms = 100\n[limits]\n'


def sine(seconds: float = 2.0, peak_nm: float = 0.5, step_s: float = 0.01) -> Plan:
    t = np.arange(0.0, seconds, step_s)
    return Plan(t, peak_nm * np.sin(2 * np.pi * t / seconds * 2))


def threaded(path: Path, plan: Plan, progress: Any = None, limits: str = "staleness_s = 2.0\nclock_bound_s = 1.0\n"
             ) -> RecordReport:
    mock = MockRig(StillPlant())
    text = RIG.replace("100", "1000") + limits
    with PtyServer(mock.firmware) as server, LegController(SerialLink(server.path)) as controller:
        controller.open()
        imu = Lsm9ds1(mock.imu, config=ImuConfig(rate_hz=238.0))
        imu.open()
        return record_run(path, parse_rig(text), text, plan, imu, controller, progress=progress)
