"""`record_run`: a plan over open devices into a new run file, refused before anything moves where it does not fit."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from daq.errors import WorkError
from daq.recording.facts import program_facts
from daq.recording.plan import Plan, check_drive, check_gyro, check_plan
from daq.recording.recorder import Progress, Recorder, RecordReport, ended_by
from daq.recording.remote import Remote
from daq.recording.sensors import Sensors
from daq.rig import Rig
from daq.runs import RunWriter
from drivers import Drive, Lsm9ds1


def record_run(path: Path | str, rig: Rig, rig_text: str, plan: Plan, imu: Lsm9ds1 | None, controller: Drive,
               now_ns: Callable[[], int] = time.monotonic_ns, threaded: bool = True,
               progress: Progress | None = None, remark: str = "", remote: Remote | None = None,
               sensors: Sensors | None = None) -> RecordReport:
    """Record `plan` over open devices into a new run file that holds all that a later refit needs.

    `remark` is the file's first event: what whoever reads it should know of this recording. `remote` watches it and can
    stop it. `sensors` are recorded too.
    """
    check_plan(plan, rig, controller)
    check_drive(rig, controller)
    check_gyro(rig, imu)
    writer = RunWriter(path, {"rig.toml": rig_text, "plan.csv": plan.text()}, program_facts(rig, now_ns()))
    try:
        if remark:
            writer.event(now_ns(), "remark", remark)
        recorder = Recorder(rig, imu, controller, writer, None, now_ns, threaded, progress, remote, sensors)
    except BaseException as error:
        writer.close()
        if isinstance(error, MemoryError):
            raise WorkError(ended_by(error)) from None
        raise
    return recorder.record(plan)  # which closes the file, whatever happens
