"""`Session`: one recorder at a time, what it says, and the ways to stop it. No device is opened here."""

from __future__ import annotations

import asyncio
import socket
import time
from collections import deque
from collections.abc import Coroutine
from contextlib import suppress
from datetime import datetime
from enum import Enum
from pathlib import Path
from typing import Any

import msgspec

from daq.recording import ALIVE, EMERGENCY, PACKET_BYTES, STOP, Ended, Heard, Row, Status
from experiments.live import children

BEAT_S = 0.025
PAGE_SILENT_S = 1.0
"""A run that somebody started stops when no page has been heard for so long."""
LOOK_S = 0.05
WINDOW_ROWS = 500
"""20 s of plots."""
KILL_AFTER_S = 1.0
"""A recorder that has not heard an emergency stop by then is killed: the firmware's watchdog stops the motor."""
LEAVE_S = 3.0


class Phase(Enum):
    """First line of the page."""

    IDLE = "Idle"
    OPENING = "Opening devices"
    RECORDING = "Recording"
    STOPPING = "Stopping"
    FINISHED = "Finished"
    STOPPED = "Stopped"
    LIMIT = "Stopped by a limit"
    LOST = "Device lost"
    OVERLOAD = "Computer too busy"
    FAILED = "Failed"
    EMERGENCY = "EMERGENCY STOP"


RUNNING = {Phase.OPENING, Phase.RECORDING, Phase.STOPPING}
_ENDINGS = {"done": Phase.FINISHED, "stopped": Phase.STOPPED, "emergency": Phase.EMERGENCY, "limit": Phase.LIMIT,
            "lost": Phase.LOST, "overload": Phase.OVERLOAD, "failed": Phase.FAILED}
_PACKET = msgspec.json.Decoder(Status | Heard | Ended)
READY = "No recording is running."


class Session:
    """The recorder's other end. Belongs to one event loop; pages read its fields."""

    def __init__(self, rig: Path, out: Path, rig_sha256: str = "") -> None:
        self.rig, self.out = rig, out
        self._rig_sha256 = rig_sha256
        """Of the rig file as this program has read it: a recorder refuses another."""
        self.phase = Phase.IDLE
        self.words = READY
        """One line next to the phase."""
        self.motor = ""
        """What the recorder last knew of the motor; empty before any run."""
        self.unattended = False
        """The run goes on without a page: it was started so."""
        self.status: Status | None = None
        """The newest of the run that is on or was last."""
        self.heard_s = 0.0
        """Monotonic time of the last packet [s]."""
        self.rows: deque[Row] = deque(maxlen=WINDOW_ROWS)
        self.rows_seen = 0
        """Rows of this run so far; those older than the window are gone."""
        self.run_number = 0
        """Counts the runs, so that a page sees that one began."""
        self.run_path: Path | None = None
        self.finished: list[Path] = []
        """Run files of this session that were done to the end, oldest first."""
        self._pressed_by: set[str] = set()
        self._page_heard_s = 0.0
        self._why = ""
        self._child: asyncio.subprocess.Process | None = None
        self._line: socket.socket | None = None
        self._ended: Ended | None = None
        self._heard = False
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def running(self) -> bool:
        """A recorder process exists."""
        return self.phase in RUNNING

    @property
    def latched(self) -> bool:
        """The emergency stop was pressed and not released."""
        return bool(self._pressed_by)

    @property
    def control(self) -> dict[str, bool]:
        """State of the buttons that stop and release, for page.js."""
        return {"running": self.running, "latched": self.latched}

    @property
    def flaw(self) -> str:
        """Losses of the current or last run; empty without any."""
        s = self.status
        lost = [] if s is None else [f"{count} {what}" for count, what in (
            (s.imu_gaps, "gaps of the IMU"), (s.frames_lost, "frames of telemetry lost"),
            (s.frames_bad, "frames damaged"), (s.late_commands, "commands left out as late")) if count]
        return ", ".join(lost)

    def page_heard(self) -> None:
        """Somebody has a page open, in front of them."""
        self._page_heard_s = time.monotonic()

    async def start(self, plan: Path, unattended: bool = False) -> None:
        """Start a recorder on `plan`; does nothing while one runs or the emergency stop is latched.

        It stops when no page is heard any more, unless it is `unattended` on purpose.
        """
        if self.running or self.latched:
            return
        self.unattended, self._why = unattended, ""
        self.page_heard()
        self.phase, self.words, self.motor = Phase.OPENING, f"Plan {plan.name}", ""
        self.status, self._ended, self._heard = None, None, False
        self.rows.clear()
        self.rows_seen = 0
        self.run_number += 1
        stamp = f"{datetime.now():%Y%m%d-%H%M%S}"
        path = self.run_path = self.out / f"run-{stamp}-{plan.stem}.mcap"
        try:
            child, ours = await self._start_recorder(plan, path)
        except Exception as error:  # whatever it is, nothing runs
            self._line = None
            self.phase, self.words = Phase.FAILED, f"The recorder could not be started: {error}."
            return
        if self.latched:  # pressed while the process was being made
            self._send(EMERGENCY)
            self._keep(self._kill_late(child))
        self._keep(self._follow(child, ours, path))
        self._keep(self._beat(ours))
        if not unattended:
            self._keep(self._watch_pages(ours))

    async def _start_recorder(self, plan: Path, path: Path) -> tuple[asyncio.subprocess.Process, socket.socket]:
        """A recorder of `plan` into `path`, and this end of the line to it. Raises what keeps it from starting."""
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.setblocking(False)
        self._line = ours
        with theirs:
            arguments = ["record", "--rig", str(self.rig), "--rig-sha256", self._rig_sha256, "--plan", str(plan),
                         "--out", str(path), "--watched-by", str(theirs.fileno()),
                         "--estop-at-hand"]  # legid live has asked
            try:
                self._child = await children.start(arguments, pass_fds=[theirs.fileno()])
            except BaseException:
                ours.close()
                raise
        return self._child, ours

    def stop(self, why: str = "") -> None:
        """Ask for a controlled stop: the torque ramps down in a tenth of a second. `why`: if nobody asked for it.

        Asked again it sends again.
        """
        if not self.running:
            return
        self._send(STOP)
        if self.phase is not Phase.STOPPING:
            self._why = why
            self.phase, self.words = Phase.STOPPING, "The torque ramps down."

    def emergency(self, who: str = "") -> None:
        """Torque off at once; nothing starts until `release` by whoever pressed, a random name or empty."""
        self._pressed_by.add(who)
        if not self.running:
            self.phase, self.words = Phase.EMERGENCY, "No recording was running. Nothing starts until you release it."
            return
        self._send(EMERGENCY)
        self.phase, self.words = Phase.STOPPING, "Emergency stop sent."
        if self._child is not None:
            self._keep(self._kill_late(self._child))

    def release(self, who: str, at_machine: bool = False) -> bool:
        """Allow starting again; False where neither this one pressed nor the machine's own screen asks.

        Where several have pressed, each has to release.
        """
        if not self.latched or self.running:
            return True
        if at_machine:
            self._pressed_by.clear()
        elif who and who in self._pressed_by:
            self._pressed_by.remove(who)
        else:
            return False
        if self.latched:
            self.words = "Somebody else has pressed it, too."
        else:
            self.phase, self.words = Phase.IDLE, READY
        return True

    async def close(self) -> None:
        """The dashboard ends: so does its recorder, in a controlled way first."""
        child, line = self._child, self._line
        if child is None or child.returncode is not None:
            return
        self._send(STOP)
        try:
            await asyncio.wait_for(child.wait(), LEAVE_S)
        except TimeoutError:
            child.kill()
        if line is not None:
            line.close()

    # -- the recorder's process ----------------------------------------------------------------------------

    async def _follow(self, child: asyncio.subprocess.Process, line: socket.socket, path: Path) -> None:
        """Hear the recorder until it ends, then say how."""
        assert child.stderr is not None
        said = asyncio.create_task(child.stderr.read())
        loop = asyncio.get_running_loop()
        with suppress(OSError):
            while packet := await loop.sock_recv(line, PACKET_BYTES):
                with suppress(msgspec.MsgspecError):  # the next one is heard all the same
                    self._hear(packet)
        await child.wait()
        self._line = None
        line.close()
        lines = (await said).decode(errors="replace").strip().splitlines()
        self._end(child.returncode or 0, lines[-1] if lines else "", path)

    def _hear(self, packet: bytes) -> None:
        message = _PACKET.decode(packet)
        self.heard_s = time.monotonic()
        if isinstance(message, Ended):
            self._ended = message
            return
        if isinstance(message, Heard):
            self._heard, self.words = True, "The recorder has sent the motor's Stop."
            return
        self.rows.extend(message.rows)
        self.rows_seen += len(message.rows)
        message.rows = []
        self.status = message
        if message.phase != "opening" and self.phase is Phase.OPENING:
            self.phase = Phase.RECORDING

    def _end(self, code: int, said: str, path: Path) -> None:
        ended = self._ended
        if ended is None:
            how = f"was killed by signal {-code}" if code < 0 else f"ended without a word: {said}"
            ended = Ended("failed", f"the recorder {how}; repair its file with legid recover",
                          "the firmware's watchdog stops it; look at the leg before you go on")
        self.motor = ended.motor
        self.phase = Phase.EMERGENCY if self.latched else _ENDINGS[ended.kind]
        if ended.kind == "done":
            self.finished.append(path)
            self.words = f"{path.name} is recorded to its end."
            if flaw := self.flaw:
                self.words += f" But {flaw}: look at it below before you use it."
        elif self._why and ended.why.startswith("stopped by the dashboard"):
            self.words = self._why
        else:
            self.words = f"{ended.why[:1].upper()}{ended.why[1:]}.".replace(f"{self.out}/", "")

    async def _beat(self, line: socket.socket) -> None:
        """Say that the dashboard is there: a recorder that does not hear it stops."""
        while self._line is line:
            self._send(ALIVE)
            await asyncio.sleep(BEAT_S)

    async def _watch_pages(self, line: socket.socket) -> None:
        """Stop the run when nobody looks at it any more."""
        while self._line is line:
            if time.monotonic() - self._page_heard_s > PAGE_SILENT_S:
                self.stop(f"Stopped: no page was open in front of anybody for {PAGE_SILENT_S:g} s.")
                return
            await asyncio.sleep(LOOK_S)

    async def _kill_late(self, child: asyncio.subprocess.Process) -> None:
        await asyncio.sleep(KILL_AFTER_S)
        if not self._heard and child.returncode is None:
            with suppress(ProcessLookupError):
                child.kill()

    def _send(self, packet: bytes) -> None:
        if self._line is not None:
            with suppress(OSError):  # it has ended, which `_follow` sees
                self._line.send(packet)

    def _keep(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
