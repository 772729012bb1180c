"""From true motion to what a rig records: the IMU, the knee encoder, the shunt, and their faults."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from evidence.blind.leg import GRAVITY, Array
from evidence.blind.physics import Motion

RATE_HZ = 100.0
COLUMNS = ("time_s", "q2_rad", "tau2_nm", "gyro_radps", "accel_x_mps2", "accel_y_mps2")


@dataclass(frozen=True)
class Sensors:
    """Noise of the rig (1 sigma) and what its rig.toml claims."""

    gyro: float = 0.005
    accel: float = 0.05
    torque: float = 0.02
    bits: int = 13
    lever: float = 0.20
    gear: float = 50.0
    process: float = 0.01
    """Coloured torque on the knee [N m rms]."""
    process_time: float = 0.2
    """Its correlation time [s]."""
    pivot: float = 0.0
    """Coloured torque on the pivot [N m rms]."""

    @property
    def count_rad(self) -> float:
        return float(2.0 * np.pi / 2**self.bits)


def coloured(rng: np.random.Generator, count: int, rms: float, time: float) -> Array:
    """AR(1) sequence of the given rms and correlation time, (count,)."""
    pole = np.exp(-1.0 / RATE_HZ / time)
    white = rng.normal(size=count) * rms * np.sqrt(1.0 - pole**2)
    white[0] = rng.normal() * rms
    return lfilter([1.0], [1.0, -pole], white)


def imu(q1: Array, w1: Array, a1: Array, base: Array, tilt: Array, lever: float) -> tuple[Array, Array, Array]:
    """Gyro and specific force (x tangential, y along the link) at `lever` from the pivot, noise free."""
    up = q1 + tilt
    ax = lever * a1 + GRAVITY * np.sin(up) + base * np.cos(q1)
    ay = -lever * w1**2 - GRAVITY * np.cos(up) + base * np.sin(q1)
    return w1, ax, ay


def read(motion: Motion, lane: int, torque: Array, faults: Mapping[str, float], sensors: Sensors) -> dict[str, Array]:
    """Columns of one lane with its faults, before noise and quantiser. `torque` is what the shunt shows."""
    time, fault = np.arange(torque.size) / RATE_HZ, defaultdict(float, faults)
    state = [of[:, lane] for of in (motion.q1, motion.w1, motion.a1, motion.base_acceleration, motion.tilt)]
    if fault["skew"]:
        slot = int(np.flatnonzero(motion.fast_lanes == lane)[0])
        state = [np.interp(time - fault["skew"], motion.fast_time, motion.fast[:, i, slot]) for i in range(5)]
    q1, w1, a1, base, tilt = state
    gyro, ax, ay = imu(q1, w1, a1, base, tilt, sensors.lever + fault["lever"])
    angle = fault["misalignment"]
    if angle:
        ax, ay = np.cos(angle) * ax + np.sin(angle) * ay, np.cos(angle) * ay - np.sin(angle) * ax
    ax = ax + fault["accel_bias_x"]
    ay = ay + fault["accel_bias_y"]
    gyro = (gyro * (1.0 + fault["gyro_scale"]) + fault["gyro_bias"] + fault["gyro_cubic"] * gyro**3
            + fault["gyro_g"] * ax + fault["gyro_torque"] * torque)
    knee = motion.encoder[:, lane]
    q2 = knee * (1.0 + fault["encoder_scale"]) + fault["encoder_offset"]
    amplitude = fault["eccentricity"]
    if amplitude:
        turn = knee + fault["eccentricity_phase"]
        # a disc off centre by `amplitude` radii, read by one head: exact, not its first harmonic
        q2 = q2 + np.arctan2(amplitude * np.sin(turn), 1.0 + amplitude * np.cos(turn))
    if fault["interpolation"]:
        q2 = q2 + fault["interpolation"] * np.sin(fault["interpolation_order"] * knee + fault["interpolation_phase"])
    return dict(zip(COLUMNS, (time, q2, torque, gyro, ax, ay)))


def disturb(columns: Mapping[str, Array], torque_noise: Array, sensors: Sensors,
            rng: np.random.Generator) -> dict[str, Array]:
    """Noise and quantiser of a real rig on clean columns."""
    n = torque_noise.size
    out = dict(columns)
    out["q2_rad"] = np.round(columns["q2_rad"] / sensors.count_rad) * sensors.count_rad
    out["tau2_nm"] = columns["tau2_nm"] + torque_noise
    out["gyro_radps"] = columns["gyro_radps"] + sensors.gyro * rng.normal(size=n)
    for axis in "xy":
        name = f"accel_{axis}_mps2"
        out[name] = columns[name] + sensors.accel * rng.normal(size=n)
    return out


def write_run(path: Path, columns: Mapping[str, Array]) -> None:
    """One run as the contract's CSV."""
    np.savetxt(path, np.column_stack([columns[name] for name in COLUMNS]), delimiter=",", comments="",
               header=",".join(COLUMNS), fmt=["%.4f", "%.8f", "%.6f", "%.6f", "%.5f", "%.5f"])


def write_rig(path: Path, sensors: Sensors) -> None:
    """rig.toml as the rig's owner would write it: nothing of what is hidden."""
    path.write_text(f"""[mechanism]
model = "leg2"
actuated = [2]
gravity_mps2 = {GRAVITY}
[imu]
lever_arm_m = {sensors.lever}
[motor]
gear_ratio = {sensors.gear}
[noise]
gyro_radps = {sensors.gyro}
accel_mps2 = {sensors.accel}
torque_nm = {sensors.torque}
encoder_rad = {sensors.count_rad / np.sqrt(12.0):.3e}
[sampling]
rate_hz = {RATE_HZ}
hold = "linear"
""", encoding="utf-8")
