"""`legid calibrate mount`: rest and swing into mount matrix and lever arm, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq import Calibration, FloatArray, InputError, Rig, WorkError
from daq.calibration import LEAST_STILL_S, StillRecord, still_record
from daq.runs import Mean, RawRun, mean_interval, mean_of
from daq.timing import align
from estimator import TWO_SIDED
from estimator.calibration import MountFit, Readings, fit_mount
from estimator.signals import lowpass
from experiments.calibrate.motor_off import Wanted
from experiments.calibrate.outcome import Outcome, friction_of, rounded
from experiments.models import Model

MOUNT_WISHES = (Wanted("the rest", "let the leg hang still"),
          Wanted("the swing", "push the leg so that it swings by 30 degrees or more to either side, let go"))
LEAST_SWING_S = 5.0
WIDEST_RAD = 0.05
"""Half interval of an angle beyond which the mount says nothing."""
WIDEST_M = 0.02
BIAS_WARN_MPS2 = 0.1
PIECE_S = 0.1
REST_RADPS = 0.03
"""How far the gyro's mean over a tenth of a second may wander at rest."""
HALL_HZ = 5.0
AGREES = 0.5


def calibrate_mount(raws: Sequence[RawRun], rig: Rig, model: Model | None = None) -> Outcome:
    """Mount and lever arm. Raises `InputError`, `WorkError` or `FitError`."""
    c, g = rig.calibration, rig.mechanism.gravity_mps2
    records = [still_record(raw) for raw in raws]
    rests = [mean for record in records if (mean := _rest_mean(record, c)) is not None]
    swings = [(raw, record) for raw, record in zip(raws, records) if _moves(record)]
    if not rests:
        raise WorkError(f"no record holds {LEAST_STILL_S:g} s of the leg hanging still; record that too")
    if not swings:
        raise WorkError("the leg swings in no record; push it by 30 degrees or more, then let it swing")
    short = [record.name for _, record in swings if record.seconds < LEAST_SWING_S]
    if short:
        raise WorkError(f"{short[0]}: less than {LEAST_SWING_S:g} s of swing; record for longer")
    readings = [Readings(np.arange(len(r.gyro_radps)) / r.rate_hz, r.gyro_radps, _calibrated(r, c)) for _, r in swings]
    fit = fit_mount(readings, _rest_statistics(rests), np.asarray(c.imu_mount[2]), g)
    sign, fit = _signed(fit, [raw for raw, _ in swings], rig)
    if fit.angle_half.max() > WIDEST_RAD:
        raise WorkError(f"the mount's angles are known to {', '.join(f'{h:.2g}' for h in fit.angle_half)} rad only; "
                        "swing wider and for longer")
    if fit.lever_m < -fit.lever_half:
        raise WorkError(f"the estimated place of the IMU is {-fit.lever_m:.3f} m above the pivot; it must be on link "
                        "1, below it")
    return _outcome(fit, rig, len(rests), sign, model)


def _outcome(fit: MountFit, rig: Rig, rests: int, sign: str, model: Model | None) -> Outcome:
    friction = 0.0
    if model is not None:
        leg = friction_of(model)
        friction = (leg["beta8"] + leg["beta9"]) / (leg["beta4"] * rig.mechanism.gravity_mps2)
    rows = "\n".join(f"  {name} = [{', '.join(f'{v:+.5f}' for v in row)}]" for name, row in zip("xyz", fit.mount))
    about = fit.angle_half + np.array([0.0, 0.0, friction])
    angles = ", ".join(f"{name} {h:.2g}" for name, h in zip("xyz", about))
    lines = [f"a swing of {np.degrees(fit.swing_rad):.0f} degrees from end to end, {rests} "
             f"{'segment' if rests == 1 else 'segments'} at rest; noise of one sample {fit.noise[0]:.2g} rad/s, "
             f"{fit.noise[1]:.2g} m/s2",
             "imu_mount (rows: the link's axes in the chip's frame):", rows,
             f"known about the link's axes to +- {angles} rad (95 %)",
             f"{'right' if np.linalg.det(fit.mount) > 0 else 'left'}-handed, {_against(fit.mount, rig)}; {sign}",
             f"lever arm: {fit.lever_m:.5f} +- {fit.lever_half:.2g} m (95 %); rig.toml had "
             f"{rig.imus[0].lever_arm_m:g} m",
             f"distance from the line through the pivot: {fit.side_offset_m:+.5f} +- {fit.side_offset_half:.2g} m",
             "gyro bias [rad/s]: " + _with_half(fit.gyro_bias_radps, fit.gyro_bias_half, 5),
             "accelerometer bias left [m/s2]: " + _with_half(fit.accel_bias_mps2, fit.accel_bias_half, 4)]
    lines.append(f"friction may hold link 1 by {friction:.2g} rad off the vertical: in the angle about z"
                 if model is not None else
                 "about z, q1 = 0 is where the leg came to rest: friction may hold it (beta8 + beta9) / (beta4 g) rad "
                 "off the vertical, which the interval does not include; --model adds it")
    warnings = []
    sizes = np.abs(fit.accel_bias_mps2) - fit.accel_bias_half
    if sizes.max() > BIAS_WARN_MPS2:
        warnings.append(f"the accelerometer's bias is above {BIAS_WARN_MPS2} m/s2; "
                        "run legid calibrate imu --six-positions")
    if abs(fit.side_offset_m) - fit.side_offset_half > max(0.1 * fit.lever_m, 0.005):
        warnings.append(f"the IMU sits {abs(fit.side_offset_m) * 1e3:.0f} mm off the line along link 1; "
                        "no estimator models that: move it onto the line")
    values: dict[str, dict[str, object]] = {
        "calibration": {"imu_mount": [[rounded(float(np.round(v, 7))) for v in row] for row in fit.mount]}}
    if fit.lever_half > WIDEST_M:
        warnings.append(f"the lever arm is not determined (+- {fit.lever_half:.2g} m) and not written; swing faster")
    else:
        values["imu"] = {"lever_arm_m": rounded(max(fit.lever_m, 0.0))}
    left = {"imu_lever_arm": fit.lever_half / TWO_SIDED} if "imu" in values else {}
    if model is not None:  # else friction's share of the angle is not known
        left["imu_misalignment"] = float(about[2]) / TWO_SIDED
    return Outcome("\n".join(lines), values, warnings, left)


def _against(mount: FloatArray, rig: Rig) -> str:
    """How the mount differs from the rig file's."""
    turn = mount @ np.asarray(rig.calibration.imu_mount).T
    if np.linalg.det(turn) < 0:
        return "rig.toml's is a mirror image of it"
    angle = np.degrees(np.arccos(np.clip(0.5 * (np.trace(turn) - 1.0), -1.0, 1.0)))
    return f"turned by {angle:.2f} degrees against rig.toml's"


def _with_half(values: FloatArray, halves: FloatArray, digits: int) -> str:
    return ", ".join(f"{v:+.{digits}f} +- {h:.1g}" for v, h in zip(values, halves))


def _calibrated(record: StillRecord, c: Calibration) -> FloatArray:
    """(n, 3) accelerometer in the chip's axes, bias and matrix of the rig applied."""
    accel: FloatArray = (record.accel_mps2 - np.asarray(c.accel_bias_mps2)) @ np.asarray(c.accel_matrix).T
    return accel


def _pieces(record: StillRecord) -> tuple[FloatArray, int]:
    """Means of the gyro over `PIECE_S` (k, 3), and samples in each."""
    size = max(int(PIECE_S * record.rate_hz), 1)
    count = len(record.gyro_radps) // size
    return record.gyro_radps[: count * size].reshape(count, size, 3).mean(axis=1), size


def _moves(record: StillRecord) -> bool:
    pieces, _ = _pieces(record)
    return bool(np.ptp(pieces, axis=0).max() > 10 * REST_RADPS)


def _rest_mean(record: StillRecord, c: Calibration) -> list[Mean] | None:
    """Accelerometer's mean by axis over the longest segment at rest; None where there is none of `LEAST_STILL_S`."""
    pieces, size = _pieces(record)
    longest, start = (0, 0), 0
    for k in range(len(pieces)):
        while np.ptp(pieces[start: k + 1], axis=0).max() > REST_RADPS:
            start += 1
        longest = max(longest, (k + 1 - start, start))
    length, start = longest
    if length * size < LEAST_STILL_S * record.rate_hz * 0.98:
        return None
    here = _calibrated(record, c)[start * size: (start + length) * size]
    return [mean_of(here[:, axis]) for axis in range(3)]


def _rest_statistics(rests: Sequence[list[Mean]]) -> list[tuple[FloatArray, FloatArray]]:
    """(mean, half of 95 %) by segment; three and more also show how well the leg finds back to one pose."""
    values = np.array([[m.value for m in rest] for rest in rests])
    halves = np.array([[m.half for m in rest] for rest in rests])
    if len(rests) >= 3:
        spread = np.array([mean_interval(values[:, axis])[1] for axis in range(3)]) * np.sqrt(len(rests))
        halves = np.maximum(halves, spread)
    return list(zip(values, halves))


def _signed(fit: MountFit, raws: Sequence[RawRun], rig: Rig) -> tuple[str, MountFit]:
    """What says which way q1 grows, and the fit that way: the pivot's Hall sensor, else the mount in rig.toml."""
    import msgspec

    rows = tuple(tuple(float(v) for v in row) for row in fit.mount)
    turned = msgspec.structs.replace(rig, calibration=msgspec.structs.replace(rig.calibration, imu_mount=rows))
    for raw in raws:
        try:
            run = align(raw, turned)
        except InputError:
            continue
        if "q1_rad" not in run:
            continue
        here = ~run.gap(["q1_rad", "gyro_radps"])
        rate = lowpass(np.gradient(run["q1_rad"][here], run.dt_s), HALL_HZ, run.rate_hz)
        match = float(np.corrcoef(rate, run["gyro_radps"][here])[0, 1])
        if abs(match) > AGREES:
            return "q1 grows as the pivot's Hall sensor says", fit if match > 0 else fit.turned_round()
    return ("which way q1 grows is taken from rig.toml's mount: with the knee bent forwards (q2 > 0) the leg must hang "
            "at q1 < 0", fit)
