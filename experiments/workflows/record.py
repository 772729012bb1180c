"""A plan file run on the leg that a rig file describes, or on an emulated one, into a run file."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from daq import InputError, RigFile, read_rig_file
from daq.recording import Plan, Progress, RecordReport, Remote, record_run
from experiments.emulation import Replayed
from experiments.judge import clock_warnings
from experiments.rig import open_devices


class Recorded(NamedTuple):
    """A finished recording."""

    report: RecordReport
    warnings: list[str]
    """One line for each thing about the link that makes the clock less certain than it could be."""


def record_plan(rig_path: Path | str | RigFile, plan: Plan, out: Path | str, emulate: str | None = None, seed: int = 1,
                progress: Progress | None = None, remote: Remote | None = None) -> Recorded:
    """Record `plan` into the new file `out`; a copy of the rig file, which may have been read already, goes into it.

    `emulate` names what is hidden in an emulated leg (`none`: nothing), whose noise is drawn from `seed`; None means
    the real devices, which `remote` can watch and stop. Raises `InputError`, `WorkError` or a `DriverError`.
    """
    file = rig_path if isinstance(rig_path, RigFile) else read_rig_file(rig_path)
    rig, where = file.rig, str(file.path)
    if not str(out).lower().endswith(".mcap"):
        raise InputError("--out", f"{out} does not end in .mcap", "name a native run file")
    if emulate is not None:
        from experiments.emulation import LegBody, find_hidden, record_emulated

        if rig.mechanism.model != "leg2":
            raise InputError(where, f"describes a {rig.mechanism.model}", "only a leg2 can be emulated")
        body = LegBody(gravity=rig.mechanism.gravity_mps2)
        hidden = find_hidden(emulate)
        return Recorded(record_emulated(Path(out), rig, file.text, plan, seed, body, hidden, progress), [])
    with open_devices(rig, where) as (imu, controller, sensors):
        done = record_run(out, rig, file.text, plan, imu, controller, progress=progress, remote=remote,
                          sensors=sensors)
        return Recorded(done, clock_warnings(done.clock_bound_s, controller.link_facts))


def replay_recording(run: Path | str, out: Path | str, rig_path: Path | str | None = None) -> Replayed:
    """Play the native run `run` back into the new file `out`, under the rig that it holds or that of `rig_path`.

    Raises `InputError`.
    """
    from experiments.emulation import replay_run

    for flag, path in (("--replay", run), ("--out", out)):
        if not str(path).lower().endswith(".mcap"):
            raise InputError(flag, f"{path} does not end in .mcap", "name a native run file")
    if rig_path is None:
        return replay_run(Path(out), run)
    return replay_run(Path(out), run, read_rig_file(rig_path).text)  # refused under its own name
