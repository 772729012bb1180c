"""`make fixtures`: small recordings of an emulated leg with one fault each, for `legid record --replay` and its test.

Everything is drawn from one seed and runs on virtual time through the byte-level mock, the drivers and the recorder.
"""

import argparse
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from daq import ImuDevice, WorkError, parse_rig
from daq.recording import Plan, record_run
from drivers import ImuConfig, LegController, Lsm9ds1
from drivers.mock import EmulatorLink, FirmwareSettings, ImuSettings, MockRig, VirtualClock
from experiments.emulation.plant import LegPlant
from experiments.excite import random_multisine
from tests.support.paths import FIXTURES

SEED = 2018
SECONDS, PEAK_NM, AT_S = 6.0, 0.6, 4.0
SMALL_RANGE = (("gyro_range_dps = 500", "gyro_range_dps = 245"), ("q1_speed_radps = 8.7", "q1_speed_radps = 4.27"),
               ("[0.0, 0.0, 0.012]", "[0.0, 0.0, -1.6]"))
"""A chip at its smallest range whose large bias the calibration takes off: to one side it clips at 3.4 rad/s."""
PEAKS = {"saturated-gyro": 0.9}
NOISE = {"noisy": (10.0, 2.5)}
"""Of IMU and shunt, times the mock's own."""


class Bench:
    """One recording; what goes wrong strikes once, `AT_S` after the start of the plan."""

    def __init__(self, name: str, seed: int) -> None:
        self.clock = VirtualClock()
        self.text = (FIXTURES / "rig.toml").read_text()
        for old, new in SMALL_RANGE if name == "saturated-gyro" else ():
            self.text = self.text.replace(old, new)
        self.rig = parse_rig(self.text)
        c, (imu_noise, shunt_noise) = self.rig.calibration, NOISE.get(name, (1.0, 1.0))
        imu = ImuSettings(gyro_bias_radps=c.gyro_bias_radps,
                          gyro_noise_radps=imu_noise * ImuSettings.gyro_noise_radps,
                          accel_noise_mps2=imu_noise * ImuSettings.accel_noise_mps2)
        firmware = FirmwareSettings(
            telemetry_hz=250, first_tick_us=2**32 - 3_000_000, knee_zero_rad=c.knee_zero_rad,
            shunt_offset_a=c.shunt_offset_a, torque_constant_nm_per_a=c.torque_constant_nm_per_a,
            current_noise_a=shunt_noise * FirmwareSettings.current_noise_a)
        self.mock = MockRig(LegPlant(), self.clock, imu, firmware, seed)
        self.link = EmulatorLink(self.mock.firmware, self.clock, seed=seed)
        self.plan: Plan = random_multisine(seed, SECONDS, PEAKS.get(name, PEAK_NM))
        self._strike: Callable[[Bench], None] | None = FAULTS.get(name)

    def record(self, path: Path) -> None:
        """A run that something ends early is kept as far as it came."""
        device = self.rig.devices.imu or ImuDevice()
        config = ImuConfig(device.rate_hz, device.accel_range_g, device.gyro_range_dps)
        with LegController(self.link, self.clock.now_ns) as controller:
            controller.open()
            imu = Lsm9ds1(self.mock.imu, device.address, config, self.clock.now_ns, sleep=self.clock.sleep)
            imu.open()
            with suppress(WorkError):
                record_run(path, self.rig, self.text, self.plan, imu, controller, self.clock.now_ns, threaded=False,
                           progress=self._progress, remark="recorded from an emulated leg")

    def _progress(self, done_s: float, total_s: float) -> None:
        if self._strike is not None and done_s >= AT_S:
            strike, self._strike = self._strike, None
            strike(self)


FAULTS: dict[str, Callable[[Bench], None]] = {
    "pulled-cable": lambda bench: bench.link.unplug(),
    "gap": lambda bench: bench.mock.imu.fail(121, times=4),
    "clock-reset": lambda bench: bench.mock.firmware.reboot(),
}
NAMES = ("healthy", *FAULTS, "saturated-gyro", "noisy")


def make(folder: Path, seed: int = SEED, names: tuple[str, ...] = NAMES) -> None:
    """Record each of `names` into `folder`, in place of what is there."""
    for name in names:
        path = folder / f"{name}.mcap"
        path.unlink(missing_ok=True)
        Bench(name, seed).record(path)
        print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=FIXTURES)
    parser.add_argument("--seed", type=int, default=SEED)
    args = parser.parse_args()
    make(args.out, args.seed)
