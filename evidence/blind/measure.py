"""From true motion to what a rig records: the IMU, the knee encoder, the shunt, and their faults."""

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


def coloured(rng: np.random.Generator, count: int, rms: float, time: float, dt: float = 1.0 / RATE_HZ) -> Array:
    """AR(1) sequence of the given rms and correlation time, (count,)."""
    pole = np.exp(-dt / time)
    white = rng.normal(size=count) * rms * np.sqrt(1.0 - pole**2)
    white[0] = rng.normal() * rms
    return np.asarray(lfilter([1.0], [1.0, -pole], white))


def imu(q1: Array, w1: Array, a1: Array, base: Array, tilt: Array, lever: float) -> tuple[Array, Array, Array]:
    """Gyro and specific force (x tangential, y along the link) at `lever` from the pivot, noise free."""
    up = q1 + tilt
    ax = lever * a1 + GRAVITY * np.sin(up) + base * np.cos(q1)
    ay = -lever * w1**2 - GRAVITY * np.cos(up) + base * np.sin(q1)
    return w1, ax, ay


def read(motion: Motion, lane: int, torque: Array, faults: Mapping[str, float], sensors: Sensors) -> dict[str, Array]:
    """Columns of one lane with its faults, before noise and quantiser. `torque` is what the shunt shows."""
    n = torque.size
    time = np.arange(n) / RATE_HZ
    lever = sensors.lever + faults.get("lever", 0.0)
    tilt = motion.tilt[:, lane]
    state = [motion.q1[:, lane], motion.w1[:, lane], motion.a1[:, lane], motion.base_acceleration[:, lane], tilt]
    skew = faults.get("skew", 0.0)
    if skew:
        slot = int(np.flatnonzero(motion.fast_lanes == lane)[0])
        state = [np.interp(time - skew, motion.fast_time, motion.fast[:, i, slot]) for i in range(5)]
    gyro, ax, ay = imu(state[0], state[1], state[2], state[3], state[4], lever)
    angle = faults.get("misalignment", 0.0)
    if angle:
        ax, ay = np.cos(angle) * ax + np.sin(angle) * ay, np.cos(angle) * ay - np.sin(angle) * ax
    ax = ax + faults.get("accel_bias_x", 0.0)
    ay = ay + faults.get("accel_bias_y", 0.0)
    gyro = (gyro * (1.0 + faults.get("gyro_scale", 0.0)) + faults.get("gyro_bias", 0.0)
            + faults.get("gyro_cubic", 0.0) * gyro**3 + faults.get("gyro_g", 0.0) * ax
            + faults.get("gyro_torque", 0.0) * torque)
    knee = motion.encoder[:, lane]
    q2 = knee * (1.0 + faults.get("encoder_scale", 0.0)) + faults.get("encoder_offset", 0.0)
    amplitude = faults.get("eccentricity", 0.0)
    if amplitude:
        turn = knee + faults["eccentricity_phase"]
        # a disc off centre by `amplitude` radii, read by one head: exact, not its first harmonic
        q2 = q2 + np.arctan2(amplitude * np.sin(turn), 1.0 + amplitude * np.cos(turn))
    if faults.get("interpolation", 0.0):
        order = faults["interpolation_order"]
        q2 = q2 + faults["interpolation"] * np.sin(order * knee + faults["interpolation_phase"])
    return {"time_s": time, "q2_rad": q2, "tau2_nm": torque, "gyro_radps": gyro, "accel_x_mps2": ax,
            "accel_y_mps2": ay}


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
