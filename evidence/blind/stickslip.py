"""A family of plants of a third make: an event-driven leg with set-valued friction, and faults put into its readings.

Motion by `tests.support.stick_slip_leg`: reversals and rest found by root finding, the motor driven at 1 kHz, half of
the runs by an open-loop torque and half by a position controller, logged at 100 Hz. What is hidden is put into what is
logged, none by the library's formula where another is plausible; so it can be exact, whatever the leg does.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from evidence.blind.servo import Change, Readings, changed, of_case, truth_of, turned, write_case
from tests.support.mujoco_leg import GRAVITY, Leg, random_leg
from tests.support.stick_slip_leg import PEAK_NM, TICK_S, Motion, move

RATE_HZ, SECONDS, RUNS = 100.0, 20.0, 8
IMU = ("gyro_radps", "accel_x_mps2", "accel_y_mps2")


def _shift(names: tuple[str, ...], seconds: float) -> Change:
    def change(c: Readings) -> None:
        for name in names:
            c[name] = np.interp(c["time_s"] - seconds, c["time_s"], c[name])
    return change


MAKERS: dict[str, tuple[Callable[[float], Change], int | None]] = {
    "none": (lambda s: lambda c: None, None),
    "torque_offset": (lambda s: changed("tau2_nm", lambda u: u + 0.06 * s), None),
    "torque_delay": (lambda s: _shift(("tau2_nm",), 0.010 * s), None),
    # the motor gives less than the current says, softly: the reading is what was asked for
    "torque_saturation": (lambda s: changed("tau2_nm", lambda u: u + 0.10 * s * u**5 / PEAK_NM**4), None),
    "sensor_time_skew": (lambda s: _shift(IMU, 0.005 * s), None),
    "gyro_bias": (lambda s: changed("gyro_radps", lambda w: w + 0.03 * s), None),
    "gyro_scale": (lambda s: changed("gyro_radps", lambda w: w * (1.0 + 0.03 * s)), None),
    "accelerometer_bias": (lambda s: changed("accel_x_mps2", lambda a: a + 0.25 * s), None),
    "imu_misalignment": (lambda s: turned(0.03 * s), None),
    "encoder_offset": (lambda s: changed("q2_rad", lambda q: q + 0.03 * s), 2),
    "encoder_scale": (lambda s: changed("q2_rad", lambda q: q * (1.0 + 0.04 * s)), 2),
    "encoder_eccentricity": (lambda s: changed(
        "q2_rad", lambda q: np.unwrap(np.arctan2(np.sin(q) + 0.05 * s * np.sin(0.6), np.cos(q) - 0.05 * s))), 2),
    # nothing in the library does these
    "outside_gyro_dead_band": (lambda s: changed(
        "gyro_radps", lambda w: np.sign(w) * np.maximum(np.abs(w) - 0.06 * s, 0.0)), None),
    "outside_torque_dead_band": (lambda s: changed("tau2_nm", lambda u: u + 0.12 * s * np.tanh(u / 0.05)), None),
    "outside_encoder_kink": (lambda s: changed("q2_rad", lambda q: q + 0.05 * s * np.abs(q - 0.2)), None),
}
SIZES = {"torque_offset": {"offset": 0.06}, "torque_delay": {"delay": 0.010}, "sensor_time_skew": {"skew": 0.005},
         "gyro_bias": {"bias": 0.03}, "gyro_scale": {"scale_error": 0.03}, "accelerometer_bias": {"bias_x": 0.25},
         "encoder_offset": {"offset": 0.03}, "encoder_scale": {"scale_error": 0.04}}
"""Of ordinary strength, where the library's law has the same size."""


def make_case(name: str, seed: int, out: Path) -> None:
    """As `servo.make_case`."""
    rng = of_case(name, seed, 3)
    strength = rng.uniform(0.85, 1.15)
    leg, dry, runs = record([MAKERS[name][0](strength)] * RUNS, rng)
    write_case(name, seed, out, runs, rng, leg, "", truth_of(name, strength, SIZES), dry)


def record(changes: Sequence[Change], rng: np.random.Generator
           ) -> tuple[Leg, float, Iterator[Readings]]:
    """A random leg, its dry friction [N m], and its runs as logged, without noise: one with each of `changes`."""
    dry = rng.uniform(0.02, 0.10) * PEAK_NM
    leg = replace(random_leg(rng), coulomb=(0.005 + 0.1 * dry, dry))

    def logged(run: int, change: Change) -> Readings:
        high = (3.0, 2.0, 1.2, 2.5)[run // 2 % 4]
        readings = as_read(move(leg, rng, seconds=SECONDS, closed=run % 2 == 1, high=high))
        change(readings)
        return {k: v[:: round(1.0 / (RATE_HZ * TICK_S))] for k, v in readings.items()}

    return leg, dry, (logged(run, change) for run, change in enumerate(changes))


def as_read(motion: Motion) -> Readings:
    """What faultless sensors would read at every tick."""
    q1, q2, w, _, a, u0, u1 = motion.rows.T
    lever = motion.leg.lever
    return {"time_s": motion.time.copy(), "q2_rad": q2.copy(), "tau2_nm": 0.5 * (u0 + u1),
            "gyro_radps": w.copy(), "accel_x_mps2": lever * a + GRAVITY * np.sin(q1),
            "accel_y_mps2": -lever * w**2 - GRAVITY * np.cos(q1)}
