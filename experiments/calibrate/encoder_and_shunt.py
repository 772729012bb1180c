"""`legid calibrate encoder` and `shunt`: records with the motor off into zero and offset, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq import InputError, Rig, joint_count
from daq.calibration import (
    FEWEST_STOPS,
    Stop,
    friction_cone,
    hanging_zero,
    resting_current,
    resting_knee,
    resting_q1,
    still_record,
    straight_zero,
)
from daq.runs import RawRun, mean_interval
from estimator import TWO_SIDED
from experiments.calibrate.motor_off import Wanted
from experiments.calibrate.outcome import Outcome, friction_of, left_by_gravity, rounded
from experiments.models import Model

STOPS = 6
FEWEST_POSES = 3
"""Records of a leg held straight from which their scatter shows how well it can be held."""


def straight_wishes(records: int) -> list[Wanted]:
    """Instructions for `--straight`."""
    return [Wanted(f"hold {k + 1}", "hold or clamp the leg straight, knee and all") for k in range(records)]


def hanging_wishes(records: int) -> list[Wanted]:
    """Instructions for a hanging leg: from either side alternately."""
    return [Wanted(f"stop {k + 1}", f"bend the knee {('forwards', 'backwards')[k % 2]} by hand, let go, wait until the "
                   "leg hangs still") for k in range(records)]


def shunt_wishes() -> list[Wanted]:
    """Instructions for the shunt."""
    return [Wanted("the shunt", "let the leg hang still")]


def calibrate_knee(raws: Sequence[RawRun], rig: Rig, straight: bool, model: Model | None = None) -> Outcome:
    """Knee zero from records at rest. Raises `InputError` or `WorkError`."""
    step = TWO_SIDED * (rig.noise.encoder_of(-1) or 0.0)
    c, g = rig.calibration, rig.mechanism.gravity_mps2
    if straight:
        stops = [Stop(raw.name, resting_knee(raw)) for raw in raws]
        zero, cone = straight_zero(stops, step), None
    else:
        if any(not raw.streams["/imu"].size for raw in raws):
            raise InputError(next(raw.name for raw in raws if not raw.streams["/imu"].size), "holds no IMU samples",
                             "a hanging leg's angle is the IMU's; or hold the leg straight (--straight)")
        stops = [Stop(raw.name, resting_knee(raw), resting_q1(still_record(raw), c)) for raw in raws]
        cone = None
        if model is not None:
            leg = friction_of(model)
            cone = friction_cone(leg["beta9"], leg["beta5"], g)
        zero = hanging_zero(stops, cone, step)
    lines = [f"{stop.name}: knee reads {stop.knee.value:+.5f} +- {stop.knee.half:.1g} rad"
             + (f", link 1 hangs at {stop.q1.value:+.5f} +- {stop.q1.half:.1g} rad" if stop.q1 else "")
             for stop in stops]
    lines += ["", f"knee zero: {zero.value:+.5f} +- {zero.half:.2g} rad (95 %; {zero.how}), "
                  f"of which noise {zero.noise_half:.1g}",
              f"rig.toml had {c.knee_zero_rad:+.5f} rad"]
    warnings = []
    if not straight:
        lines.append("an error of the IMU's zero of q1 adds to it in full: an accelerometer bias of 0.1 m/s2 along the "
                     f"swing gives {0.1 / g:.3f} rad")
    if step == 0.0 and all(stop.knee.half == 0.0 for stop in stops):
        warnings.append("the encoder's reading never changed: the interval lacks its step; give [noise] encoder_rad")
    warnings += [f"{stop.name}: the knee crept by {stop.knee.drift:+.2g} rad; let it come to rest for longer"
                 for stop in stops if stop.knee.drifts and abs(stop.knee.drift) > max(step, 1e-3)]
    posed = not straight or len(stops) >= FEWEST_POSES
    left = float(np.hypot(zero.half / TWO_SIDED, 0.0 if straight else left_by_gravity(rig)))
    return Outcome("\n".join(lines), {"calibration": {"knee_zero_rad": rounded(zero.value)}}, warnings,
                   {f"encoder_offset.{joint_count(rig.mechanism)}": left} if posed else {})


def calibrate_shunt(raws: Sequence[RawRun], rig: Rig) -> Outcome:
    """Offset of the current shunt from records with the motor off. Raises `InputError` or `WorkError`."""
    means = [resting_current(raw) for raw in raws]
    if len(means) >= 3:
        value, half = mean_interval(np.array([m.value for m in means]))
        how = f"{len(means)} records"
    else:
        value = float(np.mean([m.value for m in means]))
        half = float(np.sqrt(np.sum([m.half**2 for m in means]))) / len(means)
        how = "block means"
    per_a = rig.calibration.torque_constant_nm_per_a
    lines = [f"{raw.name}: {m.value:+.5f} +- {m.half:.1g} A, drift {m.drift:+.1g} +- {m.drift_half:.1g} A"
             for raw, m in zip(raws, means)]
    lines += ["", f"shunt offset: {value:+.5f} +- {half:.2g} A (95 %, from {how}); as torque {per_a * value:+.5f} +- "
                  f"{per_a * half:.1g} N m", f"rig.toml had {rig.calibration.shunt_offset_a:+.5f} A"]
    warnings = [f"{raw.name}: the offset drifted by {m.drift:+.2g} +- {m.drift_half:.1g} A over the record, more than "
                f"its interval of {m.half:.1g} A; let the electronics warm up, then calibrate again"
                for raw, m in zip(raws, means) if m.drifts]
    if all(m.half == 0.0 for m in means):
        warnings.append("the current reading never changed: is the sensor connected?")
    drift = max((abs(m.drift) for m in means if m.drifts), default=0.0)
    left = per_a * float(np.hypot(half / TWO_SIDED, drift))
    return Outcome("\n".join(lines), {"calibration": {"shunt_offset_a": rounded(value)}}, warnings,
                   {f"torque_offset.{joint_count(rig.mechanism)}": left})


def fewest_stops(model: Model | None) -> int:
    """Number of stops of a hanging leg to ask for."""
    return STOPS if model is None else FEWEST_STOPS // 2
