"""A rig that exists in bytes only: the plant of `plant` behind emulated chips, on virtual time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from daq import ControllerDevice, ImuDevice, Matrix3, Rig, Vector3
from daq.recording import Plan, RecordReport, Sensors, record_run
from drivers import As5600, CurrentShunt, ImuConfig, Lsm9ds1, attach
from drivers.mock import (
    Clock,
    EmulatorLink,
    FirmwareSettings,
    ImuSettings,
    MockRig,
    PivotSettings,
    ShuntSettings,
    VirtualClock,
    drive_maker,
)
from experiments.emulation.hidden_effects import NOTHING, Hidden
from experiments.emulation.plant import LegBody
from experiments.rig import wiring

REMARK = "recorded from an emulated leg"


def emulate(rig: Rig, seed: int, clock: Clock, body: LegBody | None = None,
            hidden: Hidden = NOTHING) -> MockRig:
    """The rig that `rig` describes, hanging at rest, with the errors that its calibration takes out.

    `hidden` adds errors that the rig file does not mention.
    """
    c = rig.calibration
    imu = ImuSettings(lever_arm_m=rig.imus[0].lever_arm_m, gravity_mps2=rig.mechanism.gravity_mps2, mount=c.imu_mount,
                      gyro_bias_radps=_turned(c.gyro_bias_radps, c.imu_mount, hidden.gyro_bias_radps),
                      accel_bias_mps2=c.accel_bias_mps2, accel_matrix=c.accel_matrix)
    controller = rig.devices.controller or ControllerDevice()
    firmware = FirmwareSettings(
        telemetry_hz=round(controller.rate_hz), gear_ratio=rig.motor.gear_ratio, torque_limit_nm=rig.limits.torque_nm,
        torque_constant_nm_per_a=c.torque_constant_nm_per_a,
        shunt_offset_a=c.shunt_offset_a + hidden.torque_offset_nm / c.torque_constant_nm_per_a,
        knee_zero_rad=c.knee_zero_rad, torque_gain=hidden.torque_gain)
    pivot, shunt = rig.devices.pivot, rig.devices.shunt
    magnet = PivotSettings(c.pivot_zero_rad * pivot.sign, pivot.sign) if pivot else None
    second = ShuntSettings(
        shunt.shunt_ohm, shunt.sign, shunt.sign * c.second_shunt_offset_a * shunt.shunt_ohm,
        torque_constant_nm_per_a=hidden.torque_gain * c.torque_constant_nm_per_a) if shunt else None
    return MockRig(hidden.plant(body or LegBody()), clock, imu, firmware, seed, pivot=magnet, shunt=second,
                   shunt_kind=shunt.kind if shunt else "ina226", shunt_address=shunt.address if shunt else 0x40,
                   make=drive_maker(controller.kind, wiring(controller, rig)))


def _turned(bias: Vector3, mount: Matrix3, added: float) -> Vector3:
    """Bias in the chip's axes with `added` about the joint's axis, the contract's z."""
    x, y, z = (b + added * axis for b, axis in zip(bias, mount[2]))
    return x, y, z


def record_emulated(path: Path, rig: Rig, rig_text: str, plan: Plan, seed: int, body: LegBody | None = None,
                    hidden: Hidden = NOTHING,
                    progress: Callable[[float, float], None] | None = None) -> RecordReport:
    """One run on the emulated rig, through the drivers and the recorder that a real one uses.

    The run file says that it is emulated, and not what is hidden.
    """
    clock = VirtualClock()
    mock = emulate(rig, seed, clock, body, hidden)
    device = rig.devices.imu or ImuDevice()
    config = ImuConfig(device.rate_hz, device.accel_range_g, device.gyro_range_dps)
    drive = rig.devices.controller or ControllerDevice()
    link = EmulatorLink(mock.drive, clock, seed=seed, nothing=getattr(mock.drive, "nothing", b""))
    place = replace(wiring(drive, rig), can=None)  # our own firmware frames itself as on a serial line
    with attach(drive.kind, link, place, clock.now_ns, clock.sleep) as controller:
        controller.open()
        imu = Lsm9ds1(mock.imu, device.address, config, clock.now_ns, device.bus_khz, clock.sleep)
        imu.open()
        return record_run(path, rig, rig_text, plan, imu, controller, clock.now_ns, threaded=False, progress=progress,
                          remark=REMARK, sensors=_sensors(mock, rig, clock))


def _sensors(mock: MockRig, rig: Rig, clock: Clock) -> Sensors:
    """What the rig has besides, open."""
    pivot = shunt = None
    if mock.pivot is not None:
        pivot = As5600(mock.pivot, now_ns=clock.now_ns, sleep=clock.sleep)
        pivot.open()
    device = rig.devices.shunt
    if mock.shunt is not None and device is not None:
        shunt = CurrentShunt(mock.shunt, device.kind, device.shunt_ohm, device.rate_hz, device.address, clock.now_ns,
                             clock.sleep)
        shunt.open()
    return Sensors(pivot, shunt)
