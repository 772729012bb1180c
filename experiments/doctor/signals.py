"""Checks of what the devices said: rates, losses, clock, shunt, gravity, and with the leg moved signs and scales."""

from __future__ import annotations

import numpy as np

from daq import Dataset, FloatArray, InputError, Rig, imu_columns
from daq.timing import align, is_polled
from experiments.doctor.check import Check, Heard
from experiments.judge import BOUND_S, clock_bound_s

RATE_TOLERANCE = 0.06
LOST_SHARE = 0.01
SLOW_SHARE = 0.9
"""Of the rate at which a drive is to be polled."""
SHUNT_SHARE = 0.005
"""Offset of the shunt that counts, as a share of the torque limit."""
STILL_RADPS = 0.05
"""A pivot whose speed varies by less hangs still, whatever the gyro's bias."""
BIAS_RADPS = 0.02
GRAVITY_WARN, GRAVITY_FAIL = 0.03, 0.15
MOVED_RAD = 0.1
"""Standard deviation of an angle that is enough to judge a scale by."""
SCALE_WARN, SCALE_FAIL = 0.03, 0.15
MOVE_RATE_HZ = 100.0


def judge(heard: Heard, rig: Rig, imu: bool, controller: bool, moved: bool, told: bool = True) -> list[Check]:
    """Checks of a record in which nothing was commanded. `told`: a rig file says what is expected."""
    checks = []
    if controller:
        checks += [_telemetry(heard, rig), _clock(heard, rig)]
        if told:
            checks.append(_shunt(heard, rig))
    if imu:
        checks.append(_samples(heard, rig))
        if not moved and told:
            checks += _rest(heard, rig)
    return [*checks, *_motion(heard, rig, imu, controller)] if moved else checks


def _telemetry(heard: Heard, rig: Rig) -> Check:
    count = heard.raw.streams["/leg/telemetry"].size
    hurt = heard.bad + heard.lost
    words = f"{count / heard.seconds:.0f} frames/s, {heard.lost} lost, {heard.bad} damaged"
    if not count:
        return Check("telemetry", "FAIL", "none came; check the firmware and the cable")
    if hurt > LOST_SHARE * count:
        return Check("telemetry", "FAIL", f"{words}; check cable, ground and baud rate")
    wanted = rig.devices.controller.rate_hz if rig.devices.controller else 0.0
    if is_polled(heard.raw) and count / heard.seconds < SLOW_SHARE * wanted:
        return Check("telemetry", "warn", f"{words}, {wanted:g} are asked for: the bus or this computer carries no "
                                          "more; lower [devices.controller] rate_hz")
    return Check("telemetry", "warn" if hurt else "ok", words + ("; check cable and ground" if hurt else ""))


def _clock(heard: Heard, rig: Rig) -> Check:
    probes = heard.raw.streams["/leg/clock"]
    if not probes.size:
        return Check("clock bound", "FAIL", "no clock probe was answered; check the firmware")
    bound_s = clock_bound_s(heard.raw)
    words = f"the controller's clock is known to {bound_s * 1e6:.0f} us, [limits] clock_bound_s is " \
            f"{rig.limits.clock_bound_s * 1e6:.0f} us"
    if bound_s > rig.limits.clock_bound_s:
        return Check("clock bound", "FAIL", f"{words}; use CAN, USB-ACM or a short latency timer, and an idle machine")
    if bound_s > BOUND_S:
        return Check("clock bound", "warn", f"{words}; a skew above {BOUND_S * 1e3:g} ms can pass for friction")
    return Check("clock bound", "ok", words)


def _shunt(heard: Heard, rig: Rig) -> Check:
    telemetry = heard.raw.streams["/leg/telemetry"]
    current = telemetry["current_a"][(telemetry["state"] == 0) & np.isfinite(telemetry["current_a"])]
    if current.size < 2:
        return Check("shunt zero", "FAIL", "no current reading while disarmed; check the current sensor")
    c = rig.calibration
    mean, error = float(current.mean()), float(current.std()) / np.sqrt(current.size)
    torque = (mean - c.shunt_offset_a) * c.torque_constant_nm_per_a
    words = f"{mean:+.4f} +- {2 * error:.1g} A with the motor off, shunt_offset_a is {c.shunt_offset_a:g}: " \
            f"{torque:+.3g} N m too much"
    if abs(torque) > max(SHUNT_SHARE * rig.limits.torque_nm, 5 * error * c.torque_constant_nm_per_a):
        return Check("shunt zero", "FAIL", f"{words}; set [calibration] shunt_offset_a = {mean:.4f}")
    return Check("shunt zero", "ok", words)


def _samples(heard: Heard, rig: Rig) -> Check:
    samples = heard.raw.streams["/imu"]
    nominal = rig.devices.imu.rate_hz if rig.devices.imu else 0.0
    if samples.size < 2:
        return Check("IMU samples", "FAIL", "none came; power-cycle the chip")
    seconds = float(samples["drain_after_ns"][-1] - samples["drain_after_ns"][0]) * 1e-9
    first = int((samples["drain_after_ns"] == samples["drain_after_ns"][0]).sum())
    rate, gaps = (samples.size - first) / max(seconds, 1e-9), int(samples["gap_before"].sum())
    words = f"{rate:.1f} Hz (nominal {nominal:g}), {gaps} gaps"
    if gaps:
        return Check("IMU samples", "FAIL", f"{words}; raise the bus clock, lower rate_hz, or give the program "
                                            "real-time priority (@group - rtprio 5 in /etc/security/limits.conf)")
    if abs(rate - nominal) > RATE_TOLERANCE * nominal:
        return Check("IMU samples", "FAIL", f"{words}; the chip is of another kind, or its supply is bad")
    return Check("IMU samples", "ok", words)


def _rest(heard: Heard, rig: Rig) -> list[Check]:
    """Bias and gravity, of a leg that hangs still."""
    columns = _imu(heard, rig)
    gyro = columns["gyro_radps"]
    if gyro.size < 2 or float(gyro.std()) > STILL_RADPS:
        return [Check("IMU at rest", "warn", "the leg moves; let it hang still, then look again")]
    bias, g = float(gyro.mean()), rig.mechanism.gravity_mps2
    a_x, a_y = float(columns["accel_x_mps2"].mean()), float(columns["accel_y_mps2"].mean())
    size, checks = float(np.hypot(a_x, a_y)), []
    remedy = "legid calibrate imu"
    words = f"gyro {bias:+.4f} rad/s"
    checks.append(Check("gyro bias", "warn", f"{words} at rest; {remedy}") if abs(bias) > BIAS_RADPS else
                  Check("gyro bias", "ok", words))
    words = f"{size:.3f} m/s2 at rest, gravity is {g:g}; x {a_x:+.2f}, y {a_y:+.2f}"
    off = abs(size - g) / g
    if off > GRAVITY_FAIL or a_y > -0.7 * size:
        return [*checks, Check("gravity", "FAIL", f"{words}, a hanging leg has y = -{g:g}; correct [calibration] "
                                                  "imu_mount (its rows are the link's axes in the chip's frame)")]
    return [*checks, Check("gravity", "warn", f"{words}; {remedy} --six-positions") if off > GRAVITY_WARN else
            Check("gravity", "ok", words)]


def _imu(heard: Heard, rig: Rig) -> dict[str, FloatArray]:
    samples = heard.raw.streams["/imu"]
    counts = np.column_stack([samples[f"{kind}_{axis}"] for kind in ("gyro", "accel") for axis in "xyz"])
    from drivers import ImuConfig

    device = rig.devices.imu
    config = ImuConfig(device.rate_hz, device.accel_range_g, device.gyro_range_dps) if device else ImuConfig()
    return imu_columns(counts, config.scale, rig.calibration)


# -- the leg moved by hand ---------------------------------------------------------------------------------


def _motion(heard: Heard, rig: Rig, imu: bool, controller: bool) -> list[Check]:
    """Do encoders, Hall sensors and IMU agree in sign and scale?"""
    if not controller:
        return [Check("signs and scales", "FAIL", "the controller's angles are needed; fix the controller first")]
    telemetry = heard.raw.streams["/leg/telemetry"]
    both = np.isfinite(telemetry["knee_rad"]) & np.isfinite(telemetry["knee_hall_rad"])
    checks = []
    if both.any():
        checks.append(_agree("knee encoder", "its encoder against its Hall sensor", telemetry["knee_hall_rad"][both],
                             telemetry["knee_rad"][both], "correct [motor] gear_ratio or the encoder's direction"))
    if not imu:
        return checks
    try:
        data = align(heard.raw, rig, MOVE_RATE_HZ)
    except InputError as error:
        return [*checks, Check("gyro", "FAIL", str(error))]
    if "q1_rad" not in data:
        return [*checks, Check("gyro", "warn", "no pivot angle is measured, so nothing to compare the IMU with")]
    return [*checks, *_imu_agrees(data, rig)]


def _imu_agrees(data: Dataset, rig: Rig) -> list[Check]:
    data = data.part(max(data.segments(["q1_rad", "gyro_radps", "accel_x_mps2", "accel_y_mps2"]), default=slice(0),
                         key=lambda s: s.stop - s.start))
    if len(data) < MOVE_RATE_HZ:
        return [Check("gyro", "FAIL", "no second without a gap; fix the failures above first")]
    q1, w = data["q1_rad"], data["gyro_radps"]
    g, arm = rig.mechanism.gravity_mps2, rig.imus[0].lever_arm_m
    turned = np.concatenate(([0.0], np.cumsum(0.5 * (w[1:] + w[:-1])) * data.dt_s))
    checks = [_agree("gyro", "its integral against the pivot's angle", q1, turned,
                     "turn the third row of [calibration] imu_mount, or correct [devices.imu] gyro_range_dps",
                     drift=True)]
    if checks[0].status == "FAIL":
        return checks
    # Contract: a_x = l q1dd + g sin q1; a_y = -l q1d^2 - g cos q1.
    a_x = arm * np.gradient(w, data.dt_s) + g * np.sin(q1)
    checks.append(_agree("accelerometer x", "against gravity and the pivot's angle", a_x, data["accel_x_mps2"],
                         "turn the first row of [calibration] imu_mount, or correct accel_range_g", MOVED_RAD * g))
    a_y, mean = -arm * w**2 - g * np.cos(q1), float(data["accel_y_mps2"].mean())
    return [*checks, _scaled("accelerometer y", "against gravity", mean / float(a_y.mean()),
                             "turn the second row of [calibration] imu_mount, or correct accel_range_g")]


def _agree(name: str, what: str, x: FloatArray, y: FloatArray, remedy: str, enough: float = MOVED_RAD,
           drift: bool = False) -> Check:
    """Check of the slope of y over x, fitted together with a constant and, with `drift`, a drift in time."""
    if float(np.std(x)) < enough and float(np.std(y)) < enough:
        return Check(name, "FAIL", f"{what}: the joint was not moved enough; swing it about half a radian to each side")
    terms = [x, np.ones_like(x), *([np.linspace(-1, 1, x.size)] if drift else [])]
    return _scaled(name, what, float(np.linalg.lstsq(np.column_stack(terms), y, rcond=None)[0][0]), remedy)


def _scaled(name: str, what: str, slope: float, remedy: str) -> Check:
    words = f"{what}: sign {'agrees' if slope > 0 else 'is WRONG'}, scale {abs(slope):.3f}"
    off = abs(slope - 1.0)
    if not off <= SCALE_FAIL:
        return Check(name, "FAIL", f"{words}; {remedy}")
    return Check(name, "warn", f"{words}; calibrate it") if off > SCALE_WARN else Check(name, "ok", words)
