"""Devices for long recordings: so cheap that what a process costs is the recorder, numbered so that a loss shows."""

import time
from pathlib import Path
from typing import Any

import numpy as np

from daq import parse_rig
from daq.recording import Plan, RecordReport, record_run
from daq.runs import RawRun
from drivers import ImuConfig, LegController, Lsm9ds1
from drivers import lsm9ds1_registers as reg
from drivers.mock import EmulatorLink, FirmwareSettings, MockRig, VirtualClock
from drivers.serial_link import SerialLink
from tests.support.still_plant import StillPlant

RIG = """[mechanism]
model = "leg2"
actuated = [2]
[devices.controller]
watchdog_ms = 1000
rate_hz = 1000.0
[limits]
staleness_s = 5.0
clock_bound_s = 5.0
q1_speed_radps = 8.7
pivot_band_rad = 1000.0
[calibration]
accel_bias_mps2 = [0.0, 0.0, -9.81]
"""
IMU_HZ = 952.0
COUNTS = 28_000
"""As a gyro's reading 8.6 rad/s: numbers must pass for a leg that swings."""


class NumberedChip:
    """An LSM9DS1 that costs next to nothing: its FIFO fills by the real clock, sample k reads k in all six words."""

    def __init__(self) -> None:
        self.registers = bytearray(128)
        self.registers[reg.WHO_AM_I] = reg.WHO_AM_I_VALUE
        self.started_ns = 0
        self.taken = 0
        self.overrun = False
        self.table = np.repeat(np.arange(2 * COUNTS, dtype="<i2") % COUNTS, 6).tobytes()

    def level(self) -> int:
        """Samples in the FIFO now; what does not fit is lost, oldest first."""
        if not self.registers[reg.CTRL_REG9] & reg.FIFO_EN or not self.registers[reg.FIFO_CTRL]:
            self.started_ns, self.taken = time.monotonic_ns(), 0
            return 0
        made = int((time.monotonic_ns() - self.started_ns) * IMU_HZ * 1e-9)
        if made - self.taken > reg.FIFO_DEPTH:
            self.overrun, self.taken = True, made - reg.FIFO_DEPTH
        return made - self.taken

    def i2c_rdwr(self, *messages: Any) -> None:
        """One transaction of smbus2 messages."""
        first, *rest = messages
        data = bytes(first)
        for register, value in zip(range(data[0], 128), data[1:]):
            self.registers[register] = value & ~(reg.SW_RESET if register == reg.CTRL_REG8 else 0)
        for message in rest:
            answer = self.answer(data[0], message.len)
            for i in range(message.len):
                message.buf[i] = answer[i:i + 1]

    def answer(self, register: int, size: int) -> bytes:
        """Bytes from this register on."""
        if register == reg.OUT_X_L_G:
            at, self.taken, self.overrun = self.taken % COUNTS * 12, self.taken + size // 12, False
            return self.table[at: at + size]
        self.registers[reg.FIFO_SRC] = self.level() | (reg.FIFO_OVRN if self.overrun else 0)
        return bytes(self.registers[register: register + size])

    def close(self) -> None:
        """Nothing to let go of."""


def plan(seconds: float) -> Plan:
    """Commands at 100 Hz."""
    t = np.arange(0.0, seconds, 0.01)
    return Plan(t, 0.2 * np.sin(3 * t))


def record_real(path: Path, port: str, seconds: float) -> RecordReport:
    """On the real clock: the numbered chip in memory, the controller at `port`."""
    with LegController(SerialLink(port)) as controller:
        controller.open()
        imu = Lsm9ds1(NumberedChip(), config=ImuConfig(IMU_HZ))
        imu.open()
        return record_run(path, parse_rig(RIG), RIG, plan(seconds), imu, controller)


def record_virtual(path: Path, seconds: float) -> RecordReport:
    """On virtual time: the register-level chip and the emulator at 1 kHz."""
    clock = VirtualClock()
    mock = MockRig(StillPlant(), clock, firmware=FirmwareSettings(telemetry_hz=1000))
    numbers = iter(range(10**9))
    push = mock.imu.push
    mock.imu.push = lambda raw: push([next(numbers) % COUNTS] * 6)  # type: ignore[method-assign]
    controller = LegController(EmulatorLink(mock.firmware, clock), clock.now_ns)
    controller.open()
    imu = Lsm9ds1(mock.imu, config=ImuConfig(IMU_HZ), now_ns=clock.now_ns, sleep=clock.sleep)
    imu.open()
    return record_run(path, parse_rig(RIG), RIG, plan(seconds), imu, controller, clock.now_ns, threaded=False)


def losses(raw: RawRun) -> dict[str, int]:
    """Samples and frames lost or doubled, marked or not."""
    imu, telemetry = raw.streams["/imu"], raw.streams["/leg/telemetry"]
    steps = np.diff(imu["gyro_x"].astype(int)) % COUNTS
    frames = np.diff(telemetry["seq"].astype(int)) % 65536
    torn = sum(int((imu[f"{kind}_{axis}"] != imu["gyro_x"]).sum()) for kind in ("gyro", "accel") for axis in "xyz")
    return {"imu_samples": int(imu.size), "imu_lost": int((steps[(steps > 1) & (steps < COUNTS // 2)] - 1).sum()),
            "imu_doubled": int(((steps == 0) | (steps >= COUNTS // 2)).sum()), "imu_torn": torn,
            "imu_gaps_marked": int(imu["gap_before"].sum()), "imu_jumps": int((steps != 1).sum()),
            "frames": int(telemetry.size), "frames_lost": int((frames[frames < 32768] - 1).clip(0).sum()),
            "frames_doubled": int(((frames == 0) | (frames >= 32768)).sum())}
