"""Run files of a rig with its motor off, written sample by sample from given motion: no code under test makes them."""

from pathlib import Path

import msgspec
import numpy as np

from daq.runs import RunWriter
from drivers import ImuConfig

TELEMETRY_HZ, IMU_HZ = 200.0, 238.0
DRAIN_S = 0.0126
START_NS = 10**9
RIG = """[mechanism]
model = "leg2"
actuated = [2]
gravity_mps2 = 9.81

[imu]
lever_arm_m = 0.1           # by the drawing

[noise]
encoder_rad = 2e-4

[calibration]               # nothing measured yet
knee_zero_rad = 0.0         # ASSUMED, please measure
torque_constant_nm_per_a = 0.85
imu_mount = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]

[limits]
torque_nm = 1.5             # the gearbox
"""


def write_off(path: Path, seconds: float = 6.0, knee_rad: float | np.ndarray = 0.0,
              current_a: float | np.ndarray = 0.0, readings: np.ndarray | None = None,
              hall_rad: np.ndarray | None = None, state: int = 0) -> str:
    """A run: telemetry at `TELEMETRY_HZ`; with `readings` (n, 6) in SI units an IMU at `IMU_HZ`. Returns the path."""
    writer = RunWriter(path, {"rig.toml": RIG})
    n = int(seconds * TELEMETRY_HZ)
    knee, current = np.broadcast_to(knee_rad, n), np.broadcast_to(current_a, n)
    hall = np.full(n, np.nan) if hall_rad is None else hall_rad
    for i in range(n):
        tick = i * int(1e6 / TELEMETRY_HZ)
        at = START_NS + tick * 1000 + 400_000
        writer.add("/leg/telemetry", at, at, knee[i], hall[i], np.nan, current[i], 24.0, 30.0, 0.0, tick, 1, i, 0,
                   state)
        if i % 20 == 0:
            sent = START_NS + tick * 1000 - 100_000
            writer.add("/leg/clock", sent, sent, sent + 300_000, tick + 50 - 5, tick + 50 + 5, 1, i)
    if readings is not None:
        add_imu(writer, readings)
    writer.close()
    return str(path)


def add_imu(writer: RunWriter, readings: np.ndarray) -> None:
    """An IMU's readings (n, 6) in SI units at `IMU_HZ`, drained every `DRAIN_S`."""
    gyro, accel = ImuConfig().scale
    facts = {"gyro_radps_per_lsb": gyro, "accel_mps2_per_lsb": accel, "rate_hz": IMU_HZ}
    writer.config(0, "imu", msgspec.json.encode(facts).decode())
    counts = np.rint(readings / np.repeat([gyro, accel], 3)).astype(int)
    for i, row in enumerate(counts.tolist()):
        drained = START_NS + (int(i / IMU_HZ / DRAIN_S) + 1) * int(DRAIN_S * 1e9)
        writer.add("/imu", drained, drained, drained + 90_000, i, *row, 0)


def hanging(q1: float, seconds: float = 6.0, seed: int = 0) -> np.ndarray:
    """(n, 6) of an IMU on a link at rest at q1, mounted along the link's axes."""
    rng, n = np.random.default_rng(seed), int(seconds * IMU_HZ)
    still = np.array([0.01, -0.02, 0.03, 9.81 * np.sin(q1), -9.81 * np.cos(q1), 0.0])
    return still + np.repeat([0.005, 0.05], 3) * rng.standard_normal((n, 6))
