"""Tables of rig.toml under [devices]: what a recording reads and drives."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from daq.rig_types import Address, NonNegative, Positive, Table


class ImuDevice(Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    bus: str = "/dev/i2c-1"
    address: Address = 0x6B
    rate_hz: Positive = 238.0
    accel_range_g: Literal[2, 4, 8, 16] = 4
    gyro_range_dps: Literal[245, 500, 2000] = 500
    bus_khz: Positive = 400.0
    slow_hz: NonNegative = 0.0
    """Temperature, and the field where there is a magnetometer, so many times a second; 0: not read."""
    magnetometer: Address | None = None
    """Its address: 0x1E or 0x1C."""


NODES = 64
"""Addresses of our own firmware on CAN."""


class ControllerDevice(Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    kind: Annotated[str, Meta(pattern="^[a-z][a-z0-9_]*$", max_length=40)] = "legid"
    """Which drive: legid (our own firmware) | moteus | odrive | dynamixel | feetech (read only), or one of one's own;
    see `drivers.drive`."""
    port: str = "/dev/ttyACM0"
    baud: Annotated[int, Meta(ge=1200, le=12_000_000)] = 1_000_000
    can: dict[str, str | int | float | bool] | None = None
    """python-can's configuration (interface, channel, bitrate, ...); given, `port` and `baud` are not used."""
    node: Annotated[int, Meta(ge=0, le=127)] = 0
    """The controller's node on CAN: up to 63, a moteus' `id.id` up to 127."""
    rate_hz: Positive = 500.0
    """Telemetry rate [Hz]: what the firmware sends, or how often a polled drive is asked."""
    watchdog_ms: Annotated[int, Meta(ge=5, le=1000)] = 100


class PivotDevice(Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An AS5600 over a magnet on the passive joint's axle: q1 without a controller."""

    bus: str = "/dev/i2c-1"
    address: Address = 0x36
    rate_hz: Annotated[float, Meta(ge=10, le=1000)] = 200.0
    """Readings a second."""
    sign: Literal[1, -1] = 1
    """-1: the chip counts down while q1 grows."""


class ShuntDevice(Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An INA226 or INA228 over a resistor in the motor's lead: the motor's current independent of the drive."""

    shunt_ohm: Annotated[float, Meta(gt=0, le=10.0)]
    kind: Literal["ina226", "ina228"] = "ina226"
    bus: str = "/dev/i2c-1"
    address: Address = 0x40
    rate_hz: Positive = 200.0
    """Readings a second, each the mean over at most 0.6 of the time between them."""
    sign: Literal[1, -1] = 1
    """-1: it reads a current with which q2 is driven forwards as negative."""


class Devices(Table, frozen=True, kw_only=True, forbid_unknown_fields=True):
    imu: ImuDevice | None = None
    controller: ControllerDevice | None = None
    pivot: PivotDevice | None = None
    shunt: ShuntDevice | None = None
