"""A run file put into words: streams, gaps, drops, clocks, events, rig."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from daq import Dataset, FloatArray, InputError, Rig
from daq.looks import look
from daq.runs import Note, RawRun, RawTable, commanded, start_of
from daq.timing import (
    HOLE_PERIODS,
    align,
    compare_torque_channels,
    configured,
    decode,
    measure_skew,
    recorded_rig,
)
from drivers import describe_faults
from experiments.console import text_table
from experiments.judge import clock_bound_s, clock_warnings

EVENTS_SHOWN = 20
SKEW_RATE_HZ = 200.0
HOST_TIME = {"/imu": "drain_before_ns", "/imu/slow": "host_ns", "/leg/telemetry": "host_ns", "/leg/clock": "host_rx_ns",
             "/leg/command": "host_ns", "/distance": "host_ns", "/pivot": "host_before_ns", "/shunt": "host_before_ns"}


def describe_mcap(raw: RawRun) -> str:
    """Everything a person wants to know of a native run before using it."""
    start_ns = _start_ns(raw)
    lines = [f"{raw.name}: {raw.messages} messages" + _recorded(raw), _wholeness(raw), "", _streams(raw)]
    lines += ["", *_losses(raw), *_clocks(raw), "", *_rig_lines(raw), "", f"events: {len(raw.events)}"]
    lines += [_event(note, start_ns) for note in raw.events[:EVENTS_SHOWN]]
    if len(raw.events) > EVENTS_SHOWN:
        lines.append(f"  ... and {len(raw.events) - EVENTS_SHOWN} more")
    return "\n".join(lines)


def describe_csv(table: RawTable) -> str:
    """The same for a CSV."""
    steps = np.diff(table.time_s)
    nominal = float(np.median(steps))
    holes = int((steps > HOLE_PERIODS * nominal).sum())
    seconds = float(table.time_s[-1] - table.time_s[0])
    rows = [[name, f"{values.min():.4g}", f"{values.max():.4g}", f"{values.std():.4g}"]
            for name, values in table.columns.items()]
    ignored = ", ".join(table.ignored)
    readings = [f"warning: {text}" for text in (*table.flags, *readings_of(table))]
    follows = commanded(list(table.columns))
    if follows:
        named = ", ".join(f"q{j}_cmd_rad" for j in follows)
        readings.append(f"no torque: the drive follows {named}. The rig file needs [servo]: legid init --from "
                        f"{table.name} writes one")
    lines = [f"{table.name}: {table.time_s.size} samples, {seconds:.2f} s, {1.0 / nominal:.6g} Hz",
             f"jitter of the sample times (rms): {float(np.std(steps[steps <= HOLE_PERIODS * nominal])) * 1e6:.3g} us; "
             f"gaps: {holes}" + (f", longest {float(steps.max()):.3g} s" if holes else ""), "",
             text_table(["column", "min", "max", "std"], rows, right={1, 2, 3})]
    return "\n".join([*lines, *[f"not numbers, ignored: {ignored}"] * bool(ignored), *readings])


def recorded_readings(raw: RawRun) -> list[str]:
    """The same of a native run; empty where it cannot be timed."""
    try:
        channels = decode(raw, recorded_rig(raw)).channels
        return [str(fault) for one in channels for fault in look(one.time_s, one.columns, raw.name).faults]
    except InputError:
        return []


def readings_of(table: RawTable) -> list[str]:
    """Faults of its readings, in sentences; empty for sound ones."""
    try:
        return list(map(str, look(table.time_s, table.columns, table.name).faults))
    except InputError as error:
        return [str(error)]


def _recorded(raw: RawRun) -> str:
    started = start_of(raw.facts)
    when = f", recorded {started:%Y-%m-%d %H:%M:%S} UTC" if started else ""
    replay = f"; a REPLAY of {raw.facts['replay_of']}, nothing was measured" if "replay_of" in raw.facts else ""
    return f"{when}, by legid {raw.facts.get('version', 'unknown')}{replay}"


def _wholeness(raw: RawRun) -> str:
    return "the file is whole" if not raw.damage else "\n".join(f"DAMAGED: {text}" for text in raw.damage)


def _start_ns(raw: RawRun) -> int:
    times = [int(s[HOST_TIME[topic]][0]) for topic, s in raw.streams.items() if s.size]
    return min([*times, *(note.host_ns for note in raw.events[:1])], default=0)


def _streams(raw: RawRun) -> str:
    rows = []
    for topic, stream in raw.streams.items():
        times: FloatArray = stream[HOST_TIME[topic]].astype(float) * 1e-9
        seconds = float(times[-1] - times[0]) if times.size > 1 else 0.0
        rows.append([topic, str(stream.size), f"{seconds:.2f}",
                     f"{(stream.size - 1) / seconds:.1f}" if seconds > 0 else "-"])
    return text_table(["stream", "messages", "seconds", "mean rate [Hz]"], rows, right={1, 2, 3})


def _losses(raw: RawRun) -> list[str]:
    telemetry, imu, slow = raw.streams["/leg/telemetry"], raw.streams["/imu"], raw.streams["/imu/slow"]
    lines = []
    if telemetry.size:
        lines.append(f"telemetry frames lost: {lost_frames(telemetry)}")
        faults = int(np.bitwise_or.reduce(telemetry["faults"]))
        lines.append(f"faults seen: {describe_faults(faults)}")
    if imu.size:
        lines.append(f"IMU gaps of unknown length: {int(imu['gap_before'].sum())}")
    if slow.size:
        degc = slow["temperature_degc"]
        lines.append(f"chip temperature: {degc.min():.1f} to {degc.max():.1f} degC (its changes only are meant)")
    return lines


def lost_frames(telemetry: NDArray[np.void]) -> int:
    """Frames missing by their sequence numbers, counted within each boot."""
    seq: NDArray[np.int64] = telemetry["seq"].astype(np.int64)
    steps = (seq[1:] - seq[:-1]) % 65536
    same_boot = telemetry["boot_id"][1:] == telemetry["boot_id"][:-1]
    return int((steps[same_boot & (steps > 0) & (steps < 32768)] - 1).sum())


def _clocks(raw: RawRun) -> list[str]:
    try:
        rig = recorded_rig(raw)
        found = decode(raw, rig)
        fine = align(raw, rig, SKEW_RATE_HZ)
        skew = measure_skew(fine)
    except InputError as error:
        return [f"clocks: {error}", *clock_warnings(0.0, configured(raw, "link"))]
    lines = [f"{label}: {words}" for label, words in found.clocks.items()]
    lines += second_shunt(raw, fine)
    lines += [f"warning: a fit of this run is suspect: {flag}" for flag in found.flags]
    lines += [f"warning: {fault}" for fault in fine.readings]
    if skew is not None:
        ages = None if fine.imu is None else fine.imu.ages
        own = "" if ages is None else (f"; its low pass alone: {ages[0].mean_s * 1e3:+.2f} +- "
                                       f"{ages[0].std_s * 1e3:.2f} ms")
        lines.append(f"IMU against encoders, by correlation of gyro and pivot: {skew.seconds * 1e3:+.2f} +- "
                     f"{skew.std_s * 1e3:.2f} ms (positive: the IMU is late{own})")
    elif raw.streams["/imu"].size:
        lines.append("IMU against encoders: not measurable here (no pivot angle, or too little motion)")
    return lines + clock_warnings(clock_bound_s(raw), configured(raw, "link"))


def second_shunt(raw: RawRun, run: Dataset) -> list[str]:
    """Comparison of the second shunt's torque with the drive's; empty where there is none."""
    readings = raw.streams["/shunt"]
    if not readings.size:
        return []
    lines = []
    stale, railed = int((readings["flags"] & 1 != 0).sum()), int((readings["flags"] & 2 != 0).sum())
    if stale or railed:
        lines.append(f"second shunt: {stale} readings without a new conversion, {railed} at the end of its range")
    found = compare_torque_channels(run)
    if found is None:
        return [*lines, "second shunt against the drive: not measurable here (no command that moves the torque)"]
    half_ms = 500.0 * float(configured(raw, "shunt").get("conversion_s", 0.0))
    gain, offset, late = found.gain, found.offset_nm, found.delay_s
    return [*lines, f"second shunt against the drive (95 %): gain {gain.value:.4f} +- {gain.half:.1g}, offset "
            f"{offset.value:+.4f} +- {offset.half:.1g} N m, delay {late.value * 1e3:+.2f} +- {late.half * 1e3:.1g} ms "
            f"(its samples' own times are known to {half_ms:.1f} ms), residual {found.residual_nm:.2g} N m rms"]


def _rig_lines(raw: RawRun) -> list[str]:
    lines = []
    try:
        lines.append(_rig_line(recorded_rig(raw)))
    except InputError as error:
        lines.append(f"rig: {error}")
    for name in ("firmware", "link"):
        if facts := configured(raw, name):
            lines.append(f"{name}: " + ", ".join(f"{key} {value}" for key, value in facts.items() if value is not None))
    if "plan.csv" in raw.files:
        lines.append(f"plan: {raw.files['plan.csv'].count(chr(10)) - 1} torque commands")
    return lines


def _rig_line(rig: Rig) -> str:
    m = rig.mechanism
    grid = "of the record" if rig.sampling.rate_hz is None else f"{rig.sampling.rate_hz:g} Hz"
    return (f"rig: {m.model}, actuated joints {', '.join(map(str, m.actuated)) or 'none'}, IMU at "
            f"{rig.imus[0].lever_arm_m:g} m, grid {grid}, torque hold {rig.sampling.hold}")


def _event(note: Note, start_ns: int) -> str:
    return f"  {(note.host_ns - start_ns) * 1e-9:8.3f} s  {note.kind}: {note.text}"
