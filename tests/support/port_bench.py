"""`legid record` on the example board in its emulator, something that goes wrong, and how the board's torque ended."""

import os
import re
import signal
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from daq import InputError
from daq.recording import Plan, write_plan
from daq.recording.workers import REAL_TIME_PRIORITY
from daq.runs import read_run
from drivers import Message, State, Telemetry, describe_faults
from drivers.protocol import Arm, ClearFaults, Stop, TimedCommand, TorqueCommand, encode
from evidence.kill_processes import start
from legid.cli import main as legid
from tests.support.fault_bench import DRIVING_AT_S, PEAK_NM, RAMP_AT_S, STOPPING_AFTER_S, SWING_HZ
from tests.support.port_line import Line
from tests.support.qemu_board import Board, ahead

WATCHDOG_MS = 100
STEP_S = 0.01
TIMES = np.arange(0.0, 1.5, STEP_S)
PLAN = Plan(TIMES, PEAK_NM * np.sin(2 * np.pi * SWING_HZ * TIMES))
RIG = f"""[mechanism]
model = "leg2"
actuated = [2]
[devices.controller]
port = "PORT"
rate_hz = 250.0
watchdog_ms = {WATCHDOG_MS}
"""
PATIENCE_S = 15.0
AFTER_S = 0.3
LOOP_MS = 0.5
"""What the last current loop with a torque set holds until the next."""
LOOK_S = 0.004
SILENT_S = 0.05


class Outcome(NamedTuple):
    """How one fault at one moment ended."""

    zero_ms: float
    """From the fault, or from the first torque where that came later, to the last torque that the board's current loop
    gave the bridge, by the board's own tick; 0 where none was any more."""
    clock: str
    """Whose time that is: `board`, or `emulator` where the board's ended in a reset."""
    driven_on: bool
    """The plan was driven to its end, and the torque with it."""
    strongest_nm: float
    """Of what the board says that it was asked for, since the fault."""
    status: int | None
    said: str
    kept: str
    """What is in the run file."""
    board: str
    """What the board says of itself at the end."""
    struck: bool
    """The fault found a recording that had come so far; a computer that is busy may have ended it before."""


def prompt() -> AbstractContextManager[None]:
    """This process ahead of ordinary ones, for a line does not wait; what it starts is ordinary again."""
    return ahead(2 * REAL_TIME_PRIORITY, os.SCHED_RR | os.SCHED_RESET_ON_FORK)


class PortBench:
    """One recording over one board's line; `fault` strikes once, at `moment`."""

    def __init__(self, fault: Callable[["PortBench"], None], moment: str, seed: int = 0) -> None:
        self.board = Board()
        self.line = Line(self.board.path, self._heard, self._asked)
        self.rng = np.random.default_rng(seed)
        self.host = 0
        """Process id of `legid record`."""
        self.telemetry: Telemetry | None = None
        """The board's own word, before anything on the line changed it."""
        self.command: TorqueCommand | TimedCommand | None = None
        self.watched = True
        """The board's memory can be looked at; not while the emulator's process is stopped."""
        self._fault, self._moment = fault, moment
        self._due: list[tuple[float, Callable[[], None]]] = []
        self._armed = self._driving = self._struck = self._followed = False
        self._struck_s, self._struck_us, self._struck_at_s = 0.0, 0, 0.0
        self._strongest_nm = self._heard_s = 0.0
        self._looked: list[tuple[float, int, int]] = []
        """Of the boot in which the fault came: host time [s], ticks of the last loop, and of the last that drove."""
        self._resets = 0

    # -- for faults ----------------------------------------------------------------------------------------

    def later(self, after_s: float, act: Callable[[], None]) -> None:
        """Do that, after so long."""
        self._due.append((time.monotonic() + after_s, act))

    def every(self, each_s: float, act: Callable[[], None], times: int = 200) -> None:
        """Do that again and again, from now on."""
        act()
        if times:
            self.later(each_s, lambda: self.every(each_s, act, times - 1))

    def say_down(self, *messages: Message) -> None:
        """Somebody else's words to the board."""
        for message in messages:
            self.line.down.put(encode(message))

    def signal_host(self, number: int) -> None:
        """To `legid record`, while it is there: process 0 would be all of ours."""
        if self.host:
            os.kill(self.host, number)

    # -- one recording ---------------------------------------------------------------------------------------

    def run(self, folder: Path) -> Outcome:
        """Power up, acknowledge what a board latches at power-up, record, and look on for a while."""
        path, said = folder / "run.mcap", folder / "said.txt"
        path.unlink(missing_ok=True)
        command = _command(folder, self.line.path, path)
        with prompt():
            try:
                self._release()
                self.host = start(command, said, without=self.line.descriptors)
                status = self._until_ended()
                self._pass(AFTER_S)
                zero_ms, clock = self._zero()
                state = self._state()
            finally:
                self._end_host()
                self.line.close()
                self.board.close()
        return Outcome(zero_ms, clock, self._followed and zero_ms > 0.0, self._strongest_nm, status, _last_words(said),
                       self._kept(path), state, self._struck)

    def _release(self) -> None:
        self.board.estop(False)
        deadline = time.monotonic() + PATIENCE_S
        while self.telemetry is None or self.telemetry.faults:
            assert time.monotonic() < deadline, self.telemetry
            self.say_down(Stop(), ClearFaults())
            self._pass(0.02)

    def _until_ended(self) -> int | None:
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            self._pass(LOOK_S)
            done, status = os.waitpid(self.host, os.WNOHANG)
            if done:
                self.host = 0
                return os.waitstatus_to_exitcode(status)
        return None

    def _end_host(self) -> None:
        if self.host:
            with suppress(ProcessLookupError):
                os.kill(self.host, signal.SIGKILL)
            os.waitpid(self.host, 0)
            self.host = 0

    def _pass(self, seconds: float) -> None:
        """Keep the line going, do what is due, look at the board."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            self.line.turn()
            for one in [one for one in self._due if one[0] <= time.monotonic()]:
                self._due.remove(one)
                one[1]()
        if self._struck_s and self.watched:
            self._look()

    def _look(self) -> None:
        if self.board.resets > self._resets:
            return
        trace = self.board.trace()
        if self.board.resets == self._resets and trace.loop_us >= self._struck_us:  # a reset may be told of later
            self._looked.append((time.monotonic(), trace.loop_us, trace.driven_us))

    def _heard(self, message: Message, frame: bytes) -> None:
        if isinstance(message, Telemetry):
            self.telemetry, self._heard_s = message, time.monotonic()
            if self._struck_s:
                self._strongest_nm = max(self._strongest_nm, abs(message.torque_cmd_nm))

    def _asked(self, message: Message, frame: bytes) -> None:
        if isinstance(message, Arm) and not self._armed:
            self._armed = True
            if self._moment == "arming":
                self.later(0.0, self._strike)
        if isinstance(message, TorqueCommand | TimedCommand):
            self.command = message
            self._followed |= bool(abs(message.torque_nm - PLAN.torque_nm[-1]) < 1e-6)
            if message.torque_nm and self._armed and not self._driving:
                self._driving = True
                self._wait_for_moment()

    def _wait_for_moment(self) -> None:
        """The plan's second command is its first torque."""
        at_s = {"ramp": RAMP_AT_S, "driving": DRIVING_AT_S}.get(self._moment)
        if at_s is not None:
            self.later(at_s - STEP_S, self._strike)
        elif self._moment == "stopping":
            self.later(DRIVING_AT_S - STEP_S, lambda: self.signal_host(signal.SIGTERM))
            self.later(DRIVING_AT_S - STEP_S + STOPPING_AFTER_S, self._strike)

    def _strike(self) -> None:
        self._resets = self.board.resets
        self._struck_us = self.board.trace().loop_us
        self._struck_s, self._struck_at_s = time.monotonic(), time.time()
        driven = self.telemetry is not None and self.telemetry.state == State.ARMED
        self._struck = self._moment == "arming" or (driven and self.host != 0)
        self._fault(self)

    # -- what came of it -------------------------------------------------------------------------------------

    def _zero(self) -> tuple[float, str]:
        trace = self.board.trace()
        if not trace.driven_us or not self._struck_s:
            return 0.0, "board"
        if self.board.resets > self._resets:
            _, loop_us, driven_us = self._looked[-1] if self._looked else (0.0, 0, 0)
            if trace.driven_us - driven_us >= 0 and loop_us - trace.driven_us <= LOOP_MS * 1e3:  # to the reset itself
                return (self.board.resets_s[self._resets] - self._struck_at_s) * 1e3, "emulator"
        over_us = trace.driven_us - max(self._struck_us, trace.first_us)
        return (over_us * 1e-3 + LOOP_MS if over_us >= 0 else 0.0), "board"

    def _state(self) -> str:
        if self.telemetry is None or time.monotonic() - self._heard_s > SILENT_S:
            words = ["silent", f"bridge at {self.board.bridge_nm():g} N m"]
        else:
            faults = self.telemetry.faults
            words = [State(self.telemetry.state).name, *([describe_faults(faults)] if faults else [])]
        return ", ".join(words + ["reset"] * (self.board.resets > self._resets))

    def _kept(self, path: Path) -> str:
        try:
            raw = read_run(path)
        except (InputError, OSError):
            return "no run"
        frames, told = raw.streams["/leg/telemetry"], "no telemetry"
        if frames.size:
            told = f"telemetry to {int(frames['host_ns'][-1]) * 1e-6 - self._struck_s * 1e3:+.0f} ms of the fault"
        return f"{'whole' if raw.complete else 'cut'}, {told}"


def load_once(folder: Path) -> None:
    """What every forked recording would load: a port that is not there is refused after that."""
    folder.mkdir(parents=True, exist_ok=True)
    legid(_command(folder, "/dev/no-such-port", folder / "none.mcap"))


def _command(folder: Path, port: str, out: Path) -> list[str]:
    """The words of a recording, for which rig and plan are written."""
    rig, plan = folder / "rig.toml", folder / "plan.csv"
    rig.write_text(RIG.replace("PORT", port))
    write_plan(PLAN, plan)
    return ["record", "--rig", str(rig), "--plan", str(plan), "--out", str(out)]


def _last_words(said: Path) -> str:
    text = said.read_text(errors="replace") if said.exists() else ""
    if "Traceback" in text:
        return f"Traceback: {text.strip()[-200:]}"
    lines = re.findall(r"(?:^|[\r\n])legid record: ([^\r\n]*)", text)
    return lines[-1].split("; what was recorded")[0] if lines else ""
