"""The example board in an emulator, on the wire with this project's own driver and recorder."""

import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from daq.recording import write_plan
from daq.recording.workers import real_time
from daq.runs import read_run
from drivers import LegController, Message, State
from drivers.mock import I2cServer, MockRig, RealClock
from drivers.protocol import Arm, DriveLimits, Fault, LimitsRequest, Stop
from drivers.serial_link import SerialLink
from experiments.excite import random_multisine
from legid import cli
from tests.support.c_firmware import SOURCES
from tests.support.qemu_board import CC, HANG, RETURN, STRICT, Board, needs, returns
from tests.support.still_plant import StillPlant

WATCHDOG_MS = 200
PROMISED_S = 0.11
RIG = """[mechanism]
model = "leg2"
actuated = [2]
[devices.imu]
bus = "{bus}"
rate_hz = 476.0
[devices.controller]
port = "{port}"
rate_hz = 250.0
watchdog_ms = 500
[limits]
q1_rad = 3.0
q2_rad = 2.6
speed_radps = 30.0
staleness_s = 1.0
clock_bound_s = 0.02
"""


@pytest.mark.parametrize("core", ["cortex-m0", "cortex-m4"])
def test_the_core_builds_for_small_processors(core: str, tmp_path: Path) -> None:
    needs(CC)
    for source in sorted(SOURCES.glob("leg_c*.c")):
        subprocess.run([CC, f"-mcpu={core}", *STRICT, "-Wpedantic", "-Wconversion", "-c", source,
                        "-o", tmp_path / "part.o"], check=True)


@contextmanager
def patched(board: Board, function: str, code: bytes) -> Iterator[None]:
    right = board.patch(function, code)
    try:
        yield
    finally:
        board.patch(function, right)


class Wired:
    """A board, and the driver on its port."""

    def __init__(self, board: Board) -> None:
        self.board = board
        self.controller = LegController(SerialLink(board.path))
        self.heard: list[Message] = []
        self.controller.open(10.0)
        self.release()

    def alive_again(self) -> None:
        """Not armed, and no torque, whatever the host sends."""
        self.controller.telemetry = None
        self.until(lambda: self.controller.telemetry, "alive again", lambda: self.controller.command(0.5))
        assert not self.controller.armed and self.board.bridge_nm() == 0.0

    def stops_at_once(self) -> None:
        assert self.board.zero_after_s(time.monotonic()) < PROMISED_S

    def until(self, condition: Callable[[], object], what: str, every: Callable[[], object] = lambda: None) -> None:
        deadline = time.monotonic() + 10.0
        while not condition():
            assert time.monotonic() < deadline, f"{what}: {self.controller.telemetry}"
            every()
            self.heard = [message for message, *_ in self.controller.poll()]

    def release(self) -> None:
        """The E-stop out, its fault cleared."""
        self.board.estop(False)
        self.until(lambda: self.controller.telemetry and not self.controller.telemetry.estop_open, "released")
        self.controller.clear_faults()
        self.until(lambda: self.controller.telemetry and not self.controller.telemetry.faults, "cleared")

    def drive(self) -> None:
        self.controller.arm(WATCHDOG_MS)
        self.until(lambda: self.controller.armed and self.board.bridge_nm(), "driven", self.push)

    def push(self) -> None:
        """A command; a test that was put aside for the watchdog's time begins again."""
        if self.controller.telemetry is not None and self.controller.telemetry.faults:
            self.release()
            self.controller.arm(WATCHDOG_MS)
        self.controller.command(0.5)


@pytest.fixture(scope="module")
def shared() -> Iterator[Wired]:
    with Board() as board:
        wired = Wired(board)
        yield wired
        wired.controller.close()


@pytest.fixture
def wired(shared: Wired) -> Wired:
    shared.release()
    return shared


def test_a_host_that_falls_silent_ends_in_the_watchdog(wired: Wired) -> None:
    wired.drive()
    time.sleep(0.05)
    wired.controller.command(0.5)
    took_s = wired.board.zero_after_s(time.monotonic())
    assert WATCHDOG_MS * 0.5e-3 < took_s < WATCHDOG_MS * 1e-3 + PROMISED_S
    telemetry = wired.controller.telemetry
    wired.until(lambda: wired.controller.telemetry and wired.controller.telemetry.faults == Fault.WATCHDOG, "latched")
    assert telemetry is not None and wired.board.resets == 0


def test_stop_is_obeyed_at_once(wired: Wired) -> None:
    wired.drive()
    wired.controller.stop()
    wired.stops_at_once()


def test_the_button_takes_the_torque_and_refuses_to_arm(wired: Wired) -> None:
    wired.drive()
    wired.board.estop(True)
    wired.stops_at_once()
    wired.until(lambda: wired.controller.telemetry and wired.controller.telemetry.estop_open, "told")
    assert wired.controller.telemetry.faults & Fault.ESTOP and wired.controller.telemetry.state == State.FAULT
    for message in (Stop(), Arm(WATCHDOG_MS)):
        wired.controller._send(message)
    time.sleep(0.1)
    wired.controller.command(0.5)
    assert wired.board.bridge_nm() == 0.0
    wired.release()
    wired.drive()


@pytest.mark.parametrize(("function", "code"), [("leg_poll", HANG), ("leg_sample", HANG), ("current_loop", RETURN)])
def test_the_hardware_watchdog_resets_a_board_of_which_a_part_stands_still(wired: Wired, function: str,
                                                                           code: bytes) -> None:
    """The main loop hangs, or the current loop runs no more: no torque, and a new boot, whatever the host sends."""
    wired.drive()
    before, resets = wired.controller.hello, wired.board.resets
    with patched(wired.board, function, code):
        wired.stops_at_once()
        wired.until(lambda: wired.controller.hello != before, "rebooted", lambda: wired.controller.command(0.5))
        assert wired.board.bridge_nm() == 0.0
        # the emulator tells of a reset when it comes to it, which may be after the new boot's first words
        wired.until(lambda: wired.board.bridge_nm() == 0.0 and wired.board.resets > resets, "reset told")
    wired.alive_again()
    assert wired.controller.hello.boot_id != before.boot_id


def test_a_tick_that_stands_still_resets_the_board(wired: Wired) -> None:
    """No time-out that counts with it would ever end, and the host is gone."""
    wired.drive()
    resets = wired.board.resets
    with patched(wired.board, "board_tick_us", returns(wired.board.trace().loop_us)):
        wired.stops_at_once()
        wired.until(lambda: wired.board.bridge_nm() == 0.0 and wired.board.resets > resets, "reset told")
    wired.alive_again()


def test_it_says_what_it_limits(wired: Wired) -> None:
    wired.controller._send(LimitsRequest())
    wired.until(lambda: any(isinstance(m, DriveLimits) and m.position_max_rad == 2.8 for m in wired.heard), "told")


@pytest.mark.slow
def test_legid_record_over_its_uart(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With an emulated IMU beside it."""
    with Board() as board:
        wired = Wired(board)
        wired.controller.close()
        with real_time():  # an emulated chip is not late either
            imu = I2cServer(MockRig(StillPlant(), RealClock()).imu, tmp_path / "i2c")
        with imu:
            (tmp_path / "rig.toml").write_text(RIG.format(bus=imu.path, port=board.path))
            write_plan(random_multisine(1, 4.0, 0.7), tmp_path / "plan.csv")
            for attempt in range(3):  # an emulator on a busy machine may be late: a fault to the board, or its reset
                resets, run = board.resets, tmp_path / f"run{attempt}.mcap"
                status = cli.main(f"record --rig {tmp_path}/rig.toml --plan {tmp_path}/plan.csv --out {run}".split())
                if status == 0:
                    break
                said = capsys.readouterr().err
                assert any(word in said for word in ("internal", "silence", "restarted")), said
                assert board.bridge_nm() == 0.0
                wired = Wired(board)
                wired.controller.close()
        assert status == 0 and board.bridge_nm() == 0.0 and board.resets == resets
    raw = read_run(run)
    frames = raw.streams["/leg/telemetry"]
    assert raw.complete and frames.size > 1200
    assert abs(frames["knee_rad"]).max() > 0.1  # it swings
