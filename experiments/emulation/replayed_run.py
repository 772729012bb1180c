"""A recorded run played back through drivers, intakes and supervision into a new run file: no device, no motor.

The recording says what came when: at each of its times the clock is moved there, the bytes that were read then are put
on the wire again, and the driver reads them. What the recorder itself decided (commands, clock probes, its notes) is
done again at the time at which it was done; nothing of the host's clock or of chance enters, so a run is played back
the same however often.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from heapq import merge
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from daq import InputError, Rig, WorkError, parse_rig
from daq.recording import (
    ControllerIntake,
    ImuIntake,
    PivotIntake,
    Senses,
    SensorIntakes,
    Sensors,
    ShuntIntake,
    Supervisor,
    describe_devices,
    program_facts,
)
from daq.runs import RawRun, RunWriter, read_run
from daq.timing import configured, is_polled, recorded_rig
from drivers import Hello, ImuConfig, LegController, Lsm9ds1, Message, PivotReading, Received, ShuntReading, Telemetry
from drivers.mock import ReplayBus, ReplayLink, VirtualClock, fault_report, frames, pong, rebooted

LEAD_NS = 10_000_000_000
"""Time in which the devices are opened, before the recording's first."""
BY_DRIVERS = {"firmware", "link", "imu gap", "fault", "reboot"}
"""Notes that drivers and intakes make again; all others are copied. The IMU's is: it says how old readings were, which
a driver does not know of an earlier version's run."""
TRANSFER = ("host_before_ns", "host_after_ns")
AXES = [f"{kind}_{axis}" for kind in ("gyro", "accel") for axis in "xyz"]
ADDRESS = 0x6B


class Replayed(NamedTuple):
    """Report on a playback."""

    messages: int
    imu_samples: int
    left_out: int
    """Slow readings of the IMU, which are not played."""
    trip: str
    """The first limit of the rig file that the recording would have passed, with its time; empty for none."""


class Event(NamedTuple):
    """One thing that the recorder did."""

    t_ns: int
    order: int
    """Among events of one time."""
    do: Callable[[], None]


def replay_run(path: Path, recording: Path | str, rig_text: str | None = None) -> Replayed:
    """Play `recording` into the new run file `path`, under the rig that it holds or that of `rig_text`.

    Raises `InputError` where the recording is damaged or lacks what the devices said of themselves.
    """
    raw = read_run(recording)
    if raw.damage:
        raise InputError(raw.name, f"is damaged: {raw.damage[0]}", "replay a whole run; see legid recover")
    if not raw.streams["/leg/telemetry"].size:
        raise InputError(raw.name, "holds no telemetry", "play a run that legid record wrote")
    rig = recorded_rig(raw) if rig_text is None else parse_rig(rig_text)
    digest = hashlib.sha256(Path(recording).read_bytes()).hexdigest()
    files = {**raw.files, **({} if rig_text is None else {"rig.toml": rig_text})}
    player = _Player(raw, rig)
    started = raw.facts.get("started_monotonic_ns", "")
    start_ns = int(started) if started.isdecimal() else player.first_ns
    facts = {**program_facts(rig, start_ns), "replay_of": raw.name, "replay_of_sha256": digest,
             "started_unix_ns": raw.facts.get("started_unix_ns", "0")}
    writer = RunWriter(path, files, facts)
    try:
        writer.event(start_ns, "remark", f"REPLAY of {raw.name}: nothing was measured, no motor moved")
        return player.play(writer)
    finally:
        writer.close()


class _Player:
    """Devices, intakes and supervision on the recording's own clock."""

    def __init__(self, raw: RawRun, rig: Rig) -> None:
        self._raw, self._rig = raw, rig
        self.first_ns = min([int(raw.streams["/leg/telemetry"]["host_ns"][0]), *(n.host_ns for n in raw.config)])
        self._hello = _hello(raw)
        self._polled = is_polled(raw)
        self._asked_ns = {int(row["host_rx_ns"]): int(row["host_tx_ns"]) for row in raw.streams["/leg/clock"]} \
            if self._polled else {}
        self._clock = VirtualClock(max(0, self.first_ns - LEAD_NS))
        self._link = ReplayLink(self._hello, self._clock)
        self._link.facts = configured(raw, "link")
        self._boot_id = self._hello.boot_id
        self._asked = 0

    def play(self, writer: RunWriter) -> Replayed:
        """Every step of the recording in turn."""
        now_ns, rig = self._clock.now_ns, self._rig
        with LegController(self._link, now_ns) as controller:
            hello = controller.open()
            if self._polled:
                controller.capabilities = replace(controller.capabilities, polled=True,
                                                  current=configured(self._raw, "drive").get("current", "instant"))
                controller.poll = partial(self._answers, controller.poll)  # type: ignore[method-assign]
            imu, bus = self._open_imu()
            self._clock.advance_to(self.first_ns)
            leg = ControllerIntake(controller, writer, rig.calibration, now_ns)
            samples = None if imu is None else ImuIntake(imu, writer, rig.calibration, now_ns)
            others = self._others(writer)
            senses = Senses(rig, hello, leg, samples, imu.config.rate_hz if imu else 1.0, now_ns(), others,
                            self._polled)
            describe_devices(writer, controller, None, now_ns())
            steps = [self._polls(leg), self._pings(leg), self._commands(controller, writer, senses),
                     self._notes(writer), self._readings(others)]
            if bus is not None and samples is not None:
                steps.append(self._drains(bus, samples))
            trip, watch = "", _Watch(self._raw, rig, senses)
            for step in merge(*steps, key=lambda step: step[:2]):
                self._clock.advance_to(step.t_ns)
                step.do()
                senses.attend()
                trip = trip or watch.check(step.t_ns)
            slow = self._raw.streams["/imu/slow"].size
            return Replayed(writer.messages, samples.samples if samples else 0, slow, trip)

    def _answers(self, poll: Callable[[], list[Received]]) -> list[Received]:
        """What a poll of the drive brought, with the times of the requests."""
        return [one._replace(asked_ns=self._asked_ns.get(one.host_ns)) if isinstance(one.message, Telemetry) else one
                for one in poll()]

    def _open_imu(self) -> tuple[Lsm9ds1, ReplayBus] | tuple[None, None]:
        facts = configured(self._raw, "imu")
        if not facts:
            return None, None
        try:
            config = ImuConfig(float(facts["rate_hz"]), int(facts["accel_range_g"]), int(facts["gyro_range_dps"]))
        except (KeyError, TypeError, ValueError):
            raise InputError(self._raw.name, "does not say how its IMU was set", "record it again") from None
        bus = ReplayBus(self._clock, ADDRESS)
        imu = Lsm9ds1(bus, ADDRESS, config, self._clock.now_ns, sleep=self._wait)
        imu.open()
        return imu, bus

    def _wait(self, seconds: float) -> None:
        """Only while the devices are opened: later the recording says what time it is."""
        if self._clock.now_ns() < self.first_ns:
            self._clock.sleep(seconds)

    def _others(self, writer: RunWriter) -> SensorIntakes:
        """Intakes of the other sensors that the recording has, with no sensor behind them."""
        rig, now_ns, streams = self._rig, self._clock.now_ns, self._raw.streams
        others = SensorIntakes(Sensors(), writer, rig, now_ns)
        others.pivot = PivotIntake(None, writer, rig, now_ns) if streams["/pivot"].size else None
        others.shunt = ShuntIntake(None, writer, now_ns) if streams["/shunt"].size else None
        return others

    # -- what the recorder did -----------------------------------------------------------------------------

    def _polls(self, leg: ControllerIntake) -> Iterator[Event]:
        """Reads of the link that brought something: telemetry, answers, restarts, faults."""
        arrived: dict[int, list[tuple[str, Any]]] = {}
        for row in self._raw.streams["/leg/telemetry"]:
            arrived.setdefault(int(row["host_ns"]), []).append(("telemetry", row))
        for row in () if self._polled else self._raw.streams["/leg/clock"]:
            arrived.setdefault(int(row["host_rx_ns"]), []).append(("pong", row))
        for note in self._raw.events:
            if note.kind in ("fault", "reboot"):
                arrived.setdefault(note.host_ns, []).append((note.kind, note))
        for t_ns in sorted(arrived):
            yield Event(t_ns, 0, partial(self._poll, leg, arrived[t_ns]))

    def _poll(self, leg: ControllerIntake, items: list[tuple[str, Any]]) -> None:
        self._link.put([message for kind, item in items for message in self._messages(kind, item)])
        leg.poll()

    def _messages(self, kind: str, item: Any) -> Iterator[Message]:
        """Frames behind one record; before the first of a new boot its Hello."""
        boot_id = self._boot_id
        if kind == "telemetry":
            boot_id = int(item["boot_id"])
        elif kind == "reboot":
            boot_id = int(item.text.rpartition(" ")[2])
        if boot_id != self._boot_id:
            self._boot_id = boot_id
            yield rebooted(self._hello, boot_id)
        if kind == "telemetry":
            yield frames(item)
        elif kind == "pong":
            yield pong(item)
        elif kind == "fault":
            yield from fault_report(item.text)

    def _pings(self, leg: ControllerIntake) -> Iterator[Event]:
        """Clock probes that were answered; those before them that were not go out with them."""
        last = -1
        for row in () if self._polled else self._raw.streams["/leg/clock"]:
            last += (int(row["ping_id"]) - last - 1) % 65536 + 1
            yield Event(int(row["host_tx_ns"]), 3, partial(self._ping, leg, last))

    def _ping(self, leg: ControllerIntake, number: int) -> None:
        while self._asked <= number:
            self._asked += 1
            leg.ping()

    def _drains(self, bus: ReplayBus, samples: ImuIntake) -> Iterator[Event]:
        """Drains of the FIFO that brought something."""
        rows = self._raw.streams["/imu"]
        why = {note.host_ns: note.text for note in self._raw.events if note.kind == "imu gap"}
        for part in np.split(rows, np.flatnonzero(np.diff(rows["drain_before_ns"])) + 1) if rows.size else []:
            before_ns = int(part["drain_before_ns"][0])
            yield Event(before_ns, 1, partial(_drain, bus, samples, part, why.get(before_ns, "")))

    def _readings(self, others: SensorIntakes) -> Iterator[Event]:
        """Of the pivot sensor and of the second shunt: each is one transfer, whose numbers are handed on."""
        steps: list[Event] = []
        if others.pivot is not None:
            for row in self._raw.streams["/pivot"]:
                angle = PivotReading(*(int(row[name]) for name in ("raw", "status", "agc", "magnitude", *TRANSFER)))
                steps.append(Event(angle.t_after_ns, 2, partial(others.pivot.take, angle)))
        if others.shunt is not None:
            for row in self._raw.streams["/shunt"]:
                mean = ShuntReading(*(int(row[name]) for name in ("raw", "flags", *TRANSFER)))
                steps.append(Event(mean.t_after_ns, 2, partial(others.shunt.take, mean)))
        yield from sorted(steps, key=lambda step: step.t_ns)

    def _commands(self, controller: LegController, writer: RunWriter, senses: Senses) -> Iterator[Event]:
        def command(t_ns: int, torque_nm: float) -> None:
            seq = controller.command(torque_nm)
            senses.commanded(t_ns, torque_nm)
            writer.add("/leg/command", t_ns, t_ns, torque_nm, seq, sequence=seq)

        for row in self._raw.streams["/leg/command"]:
            yield Event(int(row["host_ns"]), 4, partial(command, int(row["host_ns"]), float(row["torque_nm"])))

    def _notes(self, writer: RunWriter) -> Iterator[Event]:
        """What the recorder itself said."""
        notes = [(writer.event, n) for n in self._raw.events] + [(writer.config, n) for n in self._raw.config]
        for say, note in sorted(notes, key=lambda item: item[1].host_ns):
            if note.kind not in BY_DRIVERS:
                yield Event(note.host_ns, 5, partial(say, *note))


class _Watch:
    """The limits of the rig file, held against the recording from the start of the plan on."""

    def __init__(self, raw: RawRun, rig: Rig, senses: Senses) -> None:
        self._supervisor, self._senses = Supervisor(rig.limits), senses
        self._commands = raw.streams["/leg/command"]
        self._start_ns = next((note.host_ns for note in raw.events if note.kind == "start"), None)
        self._armed = False

    def check(self, t_ns: int) -> str:
        """The limit that is passed at `t_ns`, empty for none."""
        if self._start_ns is None or t_ns < self._start_ns:
            return ""
        if not self._armed:
            self._armed = True
            with suppress(WorkError):  # the recorder had no objection then
                self._senses.arm()
        row = int(np.searchsorted(self._commands["host_ns"], t_ns, side="right")) - 1
        torque_nm = float(self._commands["torque_nm"][row]) if row >= 0 else 0.0
        trip = self._supervisor.check(self._senses.sample(t_ns, torque_nm, None))
        return f"{trip}, {(t_ns - self._start_ns) * 1e-9:.3f} s after the start" if trip else ""


def _drain(bus: ReplayBus, samples: ImuIntake, part: NDArray[np.void], reason: str) -> None:
    """One drain that finds `part`; a bus that failed before it fails again."""
    gap = bool(part["gap_before"][0])
    if gap and bus.fail(reason):
        samples.drain()
        bus.fill()
        gap = False
    bus.put([[int(row[axis]) for axis in AXES] for row in part], int(part["drain_after_ns"][0]), gap)
    samples.drain()


def _hello(raw: RawRun) -> Hello:
    texts = [note.text for note in raw.config if note.kind == "firmware"]
    with suppress(msgspec.MsgspecError):
        if texts:
            return msgspec.json.decode(texts[0], type=Hello)
    raise InputError(raw.name, "does not say which firmware it is of", "play a run that legid record wrote")
