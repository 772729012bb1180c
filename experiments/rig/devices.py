"""The real devices of a rig, opened together and closed together."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace

from daq import ControllerDevice, ImuDevice, InputError, PivotDevice, Rig, ShuntDevice
from daq.recording import Sensors
from drivers import (
    MAG_ODR_HZ,
    As5600,
    CurrentShunt,
    Drive,
    ImuConfig,
    Lsm9ds1,
    MagConfig,
    Magnetometer,
    Wiring,
    open_bus,
    open_drive,
)


@contextmanager
def open_devices(rig: Rig, where: str) -> Iterator[tuple[Lsm9ds1 | None, Drive, Sensors]]:
    """(IMU or None where the rig has none, controller, other sensors), all ready; the motor is stopped on the way out.

    `where` names the rig file in errors. Raises `InputError` or a `DriverError`.
    """
    if rig.devices.controller is None:
        raise InputError(where, "has no [devices.controller]", "name the port that the leg controller is on")
    with ExitStack() as stack:
        # The controller first: opening it stops a motor that somebody left running.
        device = rig.devices.controller
        controller = stack.enter_context(connect(device, rig))
        controller.open()
        imu = None if rig.devices.imu is None else stack.enter_context(open_imu(rig.devices.imu, where))
        yield imu, controller, stack.enter_context(open_sensors(rig, where))


@contextmanager
def open_sensors(rig: Rig, where: str) -> Iterator[Sensors]:
    """The pivot sensor and the second shunt as far as the rig has them, reading; let go of on the way out. Raises
    `InputError` or a `DriverError`."""
    with ExitStack() as stack:
        pivot = None if rig.devices.pivot is None else stack.enter_context(open_pivot(rig.devices.pivot))
        shunt = None if rig.devices.shunt is None else stack.enter_context(open_shunt(rig.devices.shunt, where))
        yield Sensors(pivot, shunt)


@contextmanager
def open_pivot(device: PivotDevice) -> Iterator[As5600]:
    """The pivot sensor alone, reading. Raises a `DriverError`."""
    pivot = As5600(open_bus(device.bus, "pivot"), device.address)
    try:
        pivot.open()
        yield pivot
    finally:
        pivot.close()


@contextmanager
def open_shunt(device: ShuntDevice, where: str) -> Iterator[CurrentShunt]:
    """The second shunt alone, reading. Raises `InputError` or a `DriverError`."""
    bus = open_bus(device.bus, "shunt")
    try:
        try:
            shunt = CurrentShunt(bus, device.kind, device.shunt_ohm, device.rate_hz, device.address)
        except ValueError as error:
            raise InputError(where, f"[devices.shunt] rate_hz: {error}", "lower it") from None
        shunt.open()
        yield shunt
    finally:
        bus.close()


def wiring(device: ControllerDevice, rig: Rig | None = None) -> Wiring:
    """Wiring for the driver of this device; without a rig file, of a drive on the joint itself."""
    found = Wiring(device.port, device.baud, device.can, device.node, device.rate_hz, watchdog_ms=device.watchdog_ms)
    if rig is None:
        return found
    ratio = rig.motor.gear_ratio if rig.motor.side == "motor" else 1.0
    return replace(found, gear_ratio=rig.motor.gear_ratio, turns=rig.motor.sign * ratio,
                   torque_constant_nm_per_a=rig.calibration.torque_constant_nm_per_a,
                   torque_limit_nm=rig.limits.torque_nm, speed_limit_radps=rig.limits.speed_radps)


def connect(device: ControllerDevice, rig: Rig | None = None) -> Drive:
    """The drive on its serial port, CAN bus, or whatever its port names, not yet greeted. Raises a `DriverError`."""
    return open_drive(device.kind, wiring(device, rig))


@contextmanager
def open_imu(device: ImuDevice, where: str) -> Iterator[Lsm9ds1]:
    """The IMU alone, reading; let go of on the way out. Raises `InputError` or a `DriverError`."""
    try:
        config = ImuConfig(device.rate_hz, device.accel_range_g, device.gyro_range_dps)
        imu = Lsm9ds1(open_bus(device.bus), device.address, config, bus_khz=device.bus_khz)
    except ValueError as error:
        raise InputError(where, f"[devices.imu]: {error}", "correct it") from None
    try:
        try:
            imu.open()
        except ValueError as error:
            raise InputError(where, f"[devices.imu]: {error}", "correct the rate or the bus speed") from None
        if device.magnetometer is not None:
            rate = next((hz for hz in MAG_ODR_HZ if hz >= device.slow_hz), max(MAG_ODR_HZ))
            imu.magnetometer = Magnetometer(imu.bus, device.magnetometer, MagConfig(rate))
            imu.magnetometer.open()
        yield imu
    finally:
        imu.close()
