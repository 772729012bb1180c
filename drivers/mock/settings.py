"""Settings of an emulated rig: errors, noise, clocks, limits. The noise figures are assumptions."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.protocol import Reaction

Vector3 = tuple[float, float, float]
Matrix3 = tuple[Vector3, Vector3, Vector3]


@dataclass(frozen=True)
class ImuSettings:
    """The chip's place, errors and noise. The datasheet gives no noise density: these are made up."""

    lever_arm_m: float = 0.20
    gravity_mps2: float = 9.81
    mount: Matrix3 = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    """Rows: contract x, y, z axes in the chip's frame."""
    gyro_noise_radps: float = 0.005
    accel_noise_mps2: float = 0.05
    gyro_bias_radps: Vector3 = (0.0, 0.0, 0.0)
    accel_bias_mps2: Vector3 = (0.0, 0.0, 0.0)
    """Biases, in the chip's axes."""
    accel_matrix: Matrix3 = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    """What a calibration multiplies the accelerometer's readings by, biases taken off: the chip errs by its inverse."""
    rate_error: float = 0.012
    """The chip's oscillator is fast by this share of the nominal rate."""
    temperature_degc: float = 31.0


@dataclass(frozen=True)
class PivotSettings:
    """Mounting of the pivot's magnet over its AS5600, and the chip's errors."""

    zero_rad: float = 0.0
    """What the chip reads when the leg hangs."""
    sign: int = 1
    """-1: it counts down while q1 grows."""
    noise_rad: float = 7.5e-4
    """0.043 degrees, the datasheet's figure for the slow filter at 2x."""
    eccentricity_rad: float = 0.0
    """Amplitude of the error once a turn, from a magnet off the axis."""


@dataclass(frozen=True)
class ShuntSettings:
    """A current monitor in the motor's lead."""

    shunt_ohm: float = 0.01
    sign: int = 1
    offset_v: float = 0.0
    """Offset of the chip's input [V]; the INA226 has up to 10 uV."""
    noise_v: float = 4e-6
    clock_error: float = 0.0
    """The chip's conversions are longer by this share of the nominal time."""
    torque_constant_nm_per_a: float = 1.0
    """Joint torque that a current really makes, gear included."""


@dataclass(frozen=True)
class FirmwareSettings:
    """The controller's sensors, motor, clock and limits."""

    telemetry_hz: int = 500
    gear_ratio: float = 50.0
    torque_limit_nm: float = 2.0
    watchdog_limit_ms: int = 1000
    torque_constant_nm_per_a: float = 1.0
    """Joint torque per ampere, gear included: what the drive believes."""
    torque_gain: float = 1.0
    """The joint gets so much of the torque that the drive believes to make: its constant is wrong by that."""
    current_noise_a: float = 0.02
    """Noise of one telemetry frame's mean [A]."""
    shunt_offset_a: float = 0.0
    current_loop_s: float = 0.001
    """Time constant with which the torque follows the command; 0 is at once."""
    encoder_counts: int = 8192
    """Knee encoder, counts per turn of the joint."""
    knee_zero_rad: float = 0.0
    """What the knee encoder reads when the knee is straight."""
    hall_counts: int = 1024
    hall_noise_rad: float = 0.002
    bus_v: float = 24.0
    bus_resistance_ohm: float = 0.1
    ambient_degc: float = 25.0
    heating_degc_per_a2: float = 2.0
    """Final temperature rise of the motor per ampere squared."""
    heating_time_s: float = 300.0
    current_limit_a: float = 30.0
    temperature_limit_degc: float = 90.0
    undervoltage_v: float = 18.0
    overvoltage_v: float = 30.0
    speed_limit_radps: float = 40.0
    speed_derate_radps: float = 32.0
    """Speed above which torque that speeds the knee up shrinks, to nothing at the limit."""
    position_min_rad: float = -6.28
    position_max_rad: float = 6.28
    """Limit of the angle that the knee encoder reads."""
    position_derate_rad: float = 0.3
    """So far before them torque towards them begins to shrink."""
    reaction: Reaction = Reaction.LIMP
    """Reaction to faults of the host or of the motion; to all others the drive goes limp."""
    brake_nms_per_rad: float = 0.5
    """Torque of the shorted motor per speed of the knee."""
    hold_stiffness_nm_per_rad: float = 20.0
    hold_damping_nms_per_rad: float = 2.0
    hold_torque_nm: float = 1.5
    hold_ms: int = 500
    clock_error_ppm: float = 40.0
    """The MCU's clock is fast by this."""
    first_tick_us: int = 0
    """Tick at boot; near 2^32 to see it wrap."""
    version: int = 1
