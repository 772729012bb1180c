"""`legid doctor`: one check after another, each one line with what to do about a failure.

Nothing is driven: opening the controller stops the motor, and it is never armed.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import BinaryIO

import msgspec

from daq import ControllerDevice, InputError, Rig
from daq.recording import ControllerIntake, ImuIntake, QueuedSink, SensorIntakes, Sensors, Workers, shunt_facts
from daq.runs import RunWriter, read_run
from drivers import Drive, DriverError, LinkStats, Lsm9ds1
from experiments.doctor.check import Check, Heard

LISTEN_S = 3.0
PING_EVERY_S = 0.05
DRAIN_EVERY_S = 0.01
DISK_BYTES, DISK_BLOCK = 4 << 20, 1 << 16
RUN_BYTES_PER_S = 2e5
"""What a recording writes at the devices' highest rates, rounded up (952 and 1000 messages/s of about 100 bytes)."""
HOUR_S = 3600.0
SLOW_SYNC_S = 1.0
"""A disk that takes this long for one block holds up the recorder's writer."""


def examine(rig: Rig, rig_text: str, where: str, folder: Path, move_s: float | None = None,
            clear_faults: bool = False) -> list[Check]:
    """All checks that this rig can have; with `move_s` somebody swings the leg by hand for so long.

    With `clear_faults` the controller is first told to forget what it latched; a cause that is still there stays. An
    empty `rig_text` says that `rig` is a guess, which nothing need agree with.
    """
    from experiments.doctor import bus, link, polled, signals, unknown
    from experiments.rig import devices

    checks = []
    with ExitStack() as stack:
        controller, imu = None, None
        device = rig.devices.controller
        if device is not None:
            checks += link.before_opening(device)
            try:
                controller = stack.enter_context(devices.connect(device, rig if rig_text else None))
                controller.open()
                if clear_faults:
                    link.clear_faults(controller)
                checks += link.after_opening(controller, rig, device, told=bool(rig_text))
            except (DriverError, InputError) as error:
                controller = None
                checks.append(Check("controller", "FAIL", str(error)))
        if rig.devices.imu is not None:
            found, usable = bus.examine_bus(rig.devices.imu)
            checks += found
            if usable:
                try:
                    imu = stack.enter_context(devices.open_imu(rig.devices.imu, where))
                    checks.append(Check("IMU settings", "ok", "written and read back, samples arrive"))
                except (DriverError, InputError) as error:
                    checks.append(Check("IMU settings", "FAIL", str(error)))
        found, sensors = polled.open_for_checks(stack, rig, where)
        checks += found
        if controller is not None or imu is not None or sensors != Sensors():
            try:
                if move_s is not None:
                    print(f"swing both joints slowly by hand for {move_s:g} s, about half a radian to each side",
                          flush=True)
                heard = listen(rig, rig_text, imu, controller, move_s or LISTEN_S, sensors)
                checks += signals.judge(heard, rig, imu is not None, controller is not None,
                                               move_s is not None, told=bool(rig_text))
                checks += polled.judge(heard, rig, sensors)
            except (DriverError, InputError) as error:
                checks.append(Check("signals", "FAIL", str(error)))
    told = [unknown.largest_unknown(rig)] if rig_text else []
    return [*checks, *told, *check_disk(folder)]


def listen(rig: Rig, rig_text: str, imu: Lsm9ds1 | None, controller: Drive | None, seconds: float,
           sensors: Sensors | None = None) -> Heard:
    """Everything that open devices say for so long, as a run that nothing commands. Raises a `DriverError`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "doctor.mcap"
        writer, workers = RunWriter(path, {"rig.toml": rig_text}), Workers()
        sink, before = QueuedSink(writer), _stats(controller)
        try:
            leg = None
            if controller is not None:
                leg = ControllerIntake(controller, sink, rig.calibration, time.monotonic_ns)
                workers.start("leg", leg.poll)
            if imu is not None:
                gyro, accel = imu.scale
                facts = {"gyro_radps_per_lsb": gyro, "accel_mps2_per_lsb": accel}
                sink.config(time.monotonic_ns(), "imu", msgspec.json.encode(facts).decode())
                workers.start("imu", ImuIntake(imu, sink, rig.calibration, time.monotonic_ns).drain, DRAIN_EVERY_S)
            if sensors is not None:
                SensorIntakes(sensors, sink, rig, time.monotonic_ns).start(workers)
                if sensors.shunt is not None:
                    sink.config(time.monotonic_ns(), "shunt", msgspec.json.encode(shunt_facts(sensors.shunt)).decode())
            workers.start("writer", sink.turn)
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                workers.check()
                if leg is not None:
                    leg.ping()
                time.sleep(PING_EVERY_S)
            workers.check()
        finally:
            workers.stop()
            sink.drain()
            writer.close()
        after = _stats(controller)
        return Heard(read_run(path), seconds, after[0] - before[0], after[1] - before[1])


def _stats(controller: Drive | None) -> tuple[int, int]:
    """(bad frames, telemetry lost) so far."""
    if controller is None:
        return 0, 0
    stats: LinkStats = controller.stats
    return stats.bad_crc + stats.bad_length, stats.lost


def default_rig() -> Rig:
    """Devices where a rig file leaves them, for a look before there is one."""
    from daq import Devices, ImuDevice, Mechanism

    return Rig(mechanism=Mechanism(model="leg2", actuated=(2,)),
               devices=Devices(imu=ImuDevice(), controller=ControllerDevice()))


def check_disk(folder: Path) -> list[Check]:
    """Room for an hour of recording, and whether the disk keeps up with one."""
    try:
        free = shutil.disk_usage(folder).free
    except OSError as error:
        return [Check("disk space", "FAIL", f"{folder}: {error.strerror}; name a folder that exists with --out")]
    hours = free / RUN_BYTES_PER_S / HOUR_S
    space = Check("disk space", "ok", f"{free / 1e9:.3g} GB free in {folder}, {hours:.3g} h of recording")
    if hours < 1.0:
        space = Check("disk space", "FAIL", f"{free / 1e6:.0f} MB free in {folder}, {hours * 60:.0f} min of recording; "
                                            "free space or name another folder with --out")
    try:
        rate, worst_s = disk_speed(folder)
    except OSError as error:
        return [space, Check("disk speed", "FAIL", f"{folder} cannot be written ({error.strerror or error}); free "
                                                   "space, or name another folder with --out")]
    words = f"{rate / 1e6:.3g} MB/s, slowest block {worst_s * 1e3:.0f} ms"
    if rate < 2 * RUN_BYTES_PER_S:
        return [space, Check("disk speed", "FAIL", f"{words}, a recording needs {RUN_BYTES_PER_S / 1e6:g} MB/s; "
                                                   "record to a faster disk with --out")]
    if worst_s > SLOW_SYNC_S:
        return [space, Check("disk speed", "warn", f"{words}: a card that stalls; record to another disk")]
    return [space, Check("disk speed", "ok", words)]


def disk_speed(folder: Path) -> tuple[float, float]:
    """(bytes/s, slowest block [s]) of writes forced to the disk. Raises OSError."""
    block, worst = os.urandom(DISK_BLOCK), 0.0
    path = folder / f".legid-doctor-{os.getpid()}"
    begin = time.monotonic()
    try:
        with open_scratch(path) as file:
            for _ in range(DISK_BYTES // DISK_BLOCK):
                t = time.monotonic()
                file.write(block)
                file.flush()
                os.fdatasync(file.fileno())
                worst = max(worst, time.monotonic() - t)
        return DISK_BYTES / max(time.monotonic() - begin, 1e-9), worst
    finally:
        with suppress(OSError):
            path.unlink()


def open_scratch(path: Path) -> BinaryIO:
    """A new file to try the disk with."""
    return path.open("xb")


def checks_text(checks: list[Check]) -> str:
    """One line a check."""
    width = max(len(check.name) for check in checks)
    return "\n".join(f"{check.status:4}  {check.name:{width}}  {' '.join(check.words.split())}" for check in checks)
