"""ODrive's CANSimple of firmware 0.6: an identifier is node << 5 | message, values are little-endian.

Sources: docs.odriverobotics.com, "CAN Protocol", and the published odrive-cansimple.dbc of 0.6.10.
"""

from __future__ import annotations

import struct
from enum import IntEnum, IntFlag

from drivers.can_frame import NODE_BITS, ONE_MESSAGE, CanFrame


class Msg(IntEnum):
    """The messages that legid uses."""

    GET_VERSION = 0x00
    HEARTBEAT = 0x01
    GET_ERROR = 0x03
    SET_AXIS_STATE = 0x07
    GET_ENCODER_ESTIMATES = 0x09
    SET_CONTROLLER_MODE = 0x0B
    SET_INPUT_TORQUE = 0x0E
    SET_LIMITS = 0x0F
    GET_IQ = 0x14
    GET_TEMPERATURE = 0x15
    GET_BUS_VOLTAGE_CURRENT = 0x17
    CLEAR_ERRORS = 0x18
    GET_TORQUES = 0x1C


LAYOUT = {
    Msg.GET_VERSION: "<8B", Msg.HEARTBEAT: "<IBBBx", Msg.GET_ERROR: "<II", Msg.SET_AXIS_STATE: "<I",
    Msg.GET_ENCODER_ESTIMATES: "<ff", Msg.SET_CONTROLLER_MODE: "<II", Msg.SET_INPUT_TORQUE: "<f",
    Msg.SET_LIMITS: "<ff", Msg.GET_IQ: "<ff", Msg.GET_TEMPERATURE: "<ff", Msg.GET_BUS_VOLTAGE_CURRENT: "<ff",
    Msg.CLEAR_ERRORS: "<B", Msg.GET_TORQUES: "<ff",
}
"""Fields in order: position [rev], velocity [rev/s]; current setpoint, measured [A]; FET, motor [degC]; bus [V], [A];
torque target, estimate [N m]; limits of velocity [rev/s], current [A]; active errors, disarm reason; error, axis state,
result, trajectory done; protocol, hardware major, minor, variant, firmware major, minor, revision, unreleased."""
IDLE, CLOSED_LOOP = 1, 8
TORQUE_CONTROL, PASSTHROUGH = 1, 1


class OdriveError(IntFlag):
    """Bits of Axis_Error, Active_Errors and Disarm_Reason."""

    INITIALIZING = 1 << 0
    SYSTEM_LEVEL = 1 << 1
    TIMING_ERROR = 1 << 2
    MISSING_ESTIMATE = 1 << 3
    BAD_CONFIG = 1 << 4
    DRV_FAULT = 1 << 5
    MISSING_INPUT = 1 << 6
    DC_BUS_OVER_VOLTAGE = 1 << 8
    DC_BUS_UNDER_VOLTAGE = 1 << 9
    DC_BUS_OVER_CURRENT = 1 << 10
    DC_BUS_OVER_REGEN_CURRENT = 1 << 11
    CURRENT_LIMIT_VIOLATION = 1 << 12
    MOTOR_OVER_TEMP = 1 << 13
    INVERTER_OVER_TEMP = 1 << 14
    VELOCITY_LIMIT_VIOLATION = 1 << 15
    POSITION_LIMIT_VIOLATION = 1 << 16
    WATCHDOG_TIMER_EXPIRED = 1 << 24
    ESTOP_REQUESTED = 1 << 25
    SPINOUT_DETECTED = 1 << 26
    BRAKE_RESISTOR_DISARMED = 1 << 27
    THERMISTOR_DISCONNECTED = 1 << 28
    CALIBRATION_ERROR = 1 << 30


def message(node: int, msg: Msg, *values: float) -> CanFrame:
    """The frame of a message."""
    return CanFrame(node << NODE_BITS | msg, struct.pack(LAYOUT[msg], *values))


def request(node: int, msg: Msg) -> CanFrame:
    """The frame that asks for a message."""
    return CanFrame(node << NODE_BITS | msg, b"", remote=True)


def values_of(frame: CanFrame) -> tuple[Msg, tuple[float, ...]] | None:
    """The message of a frame and its values; None where it is none of these, or of another length."""
    try:
        msg = Msg(frame.can_id & ONE_MESSAGE)
        return msg, struct.unpack(LAYOUT[msg], frame.data)
    except (ValueError, struct.error):
        return None


def error_names(bits: int) -> str:
    """Errors in ODrive's words."""
    names = [error.name for error in OdriveError if bits & error and error.name]
    rest = bits & ~sum(OdriveError)
    return ", ".join(names + ([f"0x{rest:x}"] if rest else []))
