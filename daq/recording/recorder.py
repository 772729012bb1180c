"""`Recorder`: runs a plan on the rig, records everything, and stops the motor on every way out."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from typing import Literal

import msgspec

from daq.errors import WorkError
from daq.recording.facts import describe_devices
from daq.recording.host_load import HostLoad, busy_words
from daq.recording.intake import ControllerIntake, ImuIntake, Sink
from daq.recording.plan import Plan
from daq.recording.remote import LOST, Ending, Remote, Status
from daq.recording.senses import Senses
from daq.recording.sensors import SensorIntakes, Sensors
from daq.recording.supervisor import Sample, Supervisor, Trip, may_ramp
from daq.recording.workers import QueuedSink, Workers, in_time, noted_signals, real_time
from daq.rig import Rig
from daq.rig_devices import ControllerDevice
from daq.runs import RunWriter
from drivers import Drive, DriverError, Lsm9ds1, State, describe_faults, fault_remedy

LEAD_IN_S, LEAD_OUT_S, RAMP_S = 1.0, 0.3, 0.08
CONFIRM_S = 0.2
PING_EVERY_S = 0.25
LEAD_PING_EVERY_S = 0.05
"""Probes come faster before the start: the clock must be known by then."""
STOP_AGAIN_S = 0.02
"""A Stop that was not heard is sent again after so long."""
FINISH_S = 5.0
"""Longest wait for the disk at the end: the motor is off, and who waits for a disk for ever learns nothing."""
FIFO_DEPTH = 32
DRAIN_EVERY_S = 0.010
_TURN_S = 0.002
"""Longest sleep of the commanding thread: supervision is at least this dense."""
Progress = Callable[[float, float], None]


@dataclass(frozen=True)
class RecordReport:
    """Report on a finished recording."""

    duration_s: float
    commands: int
    late_commands: int
    """Commands left out because the next was due already."""
    imu_samples: int
    messages: int
    clock_bound_s: float


class Recorder:
    """One recording over open devices. With `threaded` every device has a thread, on the real clock; without,
    one loop drives everything in turn, for a virtual clock that moves while the link is read.
    """

    def __init__(self, rig: Rig, imu: Lsm9ds1 | None, controller: Drive, writer: RunWriter,
                 supervisor: Supervisor | None = None, now_ns: Callable[[], int] = time.monotonic_ns,
                 threaded: bool = True, progress: Progress | None = None, remote: Remote | None = None,
                 sensors: Sensors | None = None) -> None:
        self.supervisor = supervisor or Supervisor(rig.limits)
        self._rig, self._controller, self._writer = rig, controller, writer
        self._now_ns, self._threaded, self._progress, self._remote = now_ns, threaded, progress, remote
        self._workers, self._disk = Workers(), Workers()
        self._queue = QueuedSink(writer)
        self._sink: Sink = self._queue if threaded else writer
        self._leg = ControllerIntake(controller, self._sink, rig.calibration, now_ns)
        slow_hz = rig.devices.imu.slow_hz if rig.devices.imu else 0.0
        self._imu = None if imu is None else ImuIntake(imu, self._sink, rig.calibration, now_ns, slow_hz)
        rate = imu.config.rate_hz if imu else 238.0
        self._sensors = SensorIntakes(sensors or Sensors(), self._sink, rig, now_ns)
        self._senses = Senses(rig, self._leg.hello, self._leg, self._imu, rate, now_ns(), self._sensors,
                              controller.capabilities.polled)
        self._drain_every_s = min(DRAIN_EVERY_S, FIFO_DEPTH / rate / 3)
        self._watchdog_ms = (rig.devices.controller or ControllerDevice()).watchdog_ms
        self._driving, self._supervising = False, True
        self._torque_nm = 0.0
        self._commanded_ns = self._ping_due_ns = self._drain_due_ns = 0
        self._ping_every_s = LEAD_PING_EVERY_S
        self._commands = self._late = 0
        self._load = HostLoad(now_ns())
        self._interrupt, self._start_ns, self._total_s = "", 0, 0.0
        describe_devices(writer, controller, imu, now_ns(), sensors)
        if remote is not None:
            remote.attach(controller.stop, self._status)

    def record(self, plan: Plan) -> RecordReport:
        """Lead in, arm, command the plan, stop, close the file.

        Raises `InputError` when the plan is beyond the limits, `WorkError` naming what ended the run early;
        what was recorded until then is in the file, closed and whole.
        """
        with noted_signals(self._note):  # to the very end: a second signal must not break off the finish
            return self._record(plan)

    def _note(self, name: str) -> None:
        self._interrupt = name

    def _record(self, plan: Plan) -> RecordReport:
        try:
            with real_time() if self._threaded else nullcontext(False) as granted:
                if granted and self._remote is not None:
                    self._remote.hurry()
                self._sink.config(self._now_ns(), "priority", msgspec.json.encode({"real_time": granted}).decode())
                self._start_threads()
                self._run(plan)
        except (WorkError, DriverError, KeyboardInterrupt, MemoryError) as error:
            why = ended_by(error)
            kind = self._kind(error)
            busy = busy_words(self._load.stalled_s(self._now_ns()))
            if busy and kind in ("lost", "failed") and not isinstance(error, LOST):  # these are certain
                kind, why = "overload", f"{why}; {busy}"
            self._finish(why)
            if self._remote is not None:
                self._remote.kind = kind
            raise WorkError(f"{why}; what was recorded until then is kept in {self._writer.path}") from None
        except BaseException as error:
            self._finish(f"internal error: {error!r}")
            raise
        self._finish("")
        return RecordReport(plan.duration_s, self._commands, self._late, self._imu.samples if self._imu else 0,
                            self._writer.messages, self._leg.clock_bound_s() or 0.0)

    # -- the phases ----------------------------------------------------------------------------------------

    def _run(self, plan: Plan) -> None:
        try:
            self._keep(self._now_ns() + _ns(LEAD_IN_S))
            self._senses.arm()
            self._ping_every_s = PING_EVERY_S
            self._arm()
            self._follow(plan)
            self._driving = False
            self._controller.stop()
            self._senses.commanded(self._now_ns(), 0.0)
            self._sink.event(self._now_ns(), "stop", "plan done")
            self._keep(self._now_ns() + _ns(LEAD_OUT_S))
        except _Tripped as error:
            if not self._emergency and may_ramp(error.trip, self._sample()):
                self._ramp_down()
            raise WorkError(str(error)) from None
        except _Interrupted as error:
            if not self._emergency:
                self._ramp_down()
            raise WorkError(str(error)) from None

    def _arm(self) -> None:
        if not self._emergency:
            self._controller.arm(self._watchdog_ms)
        deadline = self._now_ns() + _ns(self._controller.capabilities.arming_s)
        self._command(0.0)
        while not self._armed():
            if self._now_ns() > deadline:
                raise WorkError("leg controller: did not arm and reports no fault; run legid doctor --rig RIG")
            self._keep(self._now_ns() + _ns(_TURN_S))
            self._command(0.0)
        self._driving = True
        self._sink.event(self._now_ns(), "start", f"armed, watchdog {self._watchdog_ms} ms")

    def _follow(self, plan: Plan) -> None:
        start_ns = self._start_ns = self._now_ns()
        self._total_s = plan.duration_s
        due = [start_ns + offset for offset in plan.offset_ns]
        end_ns = start_ns + _ns(plan.duration_s)
        for k, torque in enumerate(plan.torque_nm.tolist()):
            if k + 1 < len(due) and due[k + 1] <= self._now_ns():
                self._late += 1
                continue
            self._keep(due[k])
            self._command(torque)
            if self._progress is not None:
                self._progress((due[k] - start_ns) * 1e-9, plan.duration_s)
        self._keep(end_ns)
        self._command(0.0)

    def _ramp_down(self) -> None:
        """Torque to zero in a straight line: a step would shake the leg. What forbids a ramp ends it."""
        self._supervising = False
        first_nm, start_ns = self._torque_nm, self._now_ns()
        while self._driving and self._armed() and first_nm:
            left = 1.0 - (self._now_ns() - start_ns) * 1e-9 / RAMP_S
            self._command(first_nm * max(left, 0.0))
            if left <= 0:
                break
            self._keep(self._now_ns() + _ns(_TURN_S))
            sample = self._sample()
            worse = Supervisor(self._rig.limits).check(sample)
            if self._emergency or (worse is not None and not may_ramp(worse, sample)):
                break
        self._driving = False

    def _finish(self, why: str) -> None:
        """Motor stopped, threads ended, event written, file closed; runs on every way out."""
        self._driving = False
        try:
            self._controller.stop()
            stopped = "stop sent"
        except DriverError as error:
            stopped = f"stop not sent ({error}): the firmware's watchdog stops the motor"
        self._workers.stop()
        confirmed = self._confirm_off()
        if self._remote is not None:
            self._remote.motor = confirmed or f"{stopped.split(' (')[0]}, the firmware's watchdog stops it"

        def write_rest() -> None:
            self._disk.stop()
            try:
                self._queue.drain()
            finally:
                self._close(why, stopped)

        if not self._threaded:
            write_rest()
        elif not in_time(write_rest, FINISH_S):
            first = f"{why}; " if why else ""
            raise WorkError(f"{first}{self._writer.path}: the disk does not answer, so the file is not finished; "
                            "repair it with legid recover when the disk answers again")

    def _confirm_off(self) -> str:
        """What the controller itself says of the torque after the Stop; empty when it says nothing in time."""
        asked_ns = again_ns = self._now_ns()
        with suppress(Exception):  # whatever ended the run may strike again: the file is still to be closed
            while self._now_ns() < asked_ns + _ns(CONFIRM_S):
                if self._now_ns() >= again_ns + _ns(STOP_AGAIN_S):
                    again_ns = self._now_ns()
                    self._controller.stop()
                self._leg.poll()  # no thread does any more
                if self._leg.telemetry is not None and self._leg.heard_ns > asked_ns and not self._armed():
                    return f"torque off, the controller says {State(self._leg.telemetry.state).name}"
        return ""

    def _close(self, why: str, stopped: str) -> None:
        """Write the clock's bound and the last event, and end the file."""
        try:
            bound_s = self._leg.clock_bound_s()
            if bound_s is not None:
                self._writer.config(self._now_ns(), "clock", msgspec.json.encode({"bound_s": bound_s}).decode())
            if why:
                trip = self.supervisor.trip
                self._writer.event(self._now_ns(), f"limit {trip.limit}" if trip else "abort", f"{why}; {stopped}")
        finally:
            self._writer.close()
        if self._writer.failed and not why:  # while the stop was being confirmed, when nothing may break that off
            raise WorkError(self._writer.failed)

    # -- what goes on all the time -------------------------------------------------------------------------

    def _keep(self, until_ns: int) -> None:
        """Keep devices, clock probes, watchdog and supervision going until `until_ns`, at least once."""
        while True:
            self._serve()
            now = self._now_ns()
            if now >= until_ns:
                return
            if self._threaded:
                time.sleep(min(_TURN_S, (until_ns - now) * 1e-9))

    def _serve(self) -> None:
        now = self._now_ns()
        if not self._threaded:
            self._leg.poll()
            if self._imu is not None and now >= self._drain_due_ns:
                self._drain_due_ns = now + _ns(self._drain_every_s)
                self._imu.drain()
            self._sensors.turn(now)
        self._load.look(now)
        self._workers.check()
        self._disk.check()
        self._senses.attend()
        if now >= self._ping_due_ns:
            self._ping_due_ns = now + _ns(self._ping_every_s)
            self._leg.ping()
        if self._supervising:
            self._supervise()
        if self._driving and now - self._commanded_ns > self._watchdog_ms * 250_000:
            self._command(self._torque_nm)  # held: a quarter of the watchdog's time without a new one

    def _supervise(self) -> None:
        if self._remote is not None and self._remote.asked:
            self._interrupt = self._interrupt or self._remote.asked
        if self._interrupt:
            raise _Interrupted(f"stopped by {self._interrupt}")
        sample = self._sample()
        trip = self.supervisor.check(sample)
        if self._remote is not None:
            self._show(self._remote, sample)
        if trip is not None:
            raise _Tripped(trip)
        if self._leg.boot_id != self._leg.first_boot_id:
            raise WorkError("leg controller: restarted during the run; check its supply")
        telemetry = self._leg.telemetry
        if telemetry is not None and telemetry.faults and (self._driving or telemetry.state == State.FAULT):
            said = f" ({self._controller.words})" if self._controller.words else ""
            raise WorkError(f"leg controller: fault latched: {describe_faults(telemetry.faults)}{said}; "
                            f"{fault_remedy(telemetry.faults)}")
        if self._driving and not self._armed():
            raise WorkError("leg controller: disarmed itself during the run")

    def _sample(self) -> Sample:
        now, saved_ns = self._now_ns(), self._writer.saved_ns if self._threaded else 0
        return self._senses.sample(now, self._torque_nm, (now - saved_ns) * 1e-9 if saved_ns else None)

    def _armed(self) -> bool:
        return self._leg.telemetry is not None and self._leg.telemetry.state == State.ARMED

    @property
    def _emergency(self) -> bool:
        return self._remote is not None and self._remote.emergency

    def _command(self, torque_nm: float) -> None:
        if self._emergency:
            return  # the Stop has gone out; nothing may follow it
        now = self._now_ns()
        seq = self._controller.command(torque_nm)
        self._torque_nm, self._commanded_ns = torque_nm, now
        self._commands += 1
        self._senses.commanded(now, torque_nm)
        self._sink.add("/leg/command", now, now, torque_nm, seq, sequence=seq)

    def _show(self, remote: Remote, sample: Sample) -> None:
        """What a watcher sees of this turn."""
        remote.see(self._now_ns(), sample, self._imu.accel_mps2 if self._imu else None, self.supervisor.watched(sample),
                   self._senses.hall_seen)

    def _status(self) -> Status:
        """Progress of the run, state of the controller and losses, for a watcher."""
        telemetry, stats, imu = self._leg.telemetry, self._controller.stats, self._imu
        drive = State(telemetry.state).name.lower() if telemetry else "silent"
        if telemetry is not None and telemetry.faults:
            drive = f"{drive}: {describe_faults(telemetry.faults)}"
        done_s = (self._now_ns() - self._start_ns) * 1e-9 if self._start_ns else 0.0
        phase: Literal["waiting", "driving", "ending"] = "waiting"
        if self._start_ns:
            phase = "driving" if self._driving else "ending"
        return Status(phase, [], min(done_s, self._total_s), self._total_s, drive,
                      imu_samples=imu.samples if imu else 0, imu_gaps=imu.gaps if imu else 0, frames_lost=stats.lost,
                      frames_bad=stats.bad_crc + stats.bad_length, late_commands=self._late)

    def _kind(self, error: BaseException) -> Ending:
        """How the run ended, for a watcher."""
        trip = self.supervisor.trip
        if self._emergency:
            return "emergency"
        if self._interrupt or isinstance(error, KeyboardInterrupt):
            return "stopped"
        if trip is not None:
            return "lost" if trip.limit == "staleness_s" else "limit"
        return "lost" if isinstance(error, LOST) else "failed"

    def _start_threads(self) -> None:
        if not self._threaded:
            return
        self._workers.start("leg", self._leg.poll)
        if self._imu is not None:
            self._workers.start("imu", self._imu.drain, self._drain_every_s)
        self._sensors.start(self._workers)
        self._disk.start("writer", self._queue.turn)


def ended_by(error: BaseException) -> str:
    """Words on the end of a recording."""
    if isinstance(error, MemoryError):
        return "no memory is left; close other programs"
    return "stopped by Ctrl-C" if isinstance(error, KeyboardInterrupt) else str(error)


class _Tripped(Exception):
    """A limit of the supervisor."""

    def __init__(self, trip: Trip) -> None:
        super().__init__(str(trip))
        self.trip = trip


class _Interrupted(Exception):
    """A signal."""


def _ns(seconds: float) -> int:
    return round(seconds * 1e9)
