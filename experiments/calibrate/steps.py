"""Steps of `legid calibrate`: what each reads, from files or from the devices, and whom it asks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from daq import InputError, Rig, WorkError
from daq.calibration import StillRecord, still_record
from daq.runs import RawRun, read_run
from estimator.calibration import Weight
from experiments.calibrate.encoder_and_shunt import (
    calibrate_knee,
    calibrate_shunt,
    fewest_stops,
    hanging_wishes,
    shunt_wishes,
    straight_wishes,
)
from experiments.calibrate.imu import (
    POSITIONS,
    calibrate,
    calibration_text,
    calibration_values,
    record_still,
    self_test_text,
)
from experiments.calibrate.imu_encoder import SWING_WISHES, calibrate_by_encoder
from experiments.calibrate.motor_off import Wanted, answer, read_records, record_off
from experiments.calibrate.mount import MOUNT_WISHES, calibrate_mount
from experiments.calibrate.outcome import Outcome
from experiments.calibrate.pivot import calibrate_pivot, pivot_wishes
from experiments.calibrate.torque_constant import calibrate_torque_constant
from experiments.models import Model, load_model
from experiments.rig import open_imu
from experiments.session import load_runs

STOPS = 4
"""Stops of the leg from which the pivot's sensor is calibrated, unless another number is asked for."""


@dataclass(frozen=True, kw_only=True)
class Asked:
    """Everything that a step was asked with; each takes what concerns it."""

    path: str
    """Of the rig file."""
    seconds: float
    """Length of a record from the devices."""
    runs: Sequence[str] = ()
    """Files to read instead."""
    model: str | None = None
    records: int | None = None
    straight: bool = False
    six_positions: bool = False
    self_test: bool = False
    weight: float | None = None
    arm: float | None = None
    weight_error: float = 0.0
    arm_error: float = 0.0
    weighted: Sequence[str] = ()


def _imu(asked: Asked, rig: Rig) -> Outcome:
    records = _recorded(asked.runs) if asked.runs else _measured(asked, rig)
    gyro, accel = calibrate(records, rig.mechanism.gravity_mps2)
    left = {} if accel is None else {"accelerometer_bias": accel.residual_mps2}
    return Outcome(calibration_text(gyro, accel), {"calibration": calibration_values(gyro, accel)}, tolerances=left)


def _encoder(asked: Asked, rig: Rig) -> Outcome:
    model = _model(asked)
    if asked.records is not None and asked.records < 1:
        raise InputError("--records", f"is {asked.records}", "give 1 or more")
    count = asked.records or (1 if asked.straight else fewest_stops(model))
    wishes = straight_wishes(count) if asked.straight else hanging_wishes(count)
    return calibrate_knee(_records(asked, rig, wishes), rig, asked.straight, model)


def _pivot(asked: Asked, rig: Rig) -> Outcome:
    count = STOPS if asked.records is None else asked.records
    if count < 1:
        raise InputError("--records", f"is {count}", "give 1 or more")
    return calibrate_pivot(_records(asked, rig, pivot_wishes(count), controller=False), rig)


def _mount(asked: Asked, rig: Rig) -> Outcome:
    model = _model(asked)
    return calibrate_mount(_records(asked, rig, MOUNT_WISHES, controller=False), rig, model)


def _shunt(asked: Asked, rig: Rig) -> Outcome:
    if asked.weight is not None or asked.arm is not None or asked.weighted:
        return _torque_constant(asked, rig)
    return calibrate_shunt(_records(asked, rig, shunt_wishes()), rig)


def _torque_constant(asked: Asked, rig: Rig) -> Outcome:
    for flag, value in (("--weight", asked.weight), ("--arm", asked.arm)):
        if value is None or not 1e-4 <= value <= 100.0:
            raise InputError(flag, f"is {value}", "give the weight's mass in kg and its arm in m")
    for flag, value in (("--weight-error", asked.weight_error), ("--arm-error", asked.arm_error)):
        if not 0.0 <= value <= 1.0:
            raise InputError(flag, f"is {value}", "give half of the 95 % interval, 0 or more")
    if not asked.runs or not asked.weighted:
        raise InputError("RUN", "holds with the weight and without it are needed", "record both with a plan of legid "
                         "excite --holds and give RUN... --weighted RUN...")
    weight = Weight(asked.weight or 0.0, asked.arm or 0.0, asked.weight_error, asked.arm_error)
    return calibrate_torque_constant(load_runs(asked.runs, rig), load_runs(asked.weighted, rig), rig, weight)


def _imu_encoder(asked: Asked, rig: Rig) -> Outcome:
    if not asked.runs and rig.devices.pivot is None:  # before a minute of swinging
        raise InputError("imu-encoder", "needs the angle of the IMU's link, and the rig has no [devices.pivot]",
                         "add that sensor, or give runs with q1_rad; legid calibrate imu needs none")
    records = None if asked.runs else _records(asked, rig, SWING_WISHES)
    return calibrate_by_encoder(records, asked.runs, rig)


def _records(asked: Asked, rig: Rig, wishes: Sequence[Wanted], controller: bool = True) -> list[RawRun]:
    """From the files given, else from the devices."""
    if asked.runs:
        return read_records(asked.runs)
    text = Path(asked.path).read_text(encoding="utf-8")
    return record_off(rig, text, asked.path, wishes, asked.seconds, controller)


def _model(asked: Asked) -> Model | None:
    """The identified leg, where one is given."""
    if asked.model is None:
        return None
    model = load_model(asked.model)
    if model.mechanism.model != "leg2":
        raise InputError(asked.model, f"is a model of {model.mechanism.model}", "give that of a leg2")
    return model


def _recorded(paths: Sequence[str]) -> list[StillRecord]:
    """Still records from run files."""
    if len(paths) not in (1, POSITIONS):
        raise InputError("RUN", f"{len(paths)} files given", "give one still record, or six for six positions")
    return [still_record(read_run(path)) for path in paths]


def _measured(asked: Asked, rig: Rig) -> list[StillRecord]:
    """Still records from the chip."""
    if rig.devices.imu is None:
        raise InputError(asked.path, "has no [devices.imu]", "describe the IMU, or give records as RUN")
    records = []
    with open_imu(rig.devices.imu, asked.path) as imu:
        if asked.self_test:
            words, passed = self_test_text(imu.bus, rig.devices.imu)
            print(words)
            if not passed:
                raise WorkError("the IMU's self-test failed; the chip is damaged, or it moved meanwhile")
            imu.open()
        for position in range(POSITIONS if asked.six_positions else 1):
            if asked.six_positions:
                answer(f"position {position + 1} of {POSITIONS}: lay the chip on another face, then press Enter ")
            print(f"keep still for {asked.seconds:g} s", flush=True)
            records.append(record_still(imu, asked.seconds, f"record {position + 1}"))
    return records


MEASUREMENTS: dict[str, Callable[[Asked, Rig], Outcome]] = {
    "imu": _imu, "mount": _mount, "encoder": _encoder, "pivot": _pivot, "shunt": _shunt, "imu-encoder": _imu_encoder}
"""Step -> its measurement."""
