"""Checks of the I2C bus and of the chip on it, before the driver takes it."""

from __future__ import annotations

import errno
import re
import time
from pathlib import Path

from daq import ImuDevice
from drivers import BUS_SHARE, DriverError, I2CBus, claim, explain, open_bus, read_registers
from drivers import lsm9ds1_registers as reg
from experiments.doctor.check import Check

SYSFS = Path("/sys")
PROBE_BYTES = reg.FIFO_DEPTH * reg.SAMPLE_BYTES
PROBES = 5
TOLD_SHARE = 0.7
"""A bus measured slower than this share of what the rig says runs at another clock."""


def examine_bus(device: ImuDevice) -> tuple[list[Check], bool]:
    """Checks of bus, kernel driver, identity and speed, and whether the chip can be opened after them."""
    try:
        bus = open_bus(device.bus)
    except DriverError as error:
        return [Check("I2C bus", "FAIL", str(error))], False
    checks = [Check("I2C bus", "ok", f"{device.bus} may be opened")]
    where = f"LSM9DS1 at 0x{device.address:02X}"
    try:
        claim(bus, device.address)
        checks.append(Check("kernel driver", "ok", "none holds the chip"))
        who = read_registers(bus, device.address, reg.WHO_AM_I, 1)[0]
        if who != reg.WHO_AM_I_VALUE:
            words = f"WHO_AM_I reads 0x{who:02X}, an LSM9DS1 has 0x{reg.WHO_AM_I_VALUE:02X}; another chip is wired " \
                    "there, check the address"
            return [*checks, Check("chip identity", "FAIL", words)], False
        checks.append(Check("chip identity", "ok", f"LSM9DS1 answers at 0x{device.address:02X}"))
        checks.append(_speed(bus, device))
    except OSError as error:
        name = "kernel driver" if error.errno in (errno.EBUSY, errno.EUSERS) else "chip identity"
        if name == "chip identity" and any(check.name == name for check in checks):
            name = "I2C speed"
        return [*checks, Check(name, "FAIL", f"{explain(error, where)}{_holder(device)}")], False
    finally:
        bus.close()
    return checks, checks[-1].status != "FAIL"


def _holder(device: ImuDevice) -> str:
    """Name of the kernel driver bound to the chip, where sysfs tells."""
    number = re.search(r"(\d+)$", device.bus)
    link = SYSFS / "bus/i2c/devices" / f"{number.group(1) if number else 'x'}-{device.address:04x}" / "driver"
    return f" (bound: {link.resolve().name}; echo {link.parent.name} | sudo tee {link}/unbind)" if link.exists() else ""


def _speed(bus: I2CBus, device: ImuDevice) -> Check:
    """The clock that long reads really get: what the device tree says is not what a slow adapter does."""
    took = []
    for _ in range(PROBES):
        begin = time.monotonic()
        read_registers(bus, device.address, reg.OUT_X_L_G, PROBE_BYTES)
        took.append(time.monotonic() - begin)
    khz = (PROBE_BYTES + 3) * 9 / max(min(took), 1e-9) / 1e3  # three address bytes, nine clocks a byte
    need = device.rate_hz * reg.SAMPLE_BYTES * 9 / 1e3
    words = f"{khz:.0f} kHz measured, {device.rate_hz:g} Hz of samples take {need:.0f}"
    remedy = "set dtparam=i2c_arm_baudrate=400000 (and a fixed core_freq) on a Pi"
    if need > BUS_SHARE * khz:
        return Check("I2C speed", "FAIL", f"{words}; {remedy}, or lower [devices.imu] rate_hz")
    if khz < TOLD_SHARE * device.bus_khz:
        return Check("I2C speed", "warn", f"{words}, the rig says {device.bus_khz:g}; {remedy}, or correct "
                                          "[devices.imu] bus_khz")
    return Check("I2C speed", "ok", words)
