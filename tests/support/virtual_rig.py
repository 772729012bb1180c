"""An emulated rig on virtual time, the link to its controller, the program's own drivers, and recordings by them."""

from pathlib import Path
from typing import Any, Self

from daq import parse_rig
from daq.recording import Plan, RecordReport, record_run
from drivers import ImuConfig, LegController, Lsm9ds1
from drivers.can_codec import CanCodec
from drivers.mock import EmulatorLink, FirmwareSettings, ImuSettings, MockRig, Plant, VirtualClock
from drivers.protocol import Decoder
from tests.support.device_faults import FaultyLink, FaultyWire
from tests.support.still_plant import StillPlant


class VirtualRig:
    """A leg that stands still, where no `plant` is given; its cable can be pulled, and mangles frames as `wire` does.
    `rig` has further settings of `MockRig`."""

    def __init__(self, plant: Plant | None = None, imu: ImuSettings | None = None,
                 firmware: FirmwareSettings | None = None, seed: int = 0, config: ImuConfig | None = None,
                 can: bool = False, wire: FaultyWire | None = None, **rig: Any) -> None:
        self.clock = VirtualClock()
        self.times: dict[str, Any] = {"now_ns": self.clock.now_ns, "sleep": self.clock.sleep}
        self.mock = MockRig(plant or StillPlant(), self.clock, imu, firmware, seed,
                            codec=CanCodec if can else Decoder, **rig)
        self.firmware = self.mock.firmware
        self.link = FaultyLink(EmulatorLink(self.firmware, self.clock, nothing=() if can else b""), self.clock, wire)
        self.controller = LegController(self.link, self.clock.now_ns, CanCodec() if can else None)
        self.imu = Lsm9ds1(self.mock.bus, config=config, **self.times)

    def open(self) -> Self:
        """Both devices."""
        self.controller.open()
        self.imu.open()
        return self

    def save(self, path: Path, text: str, plan: Plan, **more: Any) -> RecordReport:
        """`record_run` with the rig file `text`; without the IMU by `imu=None`."""
        devices: dict[str, Any] = {"imu": self.imu, "controller": self.controller, "now_ns": self.clock.now_ns,
                                   "threaded": False}
        return record_run(path, parse_rig(text), text, plan, **devices | more)

    def poll_for(self, seconds: float, torque_nm: float | None = None) -> list[Any]:
        """What the controller says in so long; with a torque commanded after each look, where one is given."""
        end, out = self.clock.now_ns() + seconds * 1e9, []
        while self.clock.now_ns() < end:
            out += self.controller.poll()
            if torque_nm is not None:
                self.controller.command(torque_nm)
        return out
