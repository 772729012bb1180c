"""`look`: the readings of one clock, each column by its kind, with what a device cannot have measured."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from daq.dataset import BoolArray, FloatArray, IndexArray
from daq.errors import InputError
from daq.findings import ReadingFault
from daq.looks.jumps import find_jumps, take_turns, unwrapped
from daq.looks.plateaus import flat_tops, frozen_noise, plateaus_of, repeats
from daq.looks.standstill import stands_under_torque

ANGLE = re.compile(r"q\d+_(rad|m)|q2_motor_rad")
ANGLE_OF_TORQUE = re.compile(r"q(\d+)_(?:rad|m)")
TORQUE = re.compile(r"tau\d+_(nm|n)|tau2_shunt_nm")
IMU = re.compile(r"gyro\d*_radps|accel\d*_[xy]_mps2")
PAUSE_PERIODS, AROUND_PAUSE = 1.5, 2
"""Behind a longer pause an angle may be elsewhere, and so many stamps next to it may be late."""
MOST_ISOLATED, MOST_STEPS = 0.02, 10
"""Share of isolated wrong readings, and number of steps, beyond which a column is refused."""
DENORMAL = 1e-300
"""Smaller numbers are memory that nobody wrote to, read as a double."""
TOLD = 3
"""Places that are named one by one."""


class Look(NamedTuple):
    """Columns as they can be used."""

    columns: dict[str, FloatArray]
    """(n,) each; readings that are left out are NaN."""
    left_out: dict[str, BoolArray]
    """Column -> (n,) readings over which nothing may be interpolated."""
    faults: tuple[ReadingFault, ...]


_Kind = Callable[[str, FloatArray, FloatArray], "_Found"]


class _Found(NamedTuple):
    x: FloatArray
    faults: list[ReadingFault]
    unknown: BoolArray
    """(n,) readings of which only a bound is known, or nothing for long."""


def look(time_s: FloatArray, columns: Mapping[str, FloatArray], where: str = "a run", as_read: bool = False) -> Look:
    """Columns (n,) at `time_s` (n,) with their faults: angles unwrapped, wrong readings left out. Columns that are no
    reading (commands, temperatures, a user's own) stay as they are; `as_read`, all do.

    A reading is innocent: a fault is what no motion of the mechanism makes, in units of the column's own resolution and
    of what other columns say at that time. Nothing else is altered. Raises `InputError` naming `where` for a column
    that holds two series in turn, or too many jumps, unless `as_read`.
    """
    out, left, faults = dict(columns), dict[str, BoolArray](), list[ReadingFault]()
    for name, values in columns.items():
        known = np.flatnonzero(np.isfinite(values))
        kind = next((of for pattern, of in _KINDS if pattern.fullmatch(name)), None)
        if kind is None or known.size < 2:
            continue
        try:
            found = _at_own_rate(kind, name, time_s[known], values[known])
        except InputError as error:
            if not as_read:
                raise InputError(f"{where}, column {name}", error.what, error.remedy) from None
            faults.append(ReadingFault(name, "refused", (), 0.0, "kept", f"{name}: {error.what}"))
            continue
        if not found.faults:
            continue
        faults += [_at_rows(fault, known) for fault in found.faults]
        out[name] = np.full(values.shape, np.nan)
        out[name][known] = found.x
        if found.unknown.any():
            left[name] = np.zeros(values.shape, bool)
            left[name][known[found.unknown]] = True
    for name in out:
        joint = ANGLE_OF_TORQUE.fullmatch(name)
        torque = next((one for one in (f"tau{joint[1]}_nm", f"tau{joint[1]}_n") if one in out), "") if joint else ""
        if torque:
            faults += _standstills(time_s, name, torque, out, left)
    if as_read:
        return Look(dict(columns), {}, tuple(replace(fault, done="kept") for fault in faults))
    return Look(out, left, tuple(faults))


def _standstills(time_s: FloatArray, name: str, torque: str, out: dict[str, FloatArray],
                 left: dict[str, BoolArray]) -> list[ReadingFault]:
    """Standstills of an angle under its torque, which are then left out of `out`. A drive may hold a joint against what
    others do that move."""
    others = [q for other, q in out.items() if ANGLE_OF_TORQUE.fullmatch(other)]
    known = np.flatnonzero(np.isfinite([*others, out[torque]]).all(axis=0))
    angles = [out[name][known], *(q[known] for q in others if q is not out[name])]
    places = stands_under_torque(time_s[known], angles, out[torque][known]) if known.size > 1 else []
    if not places:
        return []
    still = np.zeros(out[name].size, bool)
    for start, stop in places:
        still[known[start]:known[stop - 1] + 1] = True
    out[name] = np.where(still, np.nan, out[name])
    left[name] = left.get(name, np.zeros(still.size, bool)) | still
    text = (f"{name} stands still in {{rows}}, though {torque} swings as where the joint moves: the joint is blocked, "
            "or its encoder hangs")
    rows = tuple((int(known[start]), int(known[stop - 1])) for start, stop in places)
    return [_at_rows(ReadingFault(name, "standstill", rows, float(still.sum()), "left_out", text),
                     np.arange(still.size))]


def _moved(fault: ReadingFault, rows: IndexArray) -> ReadingFault:
    """A fault of the samples `rows` as one of all samples."""
    return replace(fault, rows=tuple((int(rows[a]), int(rows[b])) for a, b in fault.rows))


def _at_rows(fault: ReadingFault, known: IndexArray) -> ReadingFault:
    rows = tuple((int(known[a]) + 1, int(known[b]) + 1) for a, b in fault.rows)
    return replace(fault, rows=rows, text=fault.text.format(row=rows[0][0], rows=_rows(rows)))


def _rows(places: Sequence[tuple[int, int]]) -> str:
    """Places in few words."""
    told = [f"{a}" if a == b else f"{a} to {b}" for a, b in places[:TOLD]]
    more = f" and {len(places) - TOLD} more" if len(places) > TOLD else ""
    one = len(places) == 1 and places[0][0] == places[0][1]
    return f"row{'s' * (not one)} {', '.join(told)}{more}"


def _places(which: BoolArray) -> tuple[tuple[int, int], ...]:
    """First and last index of each row of True."""
    edges = np.diff(np.concatenate(([False], which, [False])).astype(np.int8))
    return tuple(zip(np.flatnonzero(edges == 1).tolist(), (np.flatnonzero(edges == -1) - 1).tolist()))


def _unit(name: str) -> str:
    unit = name.rpartition("_")[2]
    return {"nm": "N m", "n": "N", "radps": "rad/s", "mps2": "m/s2"}.get(unit, unit)


def _look_at_torque(name: str, time_s: FloatArray, x: FloatArray) -> _Found:
    """Torques that are no number of a device, and flat tops."""
    none = np.zeros(x.size, bool)
    tiny = (x != 0.0) & (np.abs(x) < DENORMAL)
    if tiny.any():
        rows = _places(tiny)
        text = f"{name} holds {int(tiny.sum())} readings below {DENORMAL:g}: memory that nobody wrote to"
        fault = ReadingFault(name, "denormal", rows, float(np.abs(x[tiny]).max()), "zeroed", text)
        return _Found(np.where(tiny, 0.0, x), [fault], none)
    return _clipped(name, x)


def _clipped(name: str, x: FloatArray) -> _Found:
    levels = flat_tops(x)
    if not levels:
        return _Found(x, [], np.zeros(x.size, bool))
    at = np.isin(x, levels)
    told = f"+-{levels[1]:.6g}" if len(levels) > 1 and levels[0] == -levels[1] else \
        " and ".join(f"{level:.6g}" for level in levels)
    text = (f"{name} stands at exactly {told} {_unit(name)} in {100.0 * at.mean():.2g} % of the samples (first in row "
            "{row}): the end of a sensor's range, or a drive's limit")
    fault = ReadingFault(name, "clipped", _places(at), max(map(abs, levels)), "left_out", text)
    # A neighbour is there only because its noise kept it below the limit: with it, estimates are biased low.
    near = np.convolve(at, np.ones(3))[1:-1] > 0.5
    return _Found(np.where(near, np.nan, x), [fault], near)


def _look_at_imu(name: str, time_s: FloatArray, x: FloatArray) -> _Found:
    """Flat tops, and readings that repeat though the sensor's noise moves the last digit."""
    found = _clipped(name, x)
    held = np.zeros(x.size, bool)
    for start, stop in frozen_noise(x):
        held[start + 1:stop] = True
    held &= ~found.unknown
    if not held.any():
        return found
    text = f"{name} repeats one reading in {{rows}}: the sensor hangs"
    fault = ReadingFault(name, "frozen", _places(held), float(held.sum()), "left_out", text)
    return _Found(np.where(held, np.nan, found.x), [*found.faults, fault], found.unknown | held)


def _at_own_rate(kind: _Kind, name: str, time_s: FloatArray, x: FloatArray) -> _Found:
    """What `kind` finds in the readings of an angle or an IMU, of which repeats are left out before."""
    times = repeats(x) if kind is not _look_at_torque else 1
    if times == 1:
        return kind(name, time_s, x)
    own = np.zeros(x.size, bool)
    own[plateaus_of(x).start] = True
    found, out, unknown = kind(name, time_s[own], x[own]), np.full(x.size, np.nan), np.zeros(x.size, bool)
    out[own], unknown[own] = found.x, found.unknown
    text = f"{name} repeats each reading {times} times: it is sampled more slowly"
    return _Found(out, [ReadingFault(name, "repeated", _places(~own), float(times), "left_out", text), *(
        _moved(fault, np.flatnonzero(own)) for fault in found.faults)], unknown)


def _look_at_angle(name: str, time_s: FloatArray, x: FloatArray) -> _Found:
    """Two series in turn are refused; then wraps, frozen and isolated readings, and steps of the zero."""
    faults = list[ReadingFault]()
    wraps = unwrapped(x) if name.endswith("_rad") else None
    if wraps is not None:
        x, modulus, at = wraps
        text = (f"{name} jumps by {modulus:.4g} rad {at.size} time{'s' * (at.size > 1)} (first in row {{row}}): a "
                "wrapped angle")
        faults.append(ReadingFault(name, "wrapped", tuple((k, k) for k in at.tolist()), modulus, "unwrapped", text))
    if take_turns(x):
        raise InputError("", "two series take turns in it: neighbours are far apart, every other reading is near",
                         "write each sender into a column of its own")
    found = _jumps(name, time_s, x)
    return _Found(found.x, [*faults, *found.faults], found.unknown)


def _jumps(name: str, time_s: FloatArray, x: FloatArray) -> _Found:
    period = float(np.median(np.diff(time_s)))
    pause = np.diff(time_s) > PAUSE_PERIODS * period
    around = np.convolve(pause, np.ones(2 * AROUND_PAUSE + 1))[AROUND_PAUSE:][:pause.size] > 0.5
    jumps = find_jumps(x, around, period)
    if len(jumps.isolated) > MOST_ISOLATED * x.size or len(jumps.steps) > MOST_STEPS:
        places = sorted(place for place, _ in (*jumps.isolated, *jumps.steps))
        raise InputError("", f"jumps {len(places)} times as no joint can, in {_rows([(k + 1, k + 1) for k in places])}",
                         "check the encoder and its cable, and that one device alone writes this column")
    unit, faults = _unit(name), list[ReadingFault]()
    for first, size in jumps.steps:
        text = (f"{name} steps by {size:.3g} {unit} at {time_s[first]:.6g} s (row {{row}}), and goes on as before: its "
                "zero has changed, or samples are missing")
        faults.append(ReadingFault(name, "stepped", ((first, first),), size, "kept", text, float(time_s[first])))
    off, frozen = np.zeros(x.size, bool), np.zeros(x.size, bool)
    worst = 0.0
    for first, stop in jumps.isolated:
        off[first:stop] = True
        worst = max(worst, abs(float(x[first] - 0.5 * (x[first - 1] + x[stop]))))
    if off.any():
        many = f"{int(off.sum())} readings by up to" if off.sum() > 1 else "one reading by"
        text = (f"{name} is off in {many} {worst:.3g} {unit} ({{rows}}): no joint moves there and back within "
                f"{1e3 * period:.3g} ms")
        faults.append(ReadingFault(name, "isolated", _places(off), worst, "left_out", text))
    for start, stop in jumps.frozen:
        frozen[start:stop] = True
    if frozen.any():
        text = f"{name} stands still in {{rows}}, next to a jump: the sensor hung"
        faults.append(ReadingFault(name, "frozen", _places(frozen), float(frozen.sum()), "left_out", text))
    return _Found(np.where(off | frozen, np.nan, x), faults, frozen)


_KINDS: tuple[tuple[re.Pattern[str], _Kind], ...] = (
    (ANGLE, _look_at_angle), (TORQUE, _look_at_torque), (IMU, _look_at_imu))
