"""Facts in a run file about the devices that recorded it."""

from __future__ import annotations

import platform
import time

import msgspec
import numpy as np

from daq.recording.sensors import Sensors
from daq.rig import Rig
from daq.runs import RunWriter
from drivers import CurrentShunt, Drive, Lsm9ds1


def program_facts(rig: Rig, now_ns: int) -> dict[str, str]:
    """When, with which calibration, and on what."""
    return {"started_unix_ns": str(time.time_ns()), "started_monotonic_ns": str(now_ns),
            "calibration": msgspec.json.encode(rig.calibration).decode(), "python": platform.python_version(),
            "numpy": np.__version__, "system": platform.platform()}


def describe_devices(writer: RunWriter, controller: Drive, imu: Lsm9ds1 | None, now_ns: int,
                     sensors: Sensors | None = None) -> None:
    """Firmware, link and the scales of IMU and shunt, as configuration notes."""
    writer.config(now_ns, "firmware", msgspec.json.encode(controller.hello).decode())
    can = controller.capabilities
    if can.polled:
        writer.config(now_ns, "drive", msgspec.json.encode({"polled": can.polled, "current": can.current}).decode())
    if controller.link_facts:
        writer.config(now_ns, "link", msgspec.json.encode(controller.link_facts).decode())
    if imu is not None:
        writer.config(now_ns, "imu", msgspec.json.encode(imu_facts(imu)).decode())
    if sensors is not None and sensors.shunt is not None:
        writer.config(now_ns, "shunt", msgspec.json.encode(shunt_facts(sensors.shunt)).decode())


def imu_facts(imu: Lsm9ds1) -> dict[str, object]:
    """Facts that convert the readings of the IMU, and those that say how old they are: see `daq.Imu`.

    `fit_samples` gives each sample the time at which the chip put it into its FIFO.
    """
    gyro, accel = imu.scale
    return {"gyro_radps_per_lsb": gyro, "accel_mps2_per_lsb": accel, "rate_hz": imu.config.rate_hz,
            "accel_range_g": imu.config.accel_range_g, "gyro_range_dps": imu.config.gyro_range_dps,
            "field_t_per_lsb": imu.magnetometer.config.scale_t if imu.magnetometer else None,
            "cutoff_hz": imu.config.cutoffs_hz, "stamped": "sample"}


def shunt_facts(shunt: CurrentShunt) -> dict[str, float | str]:
    """Facts that convert the readings of the second shunt."""
    return {"chip": shunt.chip.name, "amperes_per_count": shunt.amperes_per_count, "conversion_s": shunt.conversion_s}
