"""A recorded run to a `Dataset`: device clocks onto the host's, calibration, one uniform grid."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from daq.dataset import BoolArray, Dataset, FloatArray
from daq.errors import InputError
from daq.findings import Flag
from daq.looks import look
from daq.rig import Rig, parse_rig
from daq.rig_imu import Imu
from daq.runs import MIN_SAMPLES, RawRun
from daq.si_units import imu_columns, joint_torque, knee_angle
from daq.timing.clock import ImuClock, TickClock, fit_answers, fit_samples, fit_ticks
from daq.timing.clock_faults import (
    LEAST_PROBES,
    LEAST_ROWS,
    UNTIMED_RATIO,
    UNTIMED_S,
    Piece,
    apart,
    contradicting,
    paced_wrongly,
    pieces_of,
    runs_of,
)
from daq.timing.flags import flag_run
from daq.timing.held_torque import split_torque
from daq.timing.notes import configured, increasing, unusable
from daq.timing.polled import pivot_channel, shunt_channel
from daq.timing.resample import TimedColumns, align_channels, own_rate, reached

RAIL = 32_767
"""Counts of 16 bits at the end of an axis's range."""
LEAST_SHARE = 0.05
"""An axis of the chip with less in the link's plane than this has no part in what is fitted."""
LEAST_IMU_HZ, MOST_IMU_HZ = 1.0, 1e5
MOST_FAULTS = 4
"""Faults of a clock that are named one by one."""
MOST = 1e9
"""Largest magnitude of a reading [rad, N m, A, degC]; beyond it is a broken record."""


class Decoded(NamedTuple):
    """The samples of a native run in SI units, each at the time at which it was taken."""

    epoch_ns: int
    """Host's monotonic clock at the time 0 of the channels [ns]."""
    channels: list[TimedColumns]
    """At the controller's tick; the torque; with an IMU, last, its samples."""
    bound_s: float
    """How far the time line of the IMU, without one the pivot sensor's, may be off the controller's [s]."""
    flags: tuple[Flag, ...]
    """What cannot be true of one IMU on one leg."""
    clocks: Mapping[str, str]
    """What was timed -> how it ran against the host's clock, in words."""
    held: tuple[FloatArray, FloatArray] | None = None
    """Where the torque was sampled at instants: times at which commands were sent [s], and the commands [N m]."""


def decode(raw: RawRun, rig: Rig) -> Decoded:
    """Samples of the run with the columns of the CSV contract, at their own rates.

    Times count from the first message. `tau2_nm` is the mean current of a telemetry period and therefore
    placed half a period before its tick. `q1_rad`, from the pivot's own sensor or else its Hall sensor, is benchmark
    only; `tau2_shunt_nm` is the knee torque by the second shunt. Columns that were never measured are absent. Raises
    `InputError` when the run is too short to be timed.
    """
    telemetry = raw.streams["/leg/telemetry"]
    if telemetry.size < MIN_SAMPLES:
        raise unusable(raw, f"holds {telemetry.size} telemetry samples, at least {MIN_SAMPLES} are needed")
    epoch_ns = int(telemetry["host_ns"][0])
    asked = is_polled(raw)
    times = _telemetry_times(raw, telemetry, epoch_ns, asked)
    time_ns, clocks = times.time_ns, times.clocks
    if asked:
        time_ns = np.where(_sure(raw, telemetry, rig), time_ns, np.nan)
    instant = configured(raw, "drive").get("current") == "instant"
    channels = _leg_channels(raw, telemetry, time_ns, rig, instant)
    distance = raw.streams["/distance"]
    if distance.size:
        channels.append(_distance_channel(distance, epoch_ns))
    bound_s, words = 0.0, {"controller clock": _clock_words(clocks, time_ns if asked else None)}
    flagged: tuple[Flag, ...] = tuple(_clock_flag(times))
    if raw.streams["/pivot"].size:
        pivot, late_s = pivot_channel(raw, rig, epoch_ns)
        channels = [TimedColumns(c.time_s, {n: v for n, v in c.columns.items() if n != "q1_rad"}) for c in channels]
        channels.append(pivot)
        bound_s = late_s + max(clock.bound_s for clock in clocks)
        words["pivot sensor"] = f"each angle within {late_s * 1e6:.0f} us of the host's clock"
    if raw.streams["/shunt"].size:
        channels.append(shunt_channel(raw, rig, epoch_ns))
    samples = raw.streams["/imu"]
    if samples.size:
        clock = fit_samples(samples, epoch_ns)
        bound_s = clock.bound_s + max(other.bound_s for other in clocks)
        channels.append(_imu_channel(raw, samples, clock, rig))
        flagged = (*flagged, *flag_run(raw, rig, configured(raw, "imu")))
        words["IMU clock"] = f"{clock.rate_hz:.3f} Hz, within {clock.bound_s * 1e6:.0f} us"
    if any(channel.time_s.size < 2 for channel in channels):
        raise unusable(raw, "is too short for its clocks to be put together")
    return Decoded(epoch_ns, channels, bound_s, flagged, words, _held(raw, epoch_ns) if instant else None)


def align(raw: RawRun, rig: Rig, rate_hz: float | None = None) -> Dataset:
    """Run on a grid of `rate_hz`, its columns and times those of `decode`.

    The default is the rig's rate, else that of the slower of torque and IMU.

    Between samples of an instantaneous current the torque follows the commands (`held_torque`). Raises `InputError`
    when the run is too short to be timed.
    """
    found = decode(raw, rig)
    rate = rate_hz or rig.sampling.rate_hz or own_rate(
        [channel for channel in found.channels if {"tau2_nm", "gyro_radps"} & set(channel.columns)])
    split = None
    if found.held is not None:
        (sampled,) = (channel for channel in found.channels if "tau2_nm" in channel.columns)
        split = split_torque(sampled, *found.held)
    if split is None:
        dataset = align_channels(raw.name, found.channels, rate, rig.sampling.as_read)
    else:
        others = [channel for channel in found.channels if channel is not sampled]
        dataset = align_channels(raw.name, [*others, split.commanded], rate, rig.sampling.as_read)
        torque = dataset.columns["tau2_nm"] + split.residual_on(dataset.time_s, 1.0 / rate)
        seen = look(sampled.time_s, sampled.columns, raw.name, rig.sampling.as_read)
        if "tau2_nm" in seen.left_out:
            torque[reached(dataset.time_s, sampled.time_s, seen.left_out["tau2_nm"], 0.5 / rate)] = np.nan
        dataset = replace(dataset, columns={**dataset.columns, "tau2_nm": torque},
                          readings=(*dataset.readings, *seen.faults))
    if len(dataset) < MIN_SAMPLES:
        raise unusable(raw, f"gives {len(dataset)} samples on the grid, at least {MIN_SAMPLES} are needed")
    own, flagged = None, (*found.flags, *dataset.flags)
    try:
        own = recorded_rig(raw) if "rig.toml" in raw.files else None
    except InputError as error:
        flagged = (*flagged, Flag("rig", f"the rig file inside it cannot be read: {error}"))
    return replace(dataset, clock_bound_s=found.bound_s, damage=raw.damage, flags=flagged, recorded_on=own,
                   imu=_imu_settings(raw))


def recorded_rig(raw: RawRun) -> Rig:
    """The rig as it stood in rig.toml when the run was recorded. Raises `InputError` when it is not in there."""
    if "rig.toml" not in raw.files:
        raise InputError(raw.name, "holds no rig.toml", "give the rig's file with --rig")
    return parse_rig(raw.files["rig.toml"], f"{raw.name} (rig.toml inside)")


def is_polled(raw: RawRun) -> bool:
    """The run's drive keeps no time: each of its samples answered a request of the host."""
    return configured(raw, "drive").get("polled") is True


class _Times(NamedTuple):
    """Host times of telemetry."""

    time_ns: FloatArray
    """(n,) [ns after epoch], NaN for samples that cannot be timed."""
    clocks: list[TickClock]
    """One a boot, and one a piece between faults of the clock."""
    faults: list[str]
    """Faults of the clock, in words."""


def _telemetry_times(raw: RawRun, telemetry: NDArray[np.void], epoch_ns: int, asked: bool) -> _Times:
    probes = raw.streams["/leg/clock"]
    time_ns = np.full(telemetry.shape, np.nan)
    arrived = (telemetry["host_ns"] - epoch_ns).astype(float)
    clocks: list[TickClock] = []
    faults: list[str] = []
    fit = fit_answers if asked else fit_ticks
    for boot in np.unique(telemetry["boot_id"]):
        mine, rows = probes[probes["boot_id"] == boot], np.flatnonzero(telemetry["boot_id"] == boot)
        if mine.size == 0:
            continue
        pieces, found = [Piece(np.arange(rows.size), np.arange(mine.size))], list[str]()
        if not asked:
            pieces, found = pieces_of(telemetry[rows], mine, epoch_ns)
        pieces = [Piece(rows[piece.rows], piece.probes) for piece in pieces]
        faults += found
        number, bound_ns = np.zeros(telemetry.size, np.int64), 0.0
        fitted = {k: fit(mine[piece.probes], epoch_ns) for k, piece in enumerate(pieces) if len(pieces) == 1
                  or (piece.rows.size >= LEAST_ROWS and piece.probes.size >= LEAST_PROBES)}
        most_s = UNTIMED_S + UNTIMED_RATIO * min((clock.bound_s for clock in fitted.values()), default=0.0)
        for k, clock in fitted.items():
            piece = pieces[k]
            if len(pieces) > 1 and clock.bound_s > most_s:
                continue
            time_ns[piece.rows] = clock.host_ns(telemetry["tick_us"][piece.rows], arrived[piece.rows])
            number[piece.rows], bound_ns = k, max(bound_ns, 1e9 * clock.bound_s)
            clocks.append(clock)
        if not asked:
            wrong = contradicting(arrived[rows], time_ns[rows], number[rows], bound_ns)
            groups = runs_of(paced_wrongly(telemetry[rows]))
            if len(pieces) > 1:
                groups += [np.searchsorted(rows, piece.rows) for piece in pieces]
            paced = apart(arrived[rows], time_ns[rows], groups)
            if paced.any() and not found:
                faults.append(f"the rate of the telemetry changed at {arrived[rows][paced][0] * 1e-9:.2f} s")
            elif wrong.any() and not found:
                faults.append("telemetry and probes contradict each other")
            time_ns[rows[wrong | paced]] = np.nan
    if not clocks:
        raise unusable(raw, "holds no clock probe, so its clocks cannot be put together")
    return _Times(time_ns, clocks, faults)


def find_clock_faults(raw: RawRun) -> list[str]:
    """Faults of the controller's clock in words; empty for none, and for a run that cannot be timed at all."""
    telemetry = raw.streams["/leg/telemetry"]
    try:
        return _telemetry_times(raw, telemetry, int(telemetry["host_ns"][0]), False).faults \
            if telemetry.size and not is_polled(raw) else []
    except InputError:
        return []


def _clock_flag(times: _Times) -> list[Flag]:
    """One where the controller's clock failed, with what became of the samples."""
    if not times.faults:
        return []
    lost, all_ = int(np.isnan(times.time_ns).sum()), times.time_ns.size
    done = f"{lost} of {all_} samples are set aside" if lost else "corrected by the clock probes"
    more = f" and {len(times.faults) - MOST_FAULTS} more" * (len(times.faults) > MOST_FAULTS)
    return [Flag("clock", f"the controller's clock failed: {'; '.join(times.faults[:MOST_FAULTS])}{more}; {done}")]


def _sure(raw: RawRun, telemetry: NDArray[np.void], rig: Rig) -> BoolArray:
    """Samples of a polled drive whose answer came soon enough for their time to be known as the rig asks."""
    probes = raw.streams["/leg/clock"]
    waits = dict(zip(probes["host_rx_ns"].tolist(), (probes["host_rx_ns"] - probes["host_tx_ns"]).tolist()))
    most_ns = 2e9 * rig.limits.clock_bound_s
    return np.array([waits.get(t_ns, np.inf) <= most_ns for t_ns in telemetry["host_ns"].tolist()], bool)


def _leg_channels(raw: RawRun, telemetry: NDArray[np.void], time_ns: FloatArray, rig: Rig,
                  instant: bool) -> list[TimedColumns]:
    """Knee, Hall, temperature and command at the tick; the torque there too where its current is `instant`, else half
    a period earlier, for it is the period's mean."""
    rows = increasing(time_ns)
    telemetry, time_s = telemetry[rows], time_ns[rows] * 1e-9
    if not np.isfinite(telemetry["knee_rad"]).any():
        raise InputError(raw.name, "the knee encoder gave no valid reading", "check the encoder's wiring")
    at_tick = {"q2_rad": knee_angle(telemetry["knee_rad"], rig.calibration),
               "q1_rad": telemetry["pivot_hall_rad"].astype(float),
               "tau2_cmd_nm": telemetry["torque_cmd_nm"].astype(float),
               "temperature_degc": telemetry["motor_degc"].astype(float)}
    at_tick = {name: np.where(np.abs(values) <= MOST, values, np.nan) for name, values in at_tick.items()}
    measured = {name: values for name, values in at_tick.items() if np.isfinite(values).any()}
    period = float(np.median(np.diff(time_s))) if time_s.size > 1 else 0.0
    current: FloatArray = np.where(np.abs(telemetry["current_a"]) <= MOST, telemetry["current_a"], np.nan)
    torque = {"tau2_nm": joint_torque(current, rig.calibration)}
    return [TimedColumns(time_s, measured), TimedColumns(time_s if instant else time_s - 0.5 * period, torque)]


def _held(raw: RawRun, epoch_ns: int) -> tuple[FloatArray, FloatArray]:
    """Times [s after epoch] and torques [N m] of the commands, in order."""
    commands = raw.streams["/leg/command"]
    times: FloatArray = (commands["host_ns"] - epoch_ns).astype(float)
    rows = increasing(times)
    return times[rows] * 1e-9, commands["torque_nm"][rows].astype(float)


def _imu_channel(raw: RawRun, samples: NDArray[np.void], clock: ImuClock, rig: Rig) -> TimedColumns:
    facts = configured(raw, "imu")
    try:
        scale = (float(facts["gyro_radps_per_lsb"]), float(facts["accel_mps2_per_lsb"]))
        rate_hz = float(facts.get("rate_hz") or LEAST_IMU_HZ)
    except (KeyError, TypeError, ValueError):
        raise unusable(raw, "holds IMU samples without their scale") from None
    if not all(0.0 < value < 1.0 for value in scale):
        raise unusable(raw, f"gives its IMU the scale {scale[0]:g}, {scale[1]:g}, which no chip has")
    if not LEAST_IMU_HZ <= rate_hz <= MOST_IMU_HZ:
        raise unusable(raw, f"gives its IMU the rate {rate_hz:g} Hz, which no chip has")
    rows = increasing(clock.time_ns)
    counts = np.column_stack([samples[f"{kind}_{axis}"][rows] for kind in ("gyro", "accel") for axis in "xyz"])
    x, y, z = np.abs(rig.calibration.imu_mount)
    used = np.concatenate((z, x + y)) > LEAST_SHARE
    inside = (np.abs(counts[:, used].astype(np.int32)) < RAIL).all(axis=1)  # clipped, it says only that it was more
    rows, counts = rows[inside], counts[inside]
    return TimedColumns(clock.time_ns[rows] * 1e-9, imu_columns(counts, scale, rig.calibration))


def _imu_settings(raw: RawRun) -> Imu | None:
    """What the recorder says of the age of its IMU's readings; None for runs of earlier versions."""
    facts = configured(raw, "imu")
    if "stamped" not in facts:
        return None
    try:
        imu = msgspec.convert({"odr_hz": facts.get("rate_hz"), "cutoff_hz": facts.get("cutoff_hz"),
                               "stamped": facts["stamped"]}, Imu)
    except msgspec.ValidationError as error:
        raise unusable(raw, f"has settings of its IMU that cannot be: {error}") from None
    if imu.lack is not None:
        raise unusable(raw, imu.lack[0])
    return imu


def _distance_channel(readings: NDArray[np.void], epoch_ns: int) -> TimedColumns:
    """A laser distance meter's readings at the host's times; those that are none are gaps."""
    times: FloatArray = (readings["host_ns"] - epoch_ns).astype(float)
    rows = increasing(times)
    value = readings["distance_m"][rows]
    good = (readings["valid"][rows] != 0) & np.isfinite(value) & (np.abs(value) <= MOST)
    return TimedColumns(times[rows] * 1e-9, {"distance_m": np.where(good, value, np.nan)})


def _clock_words(clocks: list[TickClock], polled_ns: FloatArray | None) -> str:
    """What is known of the controller's clock; `polled_ns`: the times of samples that the host asked for."""
    worst = max(clocks, key=lambda clock: clock.bound_s)
    if polled_ns is not None:
        steps = np.diff(polled_ns[np.isfinite(polled_ns)])
        jitter_us = float(np.sqrt(np.mean((steps - np.median(steps)) ** 2))) * 1e-3 if steps.size else 0.0
        return (f"none: samples lie between request and answer, within {worst.bound_s * 1e6:.0f} us, {worst.probes} "
                f"samples, their interval jitters by {jitter_us:.0f} us (rms)")
    return (f"{worst.rate_ppm:+.1f} ppm, within {worst.bound_s * 1e6:.0f} us, {worst.probes} probes"
            + (f", {len(clocks)} boots" if len(clocks) > 1 else ""))
