"""Records of the rig with the motor off, asked for one by one: what `legid calibrate` measures by."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from daq import InputError, Rig
from daq.runs import RawRun, read_run
from experiments.doctor import listen
from experiments.rig import open_devices, open_imu, open_sensors


@dataclass(frozen=True)
class Wanted:
    """One record: what the person does before it."""

    name: str
    prompt: str


def record_off(rig: Rig, rig_text: str, where: str, wanted: Sequence[Wanted], seconds: float,
               controller: bool = True) -> list[RawRun]:
    """One record of `seconds` a wish, nothing commanded. `controller`: it is needed, not only welcome.

    A single record starts at once; before each of several the person is asked. Raises `InputError` where a device is
    not in the rig file or nobody answers, or a `DriverError`.
    """
    devices = rig.devices
    if controller and devices.controller is None:
        raise InputError(where, "has no [devices.controller]", "describe the controller, or give records as RUN")
    if devices.controller is None and devices.imu is None and devices.pivot is None:
        raise InputError(where, "has no [devices.imu]", "describe the IMU, or give records as RUN")
    records = []
    with ExitStack() as stack:
        if devices.controller is not None:
            imu, leg, sensors = stack.enter_context(open_devices(rig, where))
        else:
            imu = None if devices.imu is None else stack.enter_context(open_imu(devices.imu, where))
            leg = None
            sensors = stack.enter_context(open_sensors(rig, where))
        for one in wanted:
            if len(wanted) > 1:
                answer(f"{one.prompt}, then press Enter ")
            else:
                print(one.prompt)
            print(f"recording {one.name} for {seconds:g} s, motor off", flush=True)
            records.append(replace(listen(rig, rig_text, imu, leg, seconds, sensors).raw, name=one.name))
    return records


def read_records(paths: Sequence[str]) -> list[RawRun]:
    """Native run files. Raises `InputError` for any other: calibration belongs to raw readings."""
    for path in paths:
        if Path(path).suffix.lower() != ".mcap":
            raise InputError(path, "is not a native run file", "give .mcap files: rig.toml's [calibration] applies to "
                             "raw readings, a CSV holds calibrated ones")
    records = [read_run(path) for path in paths]
    for record in records:
        if record.damage:
            raise InputError(record.name, f"is damaged: {'; '.join(map(str, record.damage))}",
                             "record again, or calibrate by what legid recover saves")
    return records


def answer(question: str) -> str:
    """Answer of the person. Raises `InputError` where there is nobody."""
    try:
        return input(question)
    except EOFError:
        raise InputError("standard input", "nobody answers", "run this on a terminal, or give records as RUN") from None


def need_terminal(remedy: str) -> None:
    """Raises `InputError` where standard input is no terminal."""
    if not sys.stdin.isatty():
        raise InputError("standard input", "is not a terminal, and there is something to ask", remedy)
