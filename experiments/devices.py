"""The real devices of a rig, opened together and closed together."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from daq.errors import InputError
from daq.rig import ImuDevice, Rig
from drivers.i2c_bus import open_bus
from drivers.leg_controller import LegController
from drivers.lsm9ds1 import ImuConfig, Lsm9ds1
from drivers.serial_link import SerialLink


@contextmanager
def open_devices(rig: Rig, where: str) -> Iterator[tuple[Lsm9ds1 | None, LegController]]:
    """(IMU or None where the rig has none, controller), both ready; the motor is stopped on the way out.

    `where` names the rig file in errors. Raises `InputError` or a `DriverError`.
    """
    if rig.devices.controller is None:
        raise InputError(where, "has no [devices.controller]", "name the port that the leg controller is on")
    with ExitStack() as stack:
        # The controller first: opening it stops a motor that somebody left running.
        device = rig.devices.controller
        controller = stack.enter_context(LegController(SerialLink(device.port, device.baud)))
        controller.open()
        imu = None if rig.devices.imu is None else _open_imu(rig.devices.imu, where, stack)
        yield imu, controller


def _open_imu(device: ImuDevice, where: str, stack: ExitStack) -> Lsm9ds1:
    try:
        config = ImuConfig(device.rate_hz, device.accel_range_g, device.gyro_range_dps)
        imu = Lsm9ds1(open_bus(device.bus), device.address, config, bus_khz=device.bus_khz)
        stack.callback(imu.close)
        imu.open()
    except ValueError as error:
        raise InputError(where, f"[devices.imu]: {error}", "correct the rate or the bus speed") from None
    return imu
