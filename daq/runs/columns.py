"""Columns that a run must have for a mechanism: the contract of the CSV, as data."""

from __future__ import annotations

import re
from collections.abc import Collection
from typing import NamedTuple

from daq.rig import Rig, joint_count

IMU = ("gyro_radps", "accel_x_mps2", "accel_y_mps2")
OPTIONAL = ("tau2_cmd_nm", "tau2_shunt_nm", "temperature_degc", "q2_motor_rad", "distance_m", "stance")
"""Columns with a meaning that no mechanism requires; their cells are checked like required ones."""


def imu_columns(number: int) -> tuple[str, str, str]:
    """Gyro, accelerometer x and y of an IMU, 0-based in the rig's order."""
    own = number + 1
    return IMU if number == 0 else (f"gyro{own}_radps", f"accel{own}_x_mps2", f"accel{own}_y_mps2")


def imu_columns_of(rig: Rig) -> list[str]:
    """Columns of all IMUs of the rig."""
    return [name for k in range(len(rig.imus)) for name in imu_columns(k)]


_IMU_COLUMN = re.compile(r"gyro([2-9]|1[0-9]|20)_radps|accel([2-9]|1[0-9]|20)_[xy]_mps2")
_JOINT_COLUMN = re.compile(r"(q|qd|tau)([1-9]|1[0-9]|20)_(rad|nm|cmd_rad|cmd_radps|ff_nm)")
_ENDINGS = {"q": ("rad", "cmd_rad"), "qd": ("cmd_radps",), "tau": ("nm", "ff_nm")}
LOAD_COLUMN = re.compile(r"load([1-9]|1[0-9]|20)_raw")
"""Load of a joint as its servo logs it, in a unit that nobody has stated: kept, and read by no verb."""
VOLTAGE = "voltage1_v"
"""Of a motor that drives joint 1; in its place a run may have `duty` and `volts`."""
ENABLED = "torque_enable"
"""Whether that motor is switched on: 1 or 0, as the registers of servos have it."""


def is_contract_column(name: str) -> bool:
    """The contract gives this column a meaning."""
    match = _JOINT_COLUMN.fullmatch(name)
    if match:
        return match[3] in _ENDINGS[match[1]]
    if _IMU_COLUMN.fullmatch(name) or LOAD_COLUMN.fullmatch(name):
        return True
    return name in ("time_s", "q1_m", "tau1_n", "duty", "volts", "supply_v", VOLTAGE, ENABLED, *IMU, *OPTIONAL)


class Missing(NamedTuple):
    """A column that the mechanism needs and the run has not."""

    column: str
    remedy: str


def missing(rig: Rig, present: Collection[str]) -> Missing | None:
    """First column that `rig` requires and `present` lacks; None when the run is complete."""
    if "time_s" not in present:
        return Missing("time_s", "add the sample time in seconds")
    if rig.mechanism.model == "joint1":
        return _missing_joint1(rig, present)
    lacking = _missing_angle(rig, present)
    if lacking is not None:
        return lacking
    for joint in _torque_joints(rig):
        if f"tau{joint}_nm" not in present:
            if rig.servo is not None and joint in rig.mechanism.actuated:
                if f"q{joint}_cmd_rad" in present:
                    continue
                return Missing(f"q{joint}_cmd_rad", "add the angle that the servo was commanded in rad, for [servo]")
            if f"q{joint}_cmd_rad" in present:
                return Missing(f"tau{joint}_nm", _servo(joint))
            return Missing(f"tau{joint}_nm", f"add the torque of joint {joint} in N m, or, if its drive follows an "
                                             f"angle, that command as q{joint}_cmd_rad; without a motor take {joint} "
                                             "out of actuated")
    return None


def commanded(present: Collection[str]) -> tuple[int, ...]:
    """Joints whose drives follow an angle by a run with columns `present`: a command and no torque, duty or voltage."""
    joints = [int(match[2]) for name in present if (match := _JOINT_COLUMN.fullmatch(name)) and match[3] == "cmd_rad"]
    return tuple(sorted(j for j in joints if not {f"tau{j}_nm", "duty", VOLTAGE} & set(present)))


def _servo(joint: int) -> str:
    return (f"declare the servo that q{joint}_cmd_rad commands by [servo], with its gain in N m/rad if that is known, "
            f"or add the torque of joint {joint} in N m")


def known(rig: Rig | None, present: Collection[str]) -> set[str]:
    """Columns of `present` that carry a meaning in the contract; the others are the user's own."""
    joints = 20 if rig is None else joint_count(rig.mechanism)
    return {name for name in present if is_contract_column(name)
            and not ((match := _JOINT_COLUMN.fullmatch(name)) and int(match[2]) > joints)}


def _torque_joints(rig: Rig) -> list[int]:
    # The knee's torque is required on every leg that is driven at all: the contract names it so.
    joints = set(rig.mechanism.actuated)
    return sorted(joints | {2} if rig.mechanism.model == "leg2" and joints else joints)


def encoders_with_imus(rig: Rig) -> tuple[int, ...]:
    """1-based joints whose encoders are read in addition to the rig's IMUs."""
    named = rig.mechanism.encoders
    return tuple(range(2, joint_count(rig.mechanism) + 1)) if named is None else named


def _missing_angle(rig: Rig, present: Collection[str]) -> Missing | None:
    m, imus = rig.mechanism, imu_columns_of(rig)
    elsewhere = len(rig.imus) > 1 or rig.imus[0].link > 1 or m.encoders is not None
    if elsewhere or (m.model != "leg2" and rig.imu is not None and any(name in present for name in imus)):
        needed = [*imus, *(f"q{j}_rad" for j in encoders_with_imus(rig))]
        absent = [name for name in needed if name not in present]
        angles = [f"q{j}_rad" for j in range(1, joint_count(m) + 1)]
        alone = len(m.encoders or angles) == len(angles) and all(name in present for name in angles)
        return Missing(absent[0], "the rig's IMUs and encoders need " + ", ".join(needed)) if absent and not alone \
            else None
    if m.model != "leg2":
        by_meter = rig.distance_meter is not None and "distance_m" in present
        names = [f"q{joint}_rad" for joint in range(2 if by_meter else 1, joint_count(rig.mechanism) + 1)]
        absent = [name for name in names if name not in present]
        return Missing(absent[0], "add the joint's angle in rad") if absent else None
    if "q2_rad" not in present:
        return Missing("q2_rad", "add the knee's angle in rad")
    absent = [name for name in IMU if name not in present]
    if not absent or "q1_rad" in present:
        return None
    if len(absent) < len(IMU):
        return Missing(absent[0], "the IMU path needs all of " + ", ".join(IMU) + " (or give q1_rad)")
    return Missing("q1_rad", "add the pivot's angle, or the IMU columns " + ", ".join(IMU))


def _missing_joint1(rig: Rig, present: Collection[str]) -> Missing | None:
    prismatic = "q1_m" in present and "q1_rad" not in present
    if not prismatic and "q1_rad" not in present:
        return Missing("q1_rad", "add the joint's position: q1_rad, or q1_m for a prismatic joint")
    if 1 not in rig.mechanism.actuated:
        return None
    if rig.mechanism.input == "voltage" and VOLTAGE in present:
        return None
    if rig.servo is not None and not prismatic and "q1_cmd_rad" in present:
        return None if rig.mechanism.input == "torque" or "volts" in present else Missing(
            "volts", 'input = "voltage" needs the supply\'s volts')
    if rig.mechanism.input == "voltage":
        absent = [name for name in ("duty", "volts") if name not in present]
        return Missing(absent[0], 'input = "voltage" needs duty and volts') if absent else None
    torque = "tau1_n" if prismatic else "tau1_nm"
    if torque in present:
        return None
    if {"duty", "volts"} <= set(present):
        return Missing(torque, 'a servo driven by voltage needs input = "voltage" under [mechanism]')
    if "q1_cmd_rad" in present:
        return Missing(torque, _servo(1))
    return Missing(torque, "joint 1 is listed as actuated: add its measured torque or force, or the command that it "
                           "follows as q1_cmd_rad")
