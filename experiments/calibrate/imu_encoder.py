"""`legid calibrate imu-encoder`: a moving link's encoder against the IMU on it, in words and rig.toml."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from daq import Calibration, Dataset, FloatArray, InputError, Rig
from daq.runs import IMU, SUFFIXES, RawRun, read_csv, read_run
from daq.timing import align, align_table, measure_skew
from estimator import TWO_SIDED
from estimator.calibration import ACCEL, EncoderFit, Found, Segment, fit_imu
from experiments.calibrate.motor_off import Wanted
from experiments.calibrate.outcome import Outcome, rounded
from experiments.console import text_table

SWING_WISHES = (Wanted("the swing", "swing the link by hand the whole time, now fast, now slowly, as far as it goes"),)
COLUMNS = ["q1_rad", *IMU]
COMPARED = (("gyro", "rad/s"), ("accelerometer x", "m/s2"), ("accelerometer y", "m/s2"), ("angle by gravity", "rad"))
"""Name and unit of each of `estimator.calibration.imu_encoder.SIGNALS`."""
FOUND = ("found", "+-", "unit")
CHECK = ("before", "+-", "after", "+-", "unit")
BEYOND_M = 0.005
ACCEL_TERMS = [t.name for t in ACCEL[:5]]
"""Terms written to rig.toml's accelerometer keys: all of them, or none if one is open or none is significant."""
USUAL_HZ = 10.0
DEAREST = 0.1
"""Share of the rate: the band that is compared where the rig file names none."""


def read_moving(path: Path | str, rig: Rig) -> Dataset:
    """A run of any kind on the rig's grid; it need not have a torque. Raises `InputError`."""
    if Path(path).name.lower().endswith(SUFFIXES):
        return align_table(read_csv(path), rig.sampling.rate_hz)
    return align(read_run(path), rig)


def compare(runs: Sequence[Dataset], rig: Rig) -> EncoderFit:
    """The IMU's errors by the runs' q1_rad. Raises `InputError` or `FitError`."""
    for run in runs:
        for column in COLUMNS:
            if column not in run:
                raise InputError(run.name, f"has no column {column}", "give runs of a link whose angle q1_rad an "
                                 "encoder measures and whose IMU is recorded")
    rates = {run.rate_hz for run in runs}
    if len(rates) > 1:
        raise InputError(runs[-1].name, "has another rate than other runs", "give one rate_hz under [sampling]")
    (rate,) = rates
    cutoff = rig.filter.cutoff_hz or min(DEAREST * rate, USUAL_HZ)
    segments = [Segment(run["q1_rad"][here], np.column_stack([run[c][here] for c in IMU]))
                 for run in runs for here in run.segments(COLUMNS)]
    skews = [skew.seconds for run in runs if (skew := measure_skew(run)) is not None]
    return fit_imu(segments, rate, cutoff, rig.imus[0].lever_arm_m, rig.mechanism.gravity_mps2,
                   float(np.median(skews)) if skews else 0.0)


def calibrate_by_encoder(raws: Sequence[RawRun] | None, paths: Sequence[str], rig: Rig) -> Outcome:
    """Outcome by records in memory, else by files. Raises `InputError` or `FitError`."""
    runs = [read_moving(path, rig) for path in paths] if raws is None else [align(raw, rig) for raw in raws]
    fit = compare(runs, rig)
    native = raws is not None or not any(path.lower().endswith(SUFFIXES) for path in paths)
    values = _values(fit, rig, native)
    return Outcome(encoder_text(fit, rig) + _stays_words(fit, native), values, _warnings(fit), _left(fit, values))


def encoder_text(fit: EncoderFit, rig: Rig) -> str:
    """Every term with its interval, what is not determined, and what the rest of the record says of it."""
    lines = [f"fitted on the first {fit.fitted_s:.0f} s, checked on the other {fit.checked_s:.0f} s, below "
             f"{fit.cutoff_hz:g} Hz; 95 % intervals from {fit.blocks} blocks of {fit.block_s:.1f} s",
             text_table(["IMU against encoder", *FOUND], found_rows(fit), right={1, 2})]
    if fit.lag_wanders:
        low, high = np.percentile(fit.lags_s, [5, 95])
        lines.append(f"the IMU's lag wanders between {1e3 * low:.1f} and {1e3 * high:.1f} ms along the record: it was "
                     "taken out block by block, and no one lag is given; look at how the two clocks are compared")
    left = open_terms(fit)
    if left:
        lines.append("not determined: " + "; ".join(left))
    if "lever_arm" in fit.held:
        arm = rig.imus[0].lever_arm_m
        lines.append(f"the lever arm was fixed at rig.toml's {arm:g} m: this motion does not separate it from the "
                     "scales; drive the link, or swing it farther")
    return "\n".join([*lines, "", text_table(["rms on the rest, IMU less encoder", *CHECK], check_rows(fit),
                                             right={1, 2, 3, 4})])


def open_terms(fit: EncoderFit) -> list[str]:
    """Terms that the record does not determine."""
    return [f.term.meaning for f in fit.found if not f.determined or f.term.name in fit.held]


def found_rows(fit: EncoderFit) -> list[list[str]]:
    """One row of `FOUND` for each determined term, under its meaning."""
    return [[f.term.meaning, *_figures(f), f.term.unit] for f in fit.found if f.term.meaning not in open_terms(fit)]


def check_rows(fit: EncoderFit) -> list[list[str]]:
    """One row of `CHECK` for each signal, under its name."""
    return [[name, *(f"{v:.4f}" for v in (*before, *after)), unit]
            for (name, unit), before, after in zip(COMPARED, fit.before, fit.after)]


def _figures(f: Found) -> tuple[str, str]:
    digits = max(int(np.ceil(-np.log10(f.half))) + 1, 0) if f.half > 0 else 6
    return f"{f.value:+.{digits}f}", f"{f.half:.{digits}f}"


def _values(fit: EncoderFit, rig: Rig, native: bool) -> dict[str, dict[str, object]]:
    """Keys of rig.toml, none where they do not hold; [calibration] is of raw readings, so a CSV cannot change it."""
    values: dict[str, dict[str, object]] = {}
    c = rig.calibration
    keys: dict[str, object] = {}
    if worse(fit):
        return values
    if native and fit["gyro_bias"].determined:
        axis = np.asarray(c.imu_mount[2])
        keys["gyro_bias_radps"] = _list(np.asarray(c.gyro_bias_radps) + fit["gyro_bias"].value * axis)
    accel = [fit[name] for name in ACCEL_TERMS]
    if native and all(f.determined for f in accel) and any(abs(f.value) > f.half for f in accel):
        bias, matrix = corrected(fit, c)
        keys |= {"accel_bias_mps2": _list(bias), "accel_matrix": [_list(row) for row in matrix]}
    if keys:
        values["calibration"] = keys
    if fit["lever_arm"].determined and "lever_arm" not in fit.held:
        values["imu"] = {"lever_arm_m": rounded(max(fit["lever_arm"].value, 0.0))}
    return values


def _left(fit: EncoderFit, values: Mapping[str, Mapping[str, object]]) -> dict[str, float]:
    """Tolerances of what is written, and of the gyro's scale, which is not: its own size counts in full."""
    if worse(fit):
        return {}
    sigma = {f.term.name: f.half / TWO_SIDED for f in fit.found}
    left = {}
    if "accel_bias_mps2" in values.get("calibration", {}):
        left["accelerometer_bias"] = max(sigma["accel_bias_x"], sigma["accel_bias_y"])
    if "imu" in values:
        left["imu_lever_arm"] = sigma["lever_arm"]
    if fit["gyro_scale"].determined and "gyro_scale" not in fit.held:
        left["gyro_scale"] = float(np.hypot(fit["gyro_scale"].value, sigma["gyro_scale"]))
    return left


def corrected(fit: EncoderFit, c: Calibration) -> tuple[FloatArray, FloatArray]:
    """Accelerometer bias (3,) and matrix (3, 3) of the rig with what was found taken out too.

    The turn stays: it may be the encoder's zero as well as the mount.
    """
    mount, matrix = np.asarray(c.imu_mount), np.asarray(c.accel_matrix)
    scale = np.eye(3)
    scale[:2, :2] += [[fit["accel_scale_x"].value, fit["accel_skew"].value],
                      [fit["accel_skew"].value, fit["accel_scale_y"].value]]
    bias = np.array([fit["accel_bias_x"].value, fit["accel_bias_y"].value, 0.0])
    back = np.linalg.inv(mount)
    return np.asarray(c.accel_bias_mps2) + np.linalg.solve(matrix, back @ bias), \
        back @ np.linalg.inv(scale) @ mount @ matrix


def _list(values: FloatArray) -> list[float]:
    return [rounded(float(np.round(v, 9))) for v in values]


def _stays_words(fit: EncoderFit, native: bool) -> str:
    """What was found and has no place in rig.toml."""
    sure = [f.term.meaning for name in ("gyro_scale", "gyro_late", "accel_late", "accel_turn")
            if (f := fit[name]).determined and name not in fit.held and abs(f.value) > f.half]
    words = []
    if sure:
        words.append(f"rig.toml has no key for: {'; '.join(sure)}. A scale or an angle may be the encoder's as well; "
                     "a diagnosis looks for gyro_scale, sensor_time_skew and encoder_offset")
    if not native:
        words.append("[calibration] is not changed: it applies to raw readings, and a CSV has calibrated ones")
    return "".join(f"\n{line}" for line in words)


def worse(fit: EncoderFit) -> list[str]:
    """Signals that the correction made worse on the rest of the record."""
    return [name for (name, _), before, after in zip(COMPARED, fit.before, fit.after)
            if after[0] - after[1] > before[0]]


def _warnings(fit: EncoderFit) -> list[str]:
    found = [f"on the rest of the record, {name} is farther from the encoder after the correction than before: the "
             "motion there is another, or the errors change; nothing is written" for name in worse(fit)]
    lever = fit["lever_arm"]
    if lever.determined and lever.value < -lever.half - BEYOND_M:
        found.append(f"the lever arm is {lever.value:.4f} m, beyond the pivot; rig.toml accepts none below 0")
    return found
