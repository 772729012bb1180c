"""An emulated rig in real time that other processes open like a real one: its rig file names a port and a bus."""

from __future__ import annotations

import shutil
import tempfile
import threading
from importlib.resources import files
from pathlib import Path

from daq import parse_rig
from daq.recording import write_plan
from drivers import Closing
from drivers.mock import STEP_NS, CanServer, I2cServer, PtyServer, RealClock, drive_facts, on_serial
from experiments.console import make_directory, write_text
from experiments.emulation.drive_rig import local_can, rig_with_drive, toml_of
from experiments.emulation.emulated_rig import emulate
from experiments.emulation.hidden_effects import NOTHING, Hidden
from experiments.excite import random_multisine

RIG_FILE = "served_rig.toml"
PLANS, PLAN_SECONDS, PLAN_PEAK_NM = 8, 10.0, 0.7
REMEMBER_S = 60.0


class ServedRig(Closing):
    """Serves until `close`; `rig_path` is the rig file to give to any command.

    The port is a link in a folder of its own under the system's temporary one: a socket's path must be short.
    """

    def __init__(self, folder: Path, hidden: Hidden = NOTHING, drive: str = "legid") -> None:
        make_directory(folder)
        self.rig_path = folder / "rig.toml"
        self._places = Path(tempfile.mkdtemp(prefix="legid-rig-"))
        text = (files(__package__) / RIG_FILE).read_text(encoding="utf-8")
        text = text.replace("@PORT@", str(self._places / "controller")).replace("@BUS@", str(self._places / "i2c"))
        self._drive = drive
        self._can = None if drive == "legid" or drive_facts(drive).serial else local_can()
        text = rig_with_drive(text, drive, toml_of(self._can) if self._can else "")
        self.mock = emulate(parse_rig(text, RIG_FILE), 1, RealClock(), hidden=hidden)
        self.controller: PtyServer | CanServer | None = None
        self.imu: I2cServer | None = None
        self.plug_in()
        write_text(self.rig_path, text)
        self._ending = threading.Event()
        threading.Thread(target=self._forget, name="forget", daemon=True).start()

    def plug_in(self) -> None:
        """Connect what is unplugged."""
        if self.controller is None and self._can is not None:
            import can  # takes a while to load

            self.controller = CanServer(self.mock.drive, can.Bus(**self._can), self.mock.clock)
        elif self.controller is None:
            served = PtyServer(on_serial(self._drive, self.mock.drive), self.mock.clock)
            link = self._places / "controller"
            link.unlink(missing_ok=True)
            link.symlink_to(served.path)
            self.controller = served
        if self.imu is None:
            self.imu = I2cServer(self.mock.bus, self._places / "i2c")

    def unplug_controller(self) -> None:
        """Pull the controller's cable."""
        if self.controller is not None:
            self.controller.close()
            self.controller = None

    def unplug_imu(self) -> None:
        """Pull the IMU's cable."""
        if self.imu is not None:
            self.imu.close()
            self.imu = None

    def close(self) -> None:
        """Unplug everything and remove the places; may be called twice."""
        self._ending.set()
        self.unplug_controller()
        self.unplug_imu()
        shutil.rmtree(self._places, ignore_errors=True)

    def _forget(self) -> None:
        while not self._ending.wait(REMEMBER_S / 4):
            with self.mock.lock:
                self.mock.drive.motor.forget(round(REMEMBER_S * 1e9 / STEP_NS))


def write_plans(folder: Path, count: int = PLANS) -> list[Path]:
    """Torque plans with random phases of their own, enough of them for a diagnosis."""
    make_directory(folder)
    paths = [folder / f"plan{k + 1}.csv" for k in range(count)]
    for k, path in enumerate(paths):
        write_plan(random_multisine(1000 + k, PLAN_SECONDS, PLAN_PEAK_NM), path)
    return paths
