"""`SignalSet`: one gap-free segment of one run as the arrays an estimator works on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from daq import Dataset, FloatArray
from estimator.errors import FitError, GapError
from estimator.model import Mechanism
from estimator.options import FitOptions
from estimator.signals.channels import Channel, imu_channels
from estimator.signals.commands import Commands, command_columns, commands_of
from estimator.signals.filters import central_difference, lowpass, shifted
from estimator.signals.imu import IMU_COLUMNS, imu_columns, tilt
from estimator.signals.orientation import Kinematics, sight, with_imus

LEAST_SEGMENT = 100
"""Samples of a segment that is worth looking at alone."""
STANCE = "stance"
"""Column of a walker's record: which leg is on the ground."""


@dataclass(frozen=True)
class SignalSet:
    """Measured samples of one segment; a joint without an encoder has NaN angles."""

    run: str
    rate_hz: float
    time_s: FloatArray
    """(n,)"""
    angles: FloatArray
    """(n, joints) encoder angles, NaN where the joint has none on this path [rad]."""
    torque: FloatArray
    """(n, joints) measured torque, exactly zero on a passive joint [N m]."""
    imu: Mapping[str, FloatArray]
    """The columns of all IMUs, three each, on the IMU path, otherwise empty."""
    spread: FloatArray | None = None
    """(n, joints) how much larger than its channel's level an angle's error is expected to be at each sample; None: it
    is the same throughout."""
    exchanged: bool = False
    """Of a walker's step, whether leg 2 stands: `Mechanism.exchanged` joints have changed places."""
    commands: Commands | None = None
    """What position loops were told; None where no joint follows a command."""
    averaged: float = 1.0
    """Samples of the file whose mean is one of these."""

    def low_passed(self, column: str, cutoff_hz: float) -> FloatArray:
        """(n, joints) the "torque", or (n,) a column of an IMU, low-passed: once for all problems of these samples."""
        key = column, cutoff_hz
        if key not in self._kept:
            values = self.torque if column == "torque" else self.imu[column]
            self._kept[key] = lowpass(values, cutoff_hz, self.rate_hz)
        return self._kept[key]

    def less(self, added: Mapping[Channel, FloatArray]) -> SignalSet:
        """The segment without what is `added` (n,) to each reading."""
        angles, torque, imu = self.angles.copy(), self.torque.copy(), dict(self.imu)
        for channel, values in added.items():
            place = channel.joint or 0
            if channel.kind in ("encoder", "torque"):
                (torque if channel.kind == "torque" else angles)[:, place] -= values
            else:
                column = imu_columns(place)[imu_channels(place).index(channel)]
                imu[column] = imu[column] - values
        return replace(self, angles=angles, torque=torque, imu=imu)

    @cached_property
    def _kept(self) -> dict[tuple[str, float], FloatArray]:
        return {}


def cut(signals: SignalSet, where: slice) -> SignalSet:
    """The samples `where` of a segment."""
    return replace(signals, time_s=signals.time_s[where], angles=signals.angles[where], torque=signals.torque[where],
                   imu={name: values[where] for name, values in signals.imu.items()},
                   spread=None if signals.spread is None else signals.spread[where],
                   commands=None if signals.commands is None else signals.commands.part(where))


def with_earlier_imu(signals: SignalSet, age_s: float) -> SignalSet:
    """A segment whose IMU's readings are of `age_s` [s] before their stamps: cubic splines, their ends held."""
    moved = {name: shifted(values, -age_s * signals.rate_hz) for name, values in signals.imu.items()}
    return replace(signals, imu=moved)


def by_run(signals: Sequence[SignalSet]) -> list[tuple[str, list[SignalSet], slice]]:
    """Name, segments and samples of each run; segments of a run follow each other, in time too."""
    found: list[tuple[str, list[SignalSet], slice]] = []
    start = 0
    for s in signals:
        end = start + len(s.time_s)
        if found and found[-1][0] == s.run and found[-1][1][-1].time_s[-1] < s.time_s[0]:
            _, segments, where = found.pop()
            found.append((s.run, [*segments, s], slice(where.start, end)))
        else:
            found.append((s.run, [s], slice(start, end)))
        start = end
    return found


def is_plain(mechanism: Mechanism, options: FitOptions) -> bool:
    """Whether the sensors are those that all methods know: encoders alone, or one IMU on link 1 of what hangs, and
    encoders of all other joints."""
    if options.sensors != "imu":
        return True
    alone = len(mechanism.imus) == 1 and mechanism.imus[0].link == 0 and mechanism.gravity >= 0.0
    return alone and options.encoders_of(mechanism.n) == tuple(range(1, mechanism.n))


def angle_column(mechanism: Mechanism, joint: int) -> str:
    """Contract's column of a joint's angle (joint 0-based)."""
    return f"q{joint + 1}_m" if mechanism.length_unit == "m" else f"q{joint + 1}_rad"


def torque_column(mechanism: Mechanism, joint: int) -> str:
    """Contract's column of a joint's input: torque [N m], force [N] or a motor's voltage [V] (joint 0-based)."""
    if mechanism.force_unit == "V":
        return f"voltage{joint + 1}_v"
    return f"tau{joint + 1}_n" if mechanism.length_unit == "m" else f"tau{joint + 1}_nm"


def split_signals(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions) -> list[SignalSet]:
    """Segments of at least 20 samples of every run, without gaps in the columns that this fit reads.

    Only encoders that are in use are read: on the IMU path, where nothing else is said, all but joint 1's. Raises
    `FitError` naming the run and the column that is missing, or the joints that no sensor shows.
    """
    if not datasets:
        raise FitError("no run was given")
    joints = options.encoders_of(mechanism.n)
    sight(mechanism, joints, options.sensors == "imu")
    signal_sets, levels = [], _sigma_levels(datasets, mechanism, options)
    for data in datasets:
        imu = [name for k in range(len(mechanism.imus)) for name in imu_columns(k)] if options.sensors == "imu" else []
        angles = [angle_column(mechanism, j) for j in joints]
        torques = [torque_column(mechanism, j) for j in mechanism.actuated]
        needed = imu + angles + torques + [command_columns(j - 1)[0] for j in data.loops]
        for column in needed:
            if column not in data:
                raise FitError(f"{data.name}: column {column} is missing for the {options.sensors} path")
        for where in data.segments(needed):
            n = where.stop - where.start
            q = np.full((n, mechanism.n), np.nan)
            for j, column in zip(joints, angles):
                q[:, j] = data[column][where]
            tau = np.zeros((n, mechanism.n))
            for j, column in zip(mechanism.actuated, torques):
                tau[:, j] = data[column][where]
            signal_sets.append(SignalSet(data.name, data.rate_hz, data.time_s[where], q, tau,
                                   {name: data[name][where] for name in imu}, _spread(data, where, levels),
                                   bool(mechanism.exchanged) and STANCE in data and data[STANCE][where.start] == 2,
                                   commands_of(data, mechanism.n, where), data.averaged))
    if not signal_sets:
        raise GapError("no segment of 20 samples without a gap in any run")
    if len({s.rate_hz for s in signal_sets}) > 1:
        raise FitError("the runs are on grids of different rates; give one rate_hz under [sampling]")
    return signal_sets


def sigma_column(mechanism: Mechanism, joint: int) -> str:
    """Column of the standard deviation of a joint's angle (joint 0-based), where it varies."""
    return f"q{joint + 1}_sigma_{'m' if mechanism.length_unit == 'm' else 'rad'}"


def _sigma_levels(datasets: Sequence[Dataset], mechanism: Mechanism, options: FitOptions) -> dict[str, float | None]:
    """Column of deviations to the level that they are over, of every joint; None where no run has the column."""
    out: dict[str, float | None] = {}
    for j in range(mechanism.n):
        column = sigma_column(mechanism, j)
        shown = [data[column] for data in datasets if column in data]
        known = options.encoder_noise(j)
        out[column] = None if not shown else known or float(np.sqrt(np.nanmean(np.square(np.concatenate(shown)))))
    return out


def _spread(data: Dataset, where: slice, levels: Mapping[str, float | None]) -> FloatArray | None:
    """(n, joints) standard deviations over the channel's own; None where no run says that they differ."""
    if not any(levels.values()):
        return None
    out = np.ones((where.stop - where.start, len(levels)))
    for j, (column, level) in enumerate(levels.items()):
        if level and column in data:
            out[:, j] = data[column][where] / level
    return out


def differentiate(signals: SignalSet, mechanism: Mechanism, cutoff_hz: float | None, order: int,
                  fused: bool = False) -> Kinematics:
    """Angles low-passed and differenced, eqs. (19), (34)-(39); joints without an encoder from IMUs by eq. (63).

    `fused` takes the gyro's integral for the fast part of the pivot's angle instead of the accelerometer
    alone; the paper's WLS-IMU does not.
    """
    dt = 1.0 / signals.rate_hz
    q = lowpass(signals.angles, cutoff_hz, signals.rate_hz, order)
    qd = central_difference(q, dt)
    qdd = central_difference(qd, dt)
    found = Kinematics(q, qd, qdd)
    return with_imus(found, signals.imu, mechanism, signals.rate_hz, cutoff_hz, order, fused) if signals.imu else found


def paper_differences(signals: SignalSet, mechanism: Mechanism, options: FitOptions) -> Kinematics:
    """Angles and differences of section V, (60) and (61): `options.half_power` and `options.spacing` of Table II.

    A joint whose encoder is declared free of noise is not filtered. On the IMU path the pivot comes from (63).
    """
    dt = 1.0 / signals.rate_hz
    cutoff = 0.5 * float(options.half_power or 1.0) * signals.rate_hz
    q = signals.angles.copy()
    for j in range(mechanism.n):
        if options.encoder_noise(j) != 0.0:
            q[:, j] = lowpass(q[:, j], cutoff, signals.rate_hz, options.filter_order)
    qd = central_difference(q, dt, options.spacing)
    qdd = central_difference(qd, dt, options.spacing)
    if signals.imu:
        gyro, ax, ay = (signals.imu[name] for name in IMU_COLUMNS)
        s, c, q1dd = tilt(ax, ay, gyro, signals.rate_hz, mechanism.lever_arm, cutoff, options.filter_order)
        q[:, 0] = np.unwrap(np.arctan2(s, c))
        qd[:, 0], qdd[:, 0] = lowpass(gyro, cutoff, signals.rate_hz, options.filter_order), q1dd
    return Kinematics(q, qd, qdd)
