"""A commented rig.toml from a few facts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from daq import ASSUMED, JOINTS, InputError, parse_rig, quoted, write_file
from experiments.rig.tolerances import tolerance_table

Line = Callable[..., str]


@dataclass(frozen=True)
class RigFacts:
    """Facts that `legid init` asks for or finds; the defaults are those of a small leg. SI units."""

    model: str = "leg2"
    links: int = 2
    actuated: tuple[int, ...] = (2,)
    gravity_mps2: float = 9.81
    lever_arm_m: float = 0.2
    gear_ratio: float = 1.0
    torque_constant_nm_per_a: float = 1.0
    bus: str | None = None
    """I2C bus of the IMU; None: there is none, or it was not found."""
    address: int = 0x6B
    magnetometer: int | None = None
    port: str | None = None
    """Serial port of the controller; None: it is on CAN, or was not found."""
    can_channel: str | None = None
    kind: str = "legid"
    """Of the drive."""
    node: int = 0
    rate_hz: float = 500.0
    watchdog_ms: int = 100
    torque_nm: float = 2.0
    speed_radps: float = 15.0
    q1_rad: float = 1.6
    q2_rad: float = 2.6
    servo: bool = False
    """The driven joints follow commands and log no torque."""
    voltage: bool = False
    """The joint's motor is driven by a voltage that is logged."""
    records: bool = True
    """False: the rig has no controller and is for imported files."""
    known: frozenset[str] = frozenset()
    """Names of the fields that somebody gave or a device told; the rest is marked as assumed."""


def default_actuated(model: str, links: int) -> tuple[int, ...]:
    """Joints that usually have a motor: all but the first, which hangs freely; the only one of a single joint."""
    n = JOINTS.get(model, links)
    return tuple(range(2, n + 1)) or (1,)


def rig_toml(facts: RigFacts) -> str:
    """The file's text, every key with its unit and meaning."""
    def line(key: str, value: str, note: str, field: str | None = None) -> str:
        """`field`: where the value is one that must be known, and is marked when nobody gave it."""
        mark = f"  {ASSUMED}" if field is not None and field not in facts.known else ""
        return f"{key} = {value}".ljust(33) + f" # {note}{mark}"

    then = ", then run: legid doctor --rig this file" if facts.records else ""
    parts = [f"# A rig of legid, written by legid init. Check every line marked ASSUMED{then}", "", "[mechanism]",
             line("model", quoted(facts.model), "leg2 | biped3 | joint1 | chain")]
    if facts.model == "chain":
        parts.append(line("links", str(facts.links), "number of links"))
    parts += [line("actuated", str(list(facts.actuated)), "joints with a motor; the others carry no torque"),
              line("gravity_mps2", _number(facts.gravity_mps2), "local gravity [m/s2]"),
              *([line("input", '"voltage"', "duty times volts drives the motor: parameters in volt units")]
                if facts.voltage else []), "",
              *(_servo() if facts.servo else []),
              "[imu]", line("lever_arm_m", _number(facts.lever_arm_m), "pivot to IMU along link 1 [m]", "lever_arm_m"),
              "# cutoff_hz = [76.0, 105.0]      # low passes of gyro, accelerometer [Hz]; absent: of the recorder",
              '# stamped = "sample"             # its times: sample | arrival, the second needs odr_hz',
              "", "[motor]",
              line("gear_ratio", _number(facts.gear_ratio), "motor turns per turn of the joint", "gear_ratio"),
              *([] if facts.kind == "legid" else [
                  line("side", '"motor"', "motor | joint: where the drive's angle and torque are meant", "side"),
                  line("sign", "1", "-1: the drive counts backwards when the knee's angle grows", "sign")]), "",
              "[sampling]", "# rate_hz = 100.0               # grid of all runs [Hz]; absent: the record's own rate",
              line("hold", '"auto"', "torque between samples: zero | past | linear | average | smooth, or likeliest"),
              "", *tolerance_table(line), ""]
    if not facts.records:
        more = "# A rig that records has [devices], [limits] and [calibration], too: docs/rig.md"
        return "\n".join([*parts, more, ""])
    parts += [*_imu(facts, line), "", *_controller(facts, line), "",
              "[limits]                          # beyond any of these the torque goes to zero and the run stops",
              line("torque_nm", _number(facts.torque_nm), "joint torque [N m]", "torque_nm"),
              line("speed_radps", _number(facts.speed_radps), "speed of either joint [rad/s]", "speed_radps"),
              line("q1_speed_radps", _number(min(facts.speed_radps, 8.5)), "of the pivot: the gyro must show it"),
              line("q1_rad", _number(facts.q1_rad), "pivot, either side of hanging [rad]", "q1_rad"),
              line("q2_rad", _number(facts.q2_rad), "knee, either side of straight [rad]", "q2_rad"),
              line("temperature_degc", "70.0", "motor [degC]"),
              line("staleness_s", "0.1", "longest silence of a device [s]"),
              line("clock_bound_s", "0.005", "uncertainty of the controller's clock [s]"),
              *([] if facts.kind == "legid" else [
                  line("unchecked", '["encoder_s"]', "this drive reads the knee by one sensor")]), "",
              "[calibration]",
              line("knee_zero_rad", "0.0", "reading of the knee encoder when the knee is straight [rad]",
                   "knee_zero_rad"),
              line("shunt_offset_a", "0.0", "current reading with the motor off [A]; legid doctor tells",
                   "shunt_offset_a"),
              line("torque_constant_nm_per_a", _number(facts.torque_constant_nm_per_a),
                   "joint torque per ampere, gear included", "torque_constant_nm_per_a"),
              "# rows: the link's x (where the IMU moves as q1 grows), y (away from the pivot), z (reads q1's speed)",
              "# in the chip's frame; legid doctor --move tells a wrong sign",
              line("imu_mount", "[[1, 0, 0], [0, 1, 0], [0, 0, 1]]", ASSUMED),
              "# gyro_bias_radps, accel_bias_mps2, accel_matrix: written by legid calibrate imu", ""]
    return "\n".join(parts)


def _servo() -> list[str]:
    """The table of a drive that follows a command; docs/rig.md has all its keys."""
    return ["[servo]                           # torque = gain * (q_cmd - q) - damping * qd, within +-limit",
            "# gain = 6.0                      # [N m/rad]; absent: a fit finds it by one parameter given with --fix",
            "# damping = 0.0                   # [N m s/rad]",
            "# limit = 1.2                     # [N m]", ""]


def _imu(facts: RigFacts, line: Line) -> list[str]:
    if facts.bus is None:
        return ["# [devices.imu]                  # none found; uncomment when it is there", '# bus = "/dev/i2c-1"',
                "# address = 0x6B"]
    found = ["[devices.imu]", line("bus", quoted(facts.bus), "I2C bus"),
             line("address", f"0x{facts.address:02X}", "0x6B or 0x6A"),
             line("rate_hz", "238.0", "14.9, 59.5, 119, 238, 476 or 952 [Hz]"),
             line("accel_range_g", "4", "2, 4, 8 or 16"), line("gyro_range_dps", "500", "245, 500 or 2000"),
             line("bus_khz", "400.0", "clock of the bus; legid doctor measures it")]
    if facts.magnetometer is not None:
        found += [line("magnetometer", f"0x{facts.magnetometer:02X}", "its address"),
                  line("slow_hz", "10.0", "temperature and field, so many times a second")]
    return found


def _controller(facts: RigFacts, line: Line) -> list[str]:
    settings = [line("rate_hz", _number(facts.rate_hz), "telemetry [Hz]", "rate_hz"),
                line("watchdog_ms", str(facts.watchdog_ms), "torque ends after this silence [ms]")]
    drive = [line("kind", quoted(facts.kind), "which drive")] if facts.kind != "legid" else []
    if facts.can_channel is not None:
        return ["[devices.controller]", *drive,
                line("can", f'{{interface = "socketcan", channel = {quoted(facts.can_channel)}}}',
                     "python-can's settings"),
                line("node", str(facts.node), "the controller's node"), *settings]
    if facts.port is not None:
        node = [line("node", str(facts.node), "the drive's node")] if drive else []
        return ["[devices.controller]", *drive, line("port", quoted(facts.port), "serial port"),
                line("baud", "1000000", "bits per second"), *node, *settings]
    return ["# [devices.controller]           # none found; uncomment when it is there", '# port = "/dev/ttyACM0"']


def write_rig(path: Path, facts: RigFacts, more: str = "") -> str:
    """Write the file, which must not exist, with `more` tables at its end; returns its text. Raises `InputError`."""
    text = rig_toml(facts) + more
    parse_rig(text, str(path))
    if path.exists():
        raise already_there(path)
    write_file(path, text.encode())
    return text


def already_there(path: Path) -> InputError:
    """Message about a rig file that exists."""
    return InputError(str(path), "exists already", "give a new name: a rig file is never overwritten")


def _number(value: float) -> str:
    """As TOML's float."""
    return repr(float(value))
