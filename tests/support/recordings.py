"""A recording of an emulated leg that stands still, on the real clock."""

from pathlib import Path
from typing import Any

import numpy as np

from daq import parse_rig
from daq.recording import Plan, RecordReport, record_run
from drivers import ImuConfig, LegController, Lsm9ds1
from drivers.mock import MockRig, PtyServer
from drivers.serial_link import SerialLink
from tests.support.still_plant import StillPlant, StillState

RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[devices.controller]\nwatchdog_ms = 100\n[limits]\n'


class Turning(StillPlant):
    """A leg that stands, then turns a joint at a constant speed from `at_s` on."""

    def __init__(self, at_s: float, speed_radps: float, joint: int = 2) -> None:
        super().__init__()
        self.t, self.at_s, self.speed, self.joint = 0.0, at_s, speed_radps, f"q{joint}"

    def step(self, dt_s: float, torque_nm: float) -> StillState:
        self.t += dt_s
        moved = max(self.t - self.at_s, 0.0)
        return StillState(**{self.joint: moved * self.speed, f"{self.joint}d": self.speed if moved else 0.0})


def at(seconds: float, act: Any) -> Any:
    """A progress callback that does `act` once, when the plan has come to `seconds`."""
    done: list[float] = []

    def progress(now_s: float, total_s: float) -> None:
        if now_s >= seconds and not done:
            done.append(now_s)
            act()
    return progress


def sine(seconds: float = 2.0, peak_nm: float = 0.5) -> Plan:
    t = np.arange(0.0, seconds, 0.01)
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
